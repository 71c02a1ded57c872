"""The command `calibrate`."""

from __future__ import annotations

import math
from shlex import quote
from typing import TYPE_CHECKING, Any

from ..console import print_lines, print_table
from .build import Arguments, View, command

if TYPE_CHECKING:
    from ..verbs.calibrate import Calibration

__all__ = ["CALIBRATE"]


def _json(made: Calibration, given: Arguments) -> dict[str, Any]:
    def number(value: float) -> float | None:
        return value if math.isfinite(value) else None

    return {
        "out": str(made.out),
        "lacking": made.lacking,
        "found": {
            name: [
                {"name": one.name, "value": number(one.value), "sigma": number(one.sigma), "unit": one.unit,
                 "path": one.path, "note": one.note}
                for one in found.figures
            ]
            for name, found in made.found.items()
        },
        "rig": made.rig.model_dump(mode="json"),
    }  # fmt: skip


def _text(made: Calibration, given: Arguments) -> None:
    for name, found in made.found.items():
        used = ", ".join(f"{value} {key.replace('_', ' ')}" for key, value in found.used.items())
        print_lines(f"{name}: {used}")
        print_table(
            ("figure", "value", "1 σ", "unit", "in the rig file", "note"),
            [
                (one.name, _number(one.value), _number(one.sigma, 2), one.unit, one.path, one.note)
                for one in found.figures
            ],
            right=("value", "1 σ"),
        )
    print_lines(*(f"not run  {name}: the captures lack {why}" for name, why in made.lacking.items()))
    print_lines(f"rig      {made.out}", f"next     beambench generate SCENE --rig {quote(str(made.out))}")


def _number(value: float, digits: int = 5) -> str:
    return "–" if math.isnan(value) else f"{value:.{digits}g}"


CALIBRATE = command(
    "calibrate",
    "calibrate:calibrate",
    View(_text, _json),
    examples="Examples:\n  beambench generate camera-series -o series\n  beambench calibrate series -o my-rig.toml\n"
    "  beambench calibrate dark.zarr flat-1.zarr flat-2.zarr flat-3.zarr flat-4.zarr --rig my-rig.toml -o better.toml\n"
    "  beambench calibrate air.zarr water.zarr -o line.toml"
    " --procedures 'boards[rows=6,cols=9,square_m=0.02,beyond_x_m=0.095,beyond_y_m=0.035]'\n"
    "  beambench generate flat-wall --rig my-rig.toml -o twin.zarr",
)
