"""The command `fidelity`."""

from __future__ import annotations

import json
import sys
from typing import Annotated

from cyclopts import App, Parameter

from ..console import Common, Out, Whole, print_json, print_lines, print_table

__all__ = ["register"]


def register(app: App) -> None:
    """Add the command to the command line."""
    app.command(fidelity, name="fidelity", sort_key=15, help_epilogue=_FIDELITY)


_FIDELITY = """Examples:
  beambench fidelity
  beambench fidelity --scenes 60 --seed 7 -o ladder
  beambench fidelity --scenes 60 --seed 7 -o ladder --resume"""


def fidelity(
    *,
    scenes: Whole = 60,
    seed: Whole = 1,
    out: Out = None,
    overwrite: Annotated[bool, Parameter(negative="", show_default=False)] = False,
    resume: Annotated[bool, Parameter(negative="", show_default=False)] = False,
    common: Common | None = None,
) -> int:
    """Measure what each rung of the generator costs and leaves out, and whether `auto` chooses well.

    Parameters
    ----------
    scenes
        How many scenes of the family.
    seed
        Names what is drawn.
    overwrite
        Replace the tables in --out.
    resume
        Go on with the measurement in --out after its last whole scene.
    """
    from ..verbs.fidelity import fidelity as verb

    quiet = bool(common and common.json)
    folder = verb(
        scenes=scenes,
        seed=seed,
        out=out,
        overwrite=overwrite,
        resume=resume,
        progress=None if quiet else lambda line: print(line, file=sys.stderr, flush=True),
    )
    told = json.loads((folder / "fidelity.json").read_text(encoding="utf-8"))
    if quiet:
        print_json({"out": str(folder), **told})
        return 0
    policies = told.pop("policies")
    told.pop("references")
    flat = {k: v for k, v in told.items() if not isinstance(v, dict)}
    flat |= {f"{k}: {name}": value for k, v in told.items() if isinstance(v, dict) for name, value in v.items()}
    print_table(("quantity", "value"), [(name, _shown(value)) for name, value in flat.items()], right=("value",))
    columns = ("policy", "rtol", "decisions", "within_rtol", "lo", "hi", "cheapest", "cpu_s", "undecided")
    table = [tuple(_shown(row[name]) for name in columns) for row in policies]
    print_table(columns, table, right=columns[2:])
    print_lines(
        f"tables   {folder / 'fidelity.csv'}, policies.csv, fidelity.json", f"picture  {folder / 'fidelity.svg'}"
    )
    return 0


def _shown(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else "" if value is None else str(value)
