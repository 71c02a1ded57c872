"""Commands of algorithms: estimate, score, estimators."""

from __future__ import annotations

from typing import Annotated

from cyclopts import App, Parameter

from ..console import Common, Out, Resume, Whole, print_json, print_lines, print_table, score_records

__all__ = ["register"]

_Overwrite = Annotated[bool, Parameter(negative="", show_default=False, help="Replace what is there.")]


def register(app: App) -> None:
    """Add the commands to the command line."""
    app.command(estimate, name="estimate", sort_key=5, help_epilogue=_ESTIMATE)
    app.command(score, name="score", sort_key=6, help_epilogue=_SCORE)
    group = App(
        name="estimators", help="List the estimators, check one against the laws, or start one of your own.", sort_key=7
    )
    group.command(estimators_list, name="list", help_epilogue="Example:\n  beambench estimators list")
    group.command(estimators_check, name="check", help_epilogue="Example:\n  beambench estimators check poisson-ml")
    group.command(
        estimators_new, name="new", help_epilogue="Example:\n  beambench estimators new my-median -o my-median"
    )
    group.command(estimators_train, name="train", help_epilogue=_TRAIN)
    app.command(group)


_TRAIN = """Example (repeats the weights that ship):
  beambench generate learned-training -o training
  beambench estimators train --data training --out weights.npz"""

_ESTIMATE = """Examples:
  beambench estimate step.zarr -e poisson-ml -o estimates
  beambench estimate step.zarr -e peak -e 'weighted-average[background=subtract]'
  beambench estimate step.zarr -e poisson-ml -e peak -o estimates --resume"""


def estimate(
    data: str,
    /,
    *,
    estimators: Annotated[list[str] | None, Parameter(name=["--estimators", "-e"], negative="")] = None,
    out: Out = None,
    resume: Resume = False,
    overwrite: _Overwrite = False,
    time_limit_s: float = 600.0,
    memory_limit_bytes: Whole = 8 * 2**30,
    common: Common | None = None,
) -> int:
    """Run estimators on a store of captures; each sees no truth, in its own process.

    Parameters
    ----------
    data
        A store of captures.
    estimators
        name or name[key=value,...], repeatable.
    time_limit_s
        Wall time per capture, s.
    memory_limit_bytes
        Resident memory per estimator.
    """
    from ..benchmarks.folders.progress import terminal_progress
    from ..verbs.estimate import estimate as verb

    with terminal_progress() as progress:
        folder = verb(
            data,
            estimators or [],
            out=out,
            resume=resume,
            overwrite=overwrite,
            time_limit_s=time_limit_s,
            memory_limit_bytes=memory_limit_bytes,
            progress=progress,
        )
    if common and common.json:
        print_json({"out": str(folder), "files": sorted(str(path) for path in folder.glob("*.h5"))})
    else:
        print_lines(f"estimates {folder}", f"next      beambench score {data} {folder}")
    return 0


_SCORE = """Example:
  beambench score step.zarr estimates -o scores"""


def score(
    data: str,
    estimates: str,
    /,
    *,
    out: Out = None,
    overwrite: _Overwrite = False,
    failure_at: float | None = None,
    common: Common | None = None,
) -> int:
    """Score estimates against the truth of their captures. Any program may have written them (HDF5).

    Parameters
    ----------
    data
        A store of captures with truth.
    estimates
        A folder of .h5 files, or one: datasets range, sigma (m) and valid, each (capture, row, col).
    failure_at
        Error in m above which an element has failed, instead of the rule of half the gate's response.
    """
    from ..benchmarks.report.data import cells_of, unit_scale
    from ..benchmarks.report.text import closing_lines, number, rate, time_text
    from ..verbs.score import score as verb

    table = verb(data, estimates, out=out, overwrite=overwrite, failure_at=failure_at)
    folder = table.attrs["folder"]
    if common and common.json:
        print_json({"out": folder, "rows": score_records(table.to_dict(orient="records"))})
        return 0
    cells = cells_of(table)
    factor, unit = unit_scale(cells[0])
    print_table(
        (
            "estimator",
            "where",
            f"RMSE, {unit}",
            "coverage",
            f"bias, {unit}",
            f"bound, {unit}",
            "failed",
            f"CPU per {cells[0].noun}",
            "status",
        ),
        [
            (
                c.label,
                c.place,
                number(c.rmse_full * factor),
                rate(c.coverage),
                number(c.bias * factor),
                number(c.bound * factor),
                rate(c.failure_rate),
                time_text(c.cpu_per_element_s),
                c.status,
            )
            for c in cells
        ],
        right=(f"RMSE, {unit}", "coverage", f"bias, {unit}", f"bound, {unit}", "failed", f"CPU per {cells[0].noun}"),
    )
    print_lines("", *closing_lines(table), f"tables   {folder}/scores.csv", f"next     beambench report {folder}")
    return 0


def estimators_list(*, common: Common | None = None) -> int:
    """List the estimators that are installed, with parameters and sources."""
    from ..verbs.estimators import estimators_list as verb

    rows = verb()
    if common and common.json:
        print_json(rows)
        return 0
    print_table(
        ("estimator", "modality", "parameters", "source", "from"),
        [
            (
                r["name"],
                r["modality"],
                ", ".join(f"{k}={v}" for k, v in r["parameters"].items()) or "–",
                r["error"] or r["cites"],
                r["origin"],
            )
            for r in rows
        ],
    )
    return 0


def estimators_check(estimator: str, /, *, common: Common | None = None) -> int:
    """Hold an estimator to the laws: repeats itself, follows a shift of the delays, is finite or invalid, and more.

    Exit code 1 if one is broken.

    Parameters
    ----------
    estimator
        name or name[key=value,...].
    """
    from dataclasses import asdict

    from ..verbs.estimators import estimators_check as verb

    results = verb(estimator)
    broken = [result for result in results if not result.holds]
    if common and common.json:
        print_json({"ok": not broken, "laws": [asdict(result) for result in results]})
    else:
        print_table(
            ("law", "", "seen"), [(r.law, "ok" if r.holds else "BROKEN", "" if r.holds else r.seen) for r in results]
        )
        print_lines(
            "", f"{len(broken)} of {len(results)} laws are broken" if broken else f"all {len(results)} laws hold"
        )
    return int(bool(broken))


def estimators_new(
    name: str, /, *, out: Out = None, overwrite: _Overwrite = False, common: Common | None = None
) -> int:
    """Write a small package with a working estimator of your own, its entry point and its test.

    Parameters
    ----------
    name
        Lower-case letters, digits and dashes.
    """
    from ..verbs.estimators import estimators_new as verb

    folder = verb(name, out=out, overwrite=overwrite)
    if common and common.json:
        print_json({"out": str(folder)})
    else:
        print_lines(f"package  {folder}", f"next     pip install -e {folder} && beambench estimators check {name}")
    return 0


def estimators_train(
    *,
    data: Annotated[list[str], Parameter(negative="")],
    out: Annotated[str, Parameter(name=["--out", "-o"], help="The weights, an .npz file.")],
    units: Whole = 96,
    ridge: float = 1e-5,
    seed: Whole = 1,
    overwrite: _Overwrite = False,
    common: Common | None = None,
) -> int:
    """Train the learned estimator on captures on disk. Use the weights as 'learned[weights=FILE]'.

    Parameters
    ----------
    data
        A store of gated captures with truth, or a folder of stores; repeatable.
    units
        Units of its one layer.
    ridge
        Penalty of the linear solve.
    seed
        Names every random number.
    """
    from ..verbs.estimators import estimators_train as verb

    found = verb(data, out=out, units=units, ridge=ridge, seed=seed, overwrite=overwrite)
    if common and common.json:
        print_json({"out": out, **found})
    else:
        print_lines(
            f"weights   {out} ({found['bytes'] / 1e3:.0f} kB)",
            f"trained   on {found['pixels']:.0f} pixels of {found['captures']:.0f} captures",
            f"error     {found['rms_held_out']:.3g} of the response's width on pixels held out, "
            f"first guess {found['rms_first_guess']:.3g}",
            f"next      beambench estimate DATA -e 'learned[weights={out}]'",
        )
    return 0
