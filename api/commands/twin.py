"""The command `twin`."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from ..console import print_lines, print_table
from .build import Arguments, View, command

if TYPE_CHECKING:
    from ..verbs.twin import Twin

__all__ = ["TWIN"]

_CODES = {"pass": 0, "fail": 1, "cannot tell": 3}


def _json(made: Twin, given: Arguments) -> dict[str, Any]:
    return {"out": str(made.out), **json.loads((made.out / "run.json").read_text(encoding="utf-8"))}


def _text(made: Twin, given: Arguments) -> None:
    from ..benchmarks.twin.page import number, sentence

    print_table(
        ("verdict", "clause", "rig", "twin", "unit", "rig − twin", "tolerance", "remark"),
        [
            (
                one.verdict if one.measured else "not measured", one.clause.name, number(one.real), number(one.twin),
                one.clause.unit, f"{number(one.low, 2)} … {number(one.high, 2)}" if one.measured else "–",
                f"{'> ' if one.clause.above and one.measured else ''}{number(one.tolerance, 2)}", one.remark,
            )
            for one in made.found.clauses
        ],
        right=("rig", "twin", "tolerance"),
    )  # fmt: skip
    print_lines(
        "", f"twin     {made.found.verdict}: {sentence(made.found)}", f"page     {made.out / 'certificate.html'}"
    )


def _code(made: Twin) -> int:
    return _CODES[made.found.verdict]


TWIN = command(
    "twin",
    "twin:twin",
    View(_text, _json, _code),
    options=(),
    examples="""Examples:
  beambench twin real.zarr -o certificate
  beambench calibrate real.zarr -o my-rig.toml
  beambench twin real.zarr --rig my-rig.toml -o certificate
  beambench twin real.zarr --rig my-rig.toml --scene tank.toml --fidelity scatter --tolerance t0=20
  beambench twin real.zarr --require gain --require t0 -o certificate

Exit codes: 0 no clause fails, 1 a clause fails, 2 bad input, 3 nothing, or not all that is required, could be decided.""",
)
