"""Sphinx configuration of the documentation site; `python docs/build.py` builds it."""

from __future__ import annotations

from importlib.metadata import version as installed

project = "Beambench"
author = "The Beambench developers"
copyright = "2026, The Beambench developers"
version = release = installed("beambench")

extensions = ["myst_parser"]
myst_enable_extensions = ["colon_fence"]
myst_heading_anchors = 3
source_suffix = {".md": "markdown"}
master_doc = "index"
exclude_patterns = ["_site", "gate-project/.github", "pages"]
suppress_warnings = ["myst.header"]  # pages begin with their own title, sections may skip a level

html_theme = "furo"
html_title = "Beambench"
html_show_sourcelink = False
html_copy_source = False
html_static_path: list[str] = []
html_theme_options = {"navigation_with_keys": True}
