"""The command `design`."""

from __future__ import annotations

import math
from shlex import quote
from typing import TYPE_CHECKING, Any

from ..console import print_lines, print_table
from .build import Arguments, View, command

if TYPE_CHECKING:
    from ..verbs.design import Design

__all__ = ["DESIGN"]


def _json(made: Design, given: Arguments) -> dict[str, Any]:
    import json

    return {"out": str(made.out), **json.loads((made.out / "run.json").read_text(encoding="utf-8"))}


def _text(made: Design, given: Arguments) -> None:
    found = made.found
    names = [knob.name for knob in found.knobs]
    biased = any(one.bias for one in found.options)
    errors = [f"rms bound of {found.quantity} [{found.unit}]", *([f"bias [{found.unit}]"] if biased else [])]
    print_table(
        ("", "design", *names, *errors, "gain", "guard", "why not"),
        [
            (
                "*" if one is found.best else "", one.name, *(_number(one.settings.get(name, math.nan)) for name in names),
                _number(found.factor * one.bound), *([_number(found.factor * one.bias)] if biased else []),
                f"{found.own.error / one.error:.2f}", _number(one.guard), one.why,
            )
            for one in found.options
        ],
        right=(*names, *errors, "gain", "guard"),
    )  # fmt: skip
    print_lines("", f"guard    {found.guard}")
    if biased:
        print_lines("bias     of an estimator that takes all light for direct, as those here do; the gain counts it")
    if found.best is found.own:
        print_lines("design   none is better than the scene's own", f"files    {made.out}")
        return
    print_lines(
        f"design   {found.best.name}: {found.gain:.2f} times below the {'error' if biased else 'bound'} of the scene's own",
        f"files    {made.out}",
        f"next     sh {quote(str(made.out))}/set.txt",
    )


def _number(value: float) -> str:
    return "–" if math.isnan(value) else f"{value:.4g}"


DESIGN = command(
    "design",
    "design:design",
    View(_text, _json),
    options=(),
    examples="Examples:\n  beambench design flat-wall\n"
    "  beambench design flat-wall --budget 0.1 --allow slices=4,8,16 --allow gate-width=1e-9,2e-9\n"
    "  beambench design spotscan-wall --allow baseline=0.1,0.15,0.2 --allow angle=-13,-10,-7\n"
    "  beambench design gated-turbulence --set 'rig.propagation=\"phase-screens\"'",
)
