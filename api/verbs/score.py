"""`beambench score`: estimates against the truth of their captures."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
) -> pd.DataFrame:
    """Score estimates against the truth in a store, write the tables into `out`, and return scores.csv as a table.

    Mitsuba is not needed, nor the estimators: any program may write the estimates (HDF5 with `range`, `sigma`, `valid`
    over capture, row and col).

    Main arguments:
        data: a store of captures that hold truth. estimates: a folder of .h5 files, or one.
    Other arguments:
        out: folder of the tables.
        failure_at: |error| in m above which an element has failed; by default half the response's width.

    Raises:
        InputError: no store, no truth, no estimates, estimates that do not fit, two of one name, an output that
            exists or is an input.
    """
    from ..benchmarks.folders.kinds import SCORE, slug
    from ..benchmarks.folders.workplace import output_folder, workplace
    from ..benchmarks.report.data import read_scores
    from ..benchmarks.scores.tables import write_tables

    folder = output_folder(out, slug(Path(f"scores-{Path(data).name}").stem), resume=False, overwrite=overwrite)
    with workplace(folder, SCORE, overwrite=overwrite, inputs=[data, estimates]) as work:
        write_tables(work, _rows(data, estimates, failure_at))
    table_of_scores = read_scores(folder)
    table_of_scores.attrs["folder"] = str(folder)
    return table_of_scores


def _rows(data: str | Path, estimates: str | Path, failure_at: float | None) -> list[dict[str, Any]]:
    """Rows of scores.csv: every file of estimates on every capture."""
    from ..benchmarks.judges import judge_of
    from ..benchmarks.judges.bound import bounds_of, truths_of
    from ..benchmarks.scores.score import score_rows
    from ..captures import open_captures
    from ..captures.estimates import list_estimates, read_estimates
    from ..captures.sizes import sizes_of
    from ..estimators.labels import parse_label
    from ..scenes.errors import InputError

    captures = open_captures(data)
    first = captures.load(0)
    judge_of(captures.modality)
    sizes = sizes_of(first)
    tables = [
        read_estimates(path, len(captures), sizes, modality=captures.modality, captures_sha256=captures.sha256)
        for path in list_estimates(Path(estimates))
    ]
    labels = [table.label for table in tables]
    if len(set(labels)) != len(labels):
        raise InputError("Two files of estimates have the same label.", where=str(estimates), value=labels)
    if failure_at is not None and not failure_at > 0:
        raise InputError(
            "The failure threshold is a length.", where="--failure-at", value=failure_at, allowed="> 0, in m"
        )
    rows: list[dict[str, Any]] = []
    for index in range(len(captures)):
        capture = captures[index]
        if capture.attrs.get("truth_kind") == "none":
            raise InputError(
                "The capture holds no truth to score against.", where=f"{data}, capture {index}", value="none"
            )
        truth, bound = truths_of(capture), bounds_of(capture)
        for table in tables:
            name, _, params = table.label.partition("[")
            parse_label(table.label)
            key = {
                "suite": Path(data).name,
                "scene": _scene_name(capture.attrs, index),
                "stress": "none",
                "level": math.nan,
                "stress2": "none",
                "level2": math.nan,
                "seed": int(capture.attrs.get("seed", index)),
                "condition": "matched",
                "estimator": name,
                "params": params.removesuffix("]"),
            }
            rows += score_rows(
                key,
                table.gives,
                truth,
                bound,
                table.arrays[index],
                status=table.status[index],
                cpu_s=table.cpu_s[index],
                wall_s=table.wall_s[index],
                peak_bytes=table.peak_bytes[index],
                failure_at=failure_at,
            )
    return rows


def _scene_name(attrs: dict[str, Any], index: int) -> str:
    text = attrs.get("truth_scene")
    scene = json.loads(text) if isinstance(text, str) else None
    return str(scene["name"]) if isinstance(scene, dict) and "name" in scene else f"capture-{index}"
