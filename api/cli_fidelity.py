"""The command `fidelity`."""

from __future__ import annotations

import json
import sys
from typing import Annotated

from cyclopts import App, Parameter

from .console import Common, Out, print_json, print_lines, print_table

__all__ = ["register"]


def register(app: App) -> None:
    """Add the command to the command line."""
    app.command(fidelity, name="fidelity", sort_key=15, help_epilogue=_FIDELITY)


_FIDELITY = """Examples:
  beambench fidelity
  beambench fidelity --scenes 40 --seed 7 -o ladder"""


def fidelity(
    *,
    scenes: int = 20,
    seed: int = 1,
    out: Out = None,
    overwrite: Annotated[bool, Parameter(negative="", show_default=False)] = False,
    common: Common | None = None,
) -> int:
    """Measure what each rung of the generator costs and leaves out, and whether `auto` chooses well.

    Parameters
    ----------
    scenes
        How many scenes of the family; 40 hold every combination.
    seed
        Names what is drawn.
    overwrite
        Replace the tables in --out.
    """
    from .verb_fidelity import fidelity as verb

    quiet = bool(common and common.json)
    folder = verb(
        scenes=scenes,
        seed=seed,
        out=out,
        overwrite=overwrite,
        progress=None if quiet else lambda line: print(line, file=sys.stderr, flush=True),
    )
    told = json.loads((folder / "fidelity.json").read_text(encoding="utf-8"))
    if quiet:
        print_json({"out": str(folder), **told})
        return 0
    flat = {k: v for k, v in told.items() if not isinstance(v, dict)}
    flat |= {f"{k}: {name}": value for k, v in told.items() if isinstance(v, dict) for name, value in v.items()}
    shown = [(name, f"{value:.3g}" if isinstance(value, float) else str(value)) for name, value in flat.items()]
    print_table(("quantity", "value"), shown, right=("value",))
    print_lines(f"tables   {folder / 'fidelity.csv'}, fidelity.json", f"picture  {folder / 'fidelity.svg'}")
    return 0
