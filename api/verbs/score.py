"""`beambench score`: estimates against the truth of their captures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["score"]


def score(
    data: str | Path,
    estimates: str | Path,
    *,
    out: str | Path | None = None,
    overwrite: bool = False,
    failure_at: float | None = None,
    sealed: str | Path | None = None,
    suite: str | Path | None = None,
) -> pd.DataFrame:
    """Score estimates against the truth of their captures. Any program may have written the estimates (HDF5).

    Neither the renderer nor the estimators need to be installed, but for sealed captures. docs/external-estimators.md describes
    the files.

    Main arguments:
        data: A store of captures with truth.
        estimates: A folder of .h5 files, or one file: the estimated quantity, its sigma and valid, with the capture as first
            axis.
    Other arguments:
        out: Folder of the tables; ./beambench-runs/<name>-<time> by default.
        overwrite: Replace earlier tables.
        failure_at: Size of an error above which an element has failed, in the unit of the quantity; by default half the width
            of the instrument's response.
        sealed: File of the key with which the captures were made (`generate SUITE --sealed`): their truth is made again
            (docs/challenges.md).
        suite: The suite of sealed captures, where it is not built in.

    Returns:
        scores.csv as a table; its attribute `folder` is where the tables are.

    Raises:
        InputError: No store, no truth, no estimates, estimates that do not fit, two with the same label, or an output that
            exists or is an input.
    """
    from ..benchmarks.datasets.score import score_store
    from ..benchmarks.folders.files import write_json
    from ..benchmarks.folders.kinds import SCORE, slug
    from ..benchmarks.folders.record import TABLES_VERSION, now, versions
    from ..benchmarks.folders.workplace import output_folder, workplace
    from ..benchmarks.scores.tables import read_scores, write_tables
    from ..benchmarks.suites.sealed import read_key
    from ..scenes.errors import InputError

    if suite is not None and sealed is None:
        raise InputError("A suite is needed for sealed captures only.", where="--suite", value=str(suite),
                         allowed="--suite together with --sealed")  # fmt: skip
    key = None if sealed is None else read_key(sealed)
    folder = output_folder(out, slug(Path(f"scores-{Path(data).name}").stem), resume=False, overwrite=overwrite)
    with workplace(folder, SCORE, overwrite=overwrite, inputs=[data, estimates]) as work:
        write_tables(work, score_store(Path(data), Path(estimates), failure_at, key=key, suite=suite))
        typed = ["beambench", "score", str(data), str(estimates)]
        limit = [] if failure_at is None else ["--failure-at", repr(failure_at)]
        limit += [] if sealed is None else ["--sealed", str(sealed)]
        limit += [] if suite is None else ["--suite", str(suite)]
        record = {"verb": SCORE.verb, "suite": Path(data).name, "command": [*typed, *limit], "finished": now()}
        write_json(work / "run.json", record | {"tables_version": TABLES_VERSION, "versions": versions()})
    table = read_scores(folder)
    table.attrs["folder"] = str(folder)
    return table
