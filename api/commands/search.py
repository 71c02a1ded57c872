"""Commands that search for failure, sweep and break, and export for programs in other languages."""

from __future__ import annotations

import sys
from typing import Annotated, Literal

from cyclopts import App, Parameter

from ..console import (
    Common,
    Estimators,
    Out,
    Overrides,
    Overwrite,
    Report,
    Resume,
    Split,
    Whole,
    print_json,
    print_lines,
    print_table,
)

__all__ = ["register"]


def register(app: App) -> None:
    """Add the commands to the command line."""
    app.command(sweep, name="sweep", sort_key=13, help_epilogue=_SWEEP)
    app.command(break_, name="break", sort_key=14, help_epilogue=_BREAK)
    app.command(export, name="export", sort_key=9, help_epilogue=_EXPORT)


_SWEEP = """Examples:
  beambench sweep stress-photons
  beambench sweep my-axis.toml -o results
  beambench sweep my-axis.toml -o results --resume
A suite of one's own takes five lines:
  suite = "my-axis"
  scenes = ["flat-wall"]
  estimators = ["peak", "poisson-ml"]
  stresses = [{ axis = "rig.detector.read_noise_e", values = [1, 10, 100] }]
  seeds.test = [1, 2, 3, 4]"""


def sweep(
    suite: str,
    /,
    *,
    set_: Overrides = None,
    estimators: Estimators = None,
    split: Split = "test",
    budget: Whole = 16,
    depth: Whole = 2,
    out: Out = None,
    resume: Resume = False,
    overwrite: Overwrite = False,
    report: Report = True,
    common: Common | None = None,
) -> int:
    """Find the level of each stress at which each estimator breaks down, with its interval and mode.

    Levels are halved where the share of failed elements passes 10 and 50 %. Axes are paths of the scene, or names:
    photons, background, incidence, delay-step, jitter, wrong-index and others.

    Parameters
    ----------
    suite
        A suite that ships with Beambench, or a .toml or .json file; its stresses run from benign to breaking.
    budget
        Levels at most, per estimator and axis.
    depth
        Halvings of the cells at the edge of a two-dimensional grid.
    """
    from ..benchmarks.folders.progress import terminal_progress
    from ..benchmarks.report.breakdown import TABLE_HEAD, breakdown_table
    from ..scenes.overrides import parse_assignments
    from ..verbs.sweep import sweep as verb

    with terminal_progress() as progress:
        result = verb(
            suite,
            overrides=parse_assignments(set_ or []),
            estimators=estimators,
            split=split,
            budget=budget,
            depth=depth,
            out=out,
            resume=resume,
            overwrite=overwrite,
            report=report,
            progress=progress,
            command=["beambench", *sys.argv[1:]],
        )
    if common and common.json:
        print_json(
            {
                "out": str(result.out),
                "rows": result.rows,
                "pictures": [str(path) for path in result.pictures],
                "report": str(result.report) if result.report else None,
                "failures": result.failures,
                "skipped": result.skipped,
                "wall_s": result.wall_s,
            }
        )
        return 0
    print_table(TABLE_HEAD, breakdown_table(result.rows), right=("float32 / 64", "+1 DN"))
    for note in result.skipped:
        print_lines(f"skipped  {note['estimator']}: {note['reason']}")
    print_lines("", "levels with 95 % intervals; the last two columns are changes in units of the bound")
    print_lines(f"tables   {result.out / 'breakdown.csv'}, failure_map.csv")
    for path in result.pictures:
        print_lines(f"picture  {path}")
    if result.report:
        print_lines(f"page     {result.report.resolve()}")
    return 0


_BREAK = """Examples:
  beambench break weighted-average
  beambench break my-estimator --neighbours poisson-ml --scenes flat-wall --budget 1000
The find is a suite file: repeat it with the command in its first line."""


def break_(
    name: str,
    /,
    *,
    neighbours: Annotated[list[str] | None, Parameter(negative="")] = None,
    scenes: Annotated[list[str] | None, Parameter(negative="")] = None,
    set_: Overrides = None,
    side: Whole = 24,
    factor: float = 3.0,
    budget: Whole = 300,
    seed: Whole = 0,
    out: Out = None,
    overwrite: Overwrite = False,
    common: Common | None = None,
) -> int:
    """Search for a scene in which an estimator fails and its neighbours do not; write it in ten lines or fewer.

    The exit code is 0 whether or not one is found.

    Parameters
    ----------
    name
        The estimator: name or name[key=value,...].
    neighbours
        Compare with this estimator; repeatable. One of each family if not given.
    scenes
        Search this scene; repeatable, the plainest first.
    side
        Rows and columns of the captures.
    factor
        How many times worse than the best neighbour, and than itself on scenes as written, is a failure.
    budget
        Candidates to judge before shrinking.
    seed
        Of the search and of the captures.
    """
    from ..benchmarks.folders.progress import terminal_progress
    from ..scenes.overrides import parse_assignments
    from ..verbs.break_ import break_ as verb

    with terminal_progress() as progress:
        result = verb(
            name,
            neighbours=neighbours,
            scenes=scenes,
            overrides=parse_assignments(set_ or []),
            side=side,
            factor=factor,
            budget=budget,
            seed=seed,
            out=out,
            overwrite=overwrite,
            progress=progress,
            command=["beambench", *sys.argv[1:]],
        )
    if common and common.json:
        print_json(
            {
                "out": str(result.out),
                "found": result.found,
                "ratio": result.ratio,
                "scene": result.scene,
                "levels": result.levels,
                "spec": str(result.spec) if result.spec else None,
                "judged": result.judged,
                "wall_s": result.wall_s,
            }
        )
        return 0
    if result.spec is None:
        where = ", ".join(f"{axis} = {level:g}" for axis, level in result.levels.items()) or "as written"
        print_lines(f"no failure found in {result.judged} captures; worst: {result.ratio:.3g} x the best, {where}")
        return 0
    print_lines("", *result.spec.read_text(encoding="utf-8").splitlines(), "")
    print_lines(f"find     {result.spec}", f"repeat   beambench run {result.spec}")
    return 0


_EXPORT = """Example: estimates by any program
  beambench export captures.zarr -o captures.h5
  my-program captures.h5 estimates.h5
  beambench score captures.zarr estimates.h5"""


def export(
    data: str,
    /,
    *,
    to: Literal["hdf5"] = "hdf5",
    out: Out = None,
    overwrite: Overwrite = False,
    common: Common | None = None,
) -> int:
    """Write captures without their truth as one HDF5 file, for an estimator in any language.

    Parameters
    ----------
    data
        A store of captures.
    to
        The format.
    """
    from ..verbs.export import export as verb

    path = verb(data, to=to, out=out, overwrite=overwrite)
    if common and common.json:
        print_json({"out": str(path)})
    else:
        print_lines(f"file     {path}", f"next     beambench score {data} ESTIMATES.h5")
    return 0
