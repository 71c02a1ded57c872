"""The commands that search for failures: `sweep` and `break`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ..console import print_lines, print_table
from .build import Arguments, View, command

if TYPE_CHECKING:
    from ..benchmarks.search.break_run import BreakResult
    from ..benchmarks.search.sweep import SweepResult

__all__ = ["BREAK", "SWEEP"]


def _sweep_json(result: SweepResult, given: Arguments) -> dict[str, Any]:
    return {
        "out": str(result.out),
        "rows": result.rows,
        "pictures": [str(path) for path in result.pictures],
        "report": str(result.report) if result.report else None,
        "failures": result.failures,
        "skipped": result.skipped,
        "wall_s": result.wall_s,
    }


def _sweep_text(result: SweepResult, given: Arguments) -> None:
    from ..benchmarks.report.breakdown import TABLE_HEAD, breakdown_table

    print_table(TABLE_HEAD, breakdown_table(result.rows), right=("float32 / 64", "+1 DN"))
    for note in result.skipped:
        print_lines(f"skipped  {note['estimator']}: {note['reason']}")
    print_lines(
        "",
        "Levels have 95 % intervals. The last two columns are changes in units of the bound.",
        f"tables   {result.out / 'breakdown.csv'}, failure_map.csv",
    )
    print_lines(*(f"picture  {path}" for path in result.pictures))
    if result.report:
        print_lines(f"page     {result.report.resolve()}")


SWEEP = command(
    "sweep",
    "sweep:sweep",
    View(_sweep_text, _sweep_json),
    examples="""Examples:
  beambench sweep stress-photons
  beambench sweep my-axis.toml -o results
  beambench sweep my-axis.toml -o results --resume
A suite file of your own needs five lines:
  suite = "my-axis"
  scenes = ["flat-wall"]
  estimators = ["peak", "poisson-ml"]
  stresses = [{ axis = "rig.detector.read_noise_e", values = [1, 10, 100] }]
  seeds.test = [1, 2, 3, 4]""",
)


def _break_json(result: BreakResult, given: Arguments) -> dict[str, Any]:
    return {
        "out": str(result.out),
        "found": result.found,
        "ratio": result.ratio,
        "scene": result.scene,
        "levels": result.levels,
        "spec": str(result.spec) if result.spec else None,
        "judged": result.judged,
        "wall_s": result.wall_s,
    }


def _break_text(result: BreakResult, given: Arguments) -> None:
    if result.spec is None:
        where = ", ".join(f"{axis} = {level:g}" for axis, level in result.levels.items()) or "the scene as written"
        print_lines(
            f"No failure in {result.judged} captures. The worst error is {result.ratio:.3g} times that of the best "
            f"neighbour, at {where}."
        )
        return
    print_lines("", *result.spec.read_text(encoding="utf-8").splitlines(), "")
    print_lines(f"suite    {result.spec}", f"repeat   beambench run {result.spec}")


BREAK = command(
    "break",
    "break_:break_",
    View(_break_text, _break_json),
    examples="""Examples:
  beambench break weighted-average
  beambench break my-estimator --neighbours poisson-ml --scenes flat-wall --budget 1000
The result is a suite file; the command in its first line repeats it.""",
)
