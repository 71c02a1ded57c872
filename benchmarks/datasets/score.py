"""Files of estimates scored against the truth in a store of captures."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...estimators.labels import parse_label, split_label
from ...scenes.errors import InputError
from ...scenes.forks import refuse_forked
from ...scenes.json_keys import read_json

if TYPE_CHECKING:
    from ...captures import CaptureSet
    from ...captures.estimates import Estimates

__all__ = ["scene_name", "score_store"]


def score_store(data: Path, estimates: Path, failure_at: float | None) -> list[dict[str, Any]]:
    """Rows of scores.csv: every file of estimates on every capture.

    Main arguments:
        data: The store.
        estimates: A folder of .h5 files, or one file.
        failure_at: Size of an error above which an element has failed, in the unit of the quantity; None: the rule of the modality.

    Raises:
        InputError: No store, no truth, no estimates, estimates that do not fit, or two with the same label.
    """
    refuse_forked()
    from ...captures import open_captures
    from ...captures.estimates import list_estimates, read_estimates
    from ...captures.sizes import sizes_of
    from ..judges import judge_of
    from ..judges.bound import bounds_of, truths_of
    from ..scores.score import score_rows

    captures = open_captures(data)
    judge_of(captures.modality)  # refuses a modality that is not scored, before anything is read
    sizes = sizes_of(captures.load(0))
    tables = [
        read_estimates(path, len(captures), sizes, modality=captures.modality, captures_sha256=captures.sha256)
        for path in list_estimates(estimates)
    ]
    _check(tables, estimates, failure_at)
    rows: list[dict[str, Any]] = []
    for index in range(len(captures)):
        capture = captures[index]
        if capture.attrs.get("truth_kind") == "none":
            raise InputError(
                "The capture holds no truth to score against.", where=f"{data}, capture {index}", value="none"
            )
        truth, bound = truths_of(capture), bounds_of(capture)
        for table in tables:
            rows += score_rows(
                _key(table, captures, index, capture.attrs),
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


def _check(tables: list[Estimates], estimates: Path, failure_at: float | None) -> None:
    labels = [table.label for table in tables]
    for label in labels:
        parse_label(label)
    if len(set(labels)) != len(labels):
        raise InputError("Two files of estimates have the same label.", where=str(estimates), value=labels)
    if failure_at is not None and not failure_at > 0:
        raise InputError(
            "The failure threshold is a positive number.", where="--failure-at", value=failure_at, allowed="> 0"
        )


def _key(table: Estimates, captures: CaptureSet, index: int, attrs: dict[str, Any]) -> dict[str, Any]:
    """The columns that say what was scored."""
    name, params = split_label(table.label)
    return {
        "suite": captures.path.name,
        "scene": scene_name(attrs, index),
        "stress": "none",
        "level": math.nan,
        "stress2": "none",
        "level2": math.nan,
        "seed": captures.number(index),
        "condition": "matched",
        "estimator": name,
        "params": params,
    }


def scene_name(attrs: dict[str, Any], index: int) -> str:
    """Name of a capture's true scene; "capture-<index>" where it tells none."""
    text = attrs.get("truth_scene")
    try:
        scene = read_json(text) if isinstance(text, str) else None
    except ValueError:
        scene = None
    return str(scene["name"]) if isinstance(scene, dict) and "name" in scene else f"capture-{index}"
