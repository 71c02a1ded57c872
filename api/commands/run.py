"""Commands of a whole run: run, report, compare, reproduce, doctor."""

from __future__ import annotations

import sys
from typing import Annotated, Any

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
    print_json,
    print_lines,
    print_table,
)  # fmt: skip

__all__ = ["register"]


def register(app: App) -> None:
    """Add the commands to the command line."""
    for function, name, order, epilogue in (
        (run, "run", 1, _RUN),
        (report, "report", 20, _REPORT),
        (compare, "compare", 21, _COMPARE),
        (reproduce, "reproduce", 22, _REPRODUCE),
        (doctor, "doctor", 80, _DOCTOR),
    ):
        app.command(function, name=name, sort_key=order, help_epilogue=epilogue)


_RUN = """Examples:
  beambench run quickstart
  beambench run quickstart -e poisson-ml -e 'weighted-average[background=subtract]'
  beambench run my-suite.toml --set seeds.test=[1,2,3] --set rig.detector.read_noise_e=5 -o results
  beambench run quickstart -o results --resume"""


def run(
    suite: str,
    /,
    *,
    set_: Overrides = None,
    estimators: Estimators = None,
    split: Split = "test",
    out: Out = None,
    resume: Resume = False,
    overwrite: Overwrite = False,
    report: Report = True,
    cache: Annotated[bool, Parameter(negative="", show_default=False)] = False,
    common: Common | None = None,
) -> int:
    """Generate, estimate, score and report a suite; `quickstart` is the demo.

    An estimator that fails is a row of the table, and the exit code stays 0.

    Parameters
    ----------
    suite
        A suite that ships with Beambench, or a .toml or .json file.
    cache
        Take answers that an earlier run measured on this machine (same capture, source, parameters), with their
        times, which are marked so, and keep the new ones. Failures are never kept. Without it all is measured.
    """
    from ..benchmarks.folders.progress import terminal_progress
    from ..benchmarks.report.data import read_scores
    from ..benchmarks.report.text import closing_lines
    from ..benchmarks.statistics.skips import skips_of
    from ..scenes.overrides import parse_assignments
    from ..verbs.run import run as verb

    with terminal_progress() as progress:
        result = verb(
            suite,
            overrides=parse_assignments(set_ or []),
            estimators=estimators,
            split=split,
            out=out,
            resume=resume,
            overwrite=overwrite,
            report=report,
            cache=cache,
            progress=progress,
            command=["beambench", *sys.argv[1:]],
        )
    closing = closing_lines(read_scores(result.out))
    if common and common.json:
        print_json(
            {
                "out": str(result.out),
                "report": str(result.report) if result.report else None,
                "rows": len(result.rows),
                "closing": closing,
                "warnings": result.warnings,
                "failures": result.failures,
                "skipped": skips_of(result.rows),
                "wall_s": result.wall_s,
            }
        )
        return 0
    for warning in result.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    print_lines("", *closing, f"tables   {result.out / 'scores.csv'}")
    if result.report:
        print_lines(f"page     {result.report.resolve()}")
    return 0


_REPORT = """Example:
  beambench report beambench-runs/quickstart-20260102-030405"""


def report(folder: str, /, *, common: Common | None = None) -> int:
    """Write report.html and the chart into the folder of a run.

    Parameters
    ----------
    folder
        A run's folder, with scores.csv or scores.parquet; run.json and pictures/ are used where they are there.
    """
    from ..benchmarks.report.data import read_scores
    from ..benchmarks.report.text import closing_lines
    from ..verbs.report import report as verb

    page = verb(folder)
    closing = closing_lines(read_scores(folder))
    if common and common.json:
        print_json({"report": str(page), "closing": closing})
    else:
        print_lines(*closing, f"page     {page.resolve()}")
    return 0


_COMPARE = """Examples:
  beambench compare runs/before runs/after
  beambench compare before.csv after.csv --json"""


def compare(a: str, b: str, /, *, common: Common | None = None) -> int:
    """Compare two score tables, paired by scene, seed and estimator: what changed from A to B.

    Ratios are B/A with a 95 % interval; below 1 is better. First over the scenes as written, which is what holds for
    other scenes of the kind, then cell by cell over seeds. Times of two kinds of machine are not compared.

    Parameters
    ----------
    a
        Folder of a run, or its scores.csv or scores.parquet.
    b
        The other one.
    """
    from ..verbs.compare import compare as verb

    table = verb(a, b)
    only_a, only_b = table.attrs["unpaired"]
    if common and common.json:
        print_json(
            {
                "over_scenes": table.attrs["over_scenes"],
                "rows": table.to_dict(orient="records"),
                "only_in_a": only_a,
                "only_in_b": only_b,
                "machines_differ": table.attrs["machines_differ"],
            }
        )
        return 0
    over = table.attrs["over_scenes"]
    print_table(
        ("estimator", "quantity", "condition", "scenes", "error B/A over scenes", "p (Holm)"),
        [_over_scenes(row) for row in over],
        right=("scenes", "error B/A over scenes", "p (Holm)"),
    )
    if any(row["scenes"] < 6 for row in over):
        print_lines("with fewer than six scenes no interval over scenes is given")
    print_lines("")
    columns = (
        "estimator",
        "scene",
        "condition",
        "stress",
        "pairs",
        "error B/A",
        "cpu B/A",
        "coverage",
        "failed",
        "status",
    )
    print_table(
        columns,
        [_compared(row) for row in table.to_dict(orient="records")],
        right=("pairs", "error B/A", "cpu B/A", "coverage", "failed"),
    )
    if table.attrs["machines_differ"]:
        print_lines("times are not compared: " + "; ".join(table.attrs["machines_differ"]))
    if only_a or only_b:
        print_lines(f"without a partner: {only_a} rows of A, {only_b} rows of B")
    return 0


def _ratio(row: Any, name: str) -> str:
    value, low, high = (row[f"{name}_{part}"] for part in ("ratio", "lo", "hi"))
    text = "–" if value != value else f"{value:.3f}"
    return text if low != low else f"{text} [{low:.3f}, {high:.3f}]"


def _over_scenes(row: Any) -> list[str]:
    p = "–" if row["p_holm"] != row["p_holm"] else f"{row['p_holm']:.2g}"
    return [row["estimator"], row["quantity"], row["condition"], str(row["scenes"]), _ratio(row, "error"), p]


def _compared(row: Any) -> list[str]:
    def change(value: float) -> str:
        return "–" if value != value else f"{100 * value:+.1f} %"

    scene = row["scene"] + (" (mixed)" if str(row["quantity"]).endswith("-mixed") else "")
    return [
        row["estimator"],
        scene,
        row["condition"],
        row["stress"] or "none",
        str(row["pairs"]),
        _ratio(row, "error"),
        _ratio(row, "cpu"),
        change(row["coverage_change"]),
        change(row["failure_change"]),
        row["status"],
    ]


_REPRODUCE = """Examples:
  beambench reproduce
  beambench reproduce -o reproduction --no-pictures --json"""


def reproduce(
    *,
    out: Out = None,
    overwrite: Overwrite = False,
    pictures: Annotated[bool, Parameter(show_default=False)] = True,
    common: Common | None = None,
) -> int:
    """Recompute the equations, figures and tables of Guo et al., sections 2 to 5, with a verdict on each.

    Parameters
    ----------
    pictures
        Draw charts, raw images and surfaces.
    """
    from dataclasses import asdict

    from ..benchmarks.reproduce.rows import VERDICTS
    from ..verbs.reproduce import reproduce as verb

    def say(part: str) -> None:
        print(part, file=sys.stderr, flush=True)

    result = verb(out=out, overwrite=overwrite, pictures=pictures, progress=None if common and common.json else say)
    counts = {verdict: sum(row.verdict == verdict for row in result.rows) for verdict in VERDICTS}
    if common and common.json:
        print_json(
            {
                "out": str(result.out),
                "page": str(result.page),
                "counts": counts,
                "rows": [asdict(row) for row in result.rows],
                "wall_s": result.wall_s,
            }
        )
        return 0
    print_table(
        ("item", "quantity", "unit", "published", "reproduced", "verdict"),
        [
            (row.item, row.quantity, row.unit, _number(row.published), _number(row.reproduced), row.verdict)
            for row in result.rows
        ],
        right=("published", "reproduced"),
    )
    print_lines(
        "",
        ", ".join(f"{count} {verdict}" for verdict, count in counts.items()),
        f"table    {result.out / 'reproduction.csv'}",
        f"page     {result.page.resolve()}",
    )
    return 0


def _number(value: float) -> str:
    return "–" if value != value else f"{value:.4g}"


_DOCTOR = """Examples:
  beambench doctor
  beambench doctor --json"""


def doctor(*, common: Common | None = None) -> int:
    """Tell what works on this machine, what is missing and how to get it. Exit code 1 if a required part is broken."""
    from dataclasses import asdict

    from ..verbs.doctor import doctor as verb

    findings = verb()
    broken = any(finding.state == "broken" for finding in findings)
    if common and common.json:
        print_json({"ok": not broken, "findings": [asdict(finding) for finding in findings]})
    else:
        print_table(
            ("", "what", "state", "found", "how to mend it"),
            [(f.group, f.name, f.state, f.found, f.advice) for f in findings],
        )
        print_lines("", "a required part is broken" if broken else "all required parts work")
    return int(broken)
