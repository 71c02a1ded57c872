"""The command `import`."""

from __future__ import annotations

from shlex import quote
from typing import TYPE_CHECKING, Any

from ..console import print_lines
from .build import Arguments, View, command

if TYPE_CHECKING:
    from ..verbs.import_ import Imported

__all__ = ["IMPORT"]


def _json(made: Imported, given: Arguments) -> dict[str, Any]:
    if made.scaffold:
        return {"scaffold": made.scaffold, "out": None if made.out is None else str(made.out)}
    return {"stores": {str(path): count for path, count in made.stores.items()}}


def _text(made: Imported, given: Arguments) -> None:
    if made.scaffold:
        print_lines(*([f"mapping  {made.out}", "next     fill in its question marks"] if made.out else [made.scaffold]))
        return
    print_lines(*(f"captures {path}: {count}" for path, count in made.stores.items()))
    print_lines(
        f"next     beambench estimate {quote(str(next(iter(made.stores))))} -e NAME   (beambench estimators list)"
    )


IMPORT = command(
    "import",
    "import_:import_",
    View(_text, _json),
    examples="Examples:\n  beambench import frame-*.tif --scaffold --modality gated -o mapping.toml\n"
    "  beambench import frame-*.tif --map mapping.toml -o real.zarr\n"
    "  beambench import pulse.trc --map wf_lecroy-pulse -o pulse.zarr",
)
