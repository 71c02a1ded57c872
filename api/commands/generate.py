"""The command `generate`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ..console import print_lines, print_table, size_text
from .build import Arguments, View, command

if TYPE_CHECKING:
    from ..benchmarks.datasets.generate import Generated

__all__ = ["GENERATE"]


def _json(made: Generated, given: Arguments) -> dict[str, Any]:
    compared = "like" in given and not given["plan"]
    return {
        "plan": made.plan,
        "paths": [str(path) for path in made.paths],
        "like": {
            "equal": made.equal,
            "differing": made.differing,
            "captures": [str(item) for item in made.comparison],
        }
        if compared
        else None,
    }


def _text(made: Generated, given: Arguments) -> None:
    if given["plan"]:
        _plan(made.plan)
        return
    for index, item in enumerate(made.comparison):
        print_lines(f"capture {index}: {item}")
    print_lines(*(f"captures {path}" for path in made.paths))


def _plan(plan: list[dict[str, Any]]) -> None:
    print_table(
        ("scene", "seed", "samples × elements", "counts", "fidelity", "rtol"),
        [
            (
                p["scene"],
                str(p["seed"]),
                f"{p['slices']} × ({p['rows']} × {p['cols']})",
                size_text(p["bytes"]),
                p["fidelity"],
                p["rtol"] if p["rtol"] == "noise" else f"{p['rtol']:g}",
            )
            for p in plan
        ],
        right=("seed", "samples × elements", "counts", "rtol"),
    )
    print_lines(f"{len(plan)} captures, {size_text(sum(p['bytes'] for p in plan))} of counts")


GENERATE = command(
    "generate",
    "generate:generate",
    View(_text, _json, lambda made: int(not made.equal)),
    examples="""Examples:
  beambench generate step --seeds 1 --seeds 2 -o step.zarr
  beambench generate my-scene.toml --set rig.delays.count=128 --plan
  beambench generate quickstart -o captures
  beambench generate --like step.zarr""",
)
