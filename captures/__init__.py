"""The format of captures, rendered or recorded: layouts, truth, provenance, and the store that holds them.

- `layouts`: variables, dimensions, dtypes and units of each modality. `make_capture` builds a capture,
  `validate.validate` checks one.
- `hide_truth`: the part of a capture that an estimator may read.
- `write`, `open_captures`, `verify`, `finalize`, `repair`, `store.status.status`: the checksummed store.
- `example.example_capture`: a valid capture of arbitrary numbers, for tests of readers and plug-ins.
- `provenance.provenance`, `compare_captures`: what generating a capture again needs, and whether the bits are equal.

Names are loaded on first use, so that importing this package loads neither xarray nor zarr.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .build import make_capture
    from .compare import Comparison, compare_captures, compare_stores
    from .hide import hide_truth
    from .layouts.schema import SCHEMA_VERSION
    from .store.faces import finalize, open_captures, repair, verify
    from .store.reader import CaptureIndexError, CaptureSet
    from .store.recovery import Recovery
    from .store.verification import Damage
    from .store.writer import CaptureWriter, write

__all__ = [
    "SCHEMA_VERSION",
    "CaptureIndexError",
    "CaptureSet",
    "CaptureWriter",
    "Comparison",
    "Damage",
    "Recovery",
    "compare_captures",
    "compare_stores",
    "finalize",
    "hide_truth",
    "make_capture",
    "open_captures",
    "repair",
    "verify",
    "write",
]

# No function here has the name of a module: importing the module would replace it.
_HOME = {
    "SCHEMA_VERSION": "layouts.schema",
    "CaptureIndexError": "store.reader",
    "CaptureSet": "store.reader",
    "CaptureWriter": "store.writer",
    "Comparison": "compare",
    "Damage": "store.verification",
    "Recovery": "store.recovery",
    "compare_captures": "compare",
    "compare_stores": "compare",
    "finalize": "store.faces",
    "hide_truth": "hide",
    "make_capture": "build",
    "open_captures": "store.faces",
    "repair": "store.faces",
    "verify": "store.faces",
    "write": "store.writer",
}


def __getattr__(name: str) -> object:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_HOME[name]}", __name__), name)
