"""The chart library that a page holds: bundled by vl-convert in 1.5 s of CPU time, and kept, since it is the same for every page.

It is kept in (user cache)/beambench/pages, in a file named by the version of vl-convert and what is exported, behind the SHA-256
of its text. A damaged file is made anew; where none can be written, the library is bundled each time.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import tempfile
from importlib.metadata import version

from ...optics.jit import user_cache

__all__ = ["chart_library"]

_DIGITS = 64


def chart_library(exports: str) -> str:
    """The text of a script with Vega, Vega-Lite and Vega-Embed, which runs `exports` at its end."""
    name = hashlib.sha256(f"{version('vl-convert-python')}\n{exports}".encode()).hexdigest()[:16]
    path = user_cache() / "pages" / f"charts-{name}.js"
    with contextlib.suppress(OSError, UnicodeDecodeError):
        digest, kept = (text := path.read_bytes().decode())[:_DIGITS], text[_DIGITS:]
        if hashlib.sha256(kept.encode()).hexdigest() == digest:
            return kept
    import vl_convert

    made = str(vl_convert.javascript_bundle(exports))
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, partial = tempfile.mkstemp(dir=path.parent)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write((hashlib.sha256(made.encode()).hexdigest() + made).encode())
            os.replace(partial, path)
        except BaseException:
            os.unlink(partial)
            raise
    return made
