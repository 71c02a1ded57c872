"""Why a reference could not be built: pip's real error, and what the build requires that is not installed here."""

from __future__ import annotations

import re
import shlex
import tomllib
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

__all__ = ["build_error", "unmet_requirements"]

_LINES = 2  # of the error that are told
_WIDTH = 200  # characters of each
#: Words that say that an error follows, as in "ValueError: …", "fatal error: …" and "ERROR: …".
_NAMES = re.compile(r"(?:error|ERROR|Error|Exception)(?:\[\w+\])?\s*:")
#: What pip says around an error, which names none.
_AROUND = re.compile(
    r"[×╰│]|\[end of output\]|note: |hint: |(?:error|ERROR): +(?:subprocess-exited-with-error|metadata-generation-failed"
    r"|Failed building |Failed to build |Could not build wheels )|Failed to build "
)


def build_error(output: str) -> str:
    """What pip's output says of its failure, in at most two lines: the last ones that name an error, else the last ones of the
    build's output, without pip's hints around them."""
    lines = [line.strip() for line in output.splitlines()]
    kept = [line for line in lines if line and not _AROUND.match(line)]
    told = [line for line in dict.fromkeys(kept) if _NAMES.search(line)] or kept
    return "; ".join(line[:_WIDTH] for line in told[-_LINES:]) or "it failed without a message"


def unmet_requirements(project: Path) -> str:
    """What `project` states in [build-system] requires and is not installed here, with the command that installs it; "" if nothing.

    It counts where a project is built without isolation, that is with the build tools of this environment.
    """
    from packaging.requirements import InvalidRequirement, Requirement

    try:
        stated = tomllib.loads((project / "pyproject.toml").read_text(encoding="utf-8"))["build-system"]["requires"]
        needed = [Requirement(text) for text in stated]
    except (OSError, ValueError, KeyError, TypeError, InvalidRequirement):
        return ""
    found = []
    for one in needed:
        here = _installed(one.name)
        applies = one.marker is None or one.marker.evaluate()
        if applies and not (here and one.specifier.contains(here, prereleases=True)):
            found.append((f"{one.name}{one.specifier}", f"{here or 'none'} is installed"))
    if not found:
        return ""
    told = ", ".join(f"{text} ({here})" for text, here in found)
    return f"its build requires {told}: pip install -U {' '.join(shlex.quote(text) for text, _ in found)}"


def _installed(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return ""
