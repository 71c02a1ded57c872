"""Files of estimates scored against the truth in a store of captures."""

from __future__ import annotations

import math
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...estimators.labels import parse_label, split_label
from ...scenes.errors import InputError
from ...scenes.forks import refuse_forked
from ...scenes.json_keys import read_json
from ..suites.declared import MATCHED, declared_note, told_condition
from .sealed import making_again, seal_of

if TYPE_CHECKING:
    from collections.abc import Mapping

    import xarray as xr

    from ...captures import CaptureSet
    from ...captures.estimates import Estimates
    from ...scenes.scene import Scene
    from ..scores.truth import Bound, Truth
    from ..suites.sealed import Key
    from ..suites.spec import Draw

__all__ = ["scene_name", "score_store"]


def score_store(
    data: Path,
    estimates: Path,
    failure_at: float | None,
    *,
    key: Key | None = None,
    suite: str | Path | None = None,
) -> list[dict[str, Any]]:
    """Rows of scores.csv: every file of estimates on every capture.

    Main arguments:
        data: The store.
        estimates: A folder of .h5 files, or one file.
        failure_at: Size of an error above which an element has failed, in the unit of the quantity; None: the rule of the modality.
    Other arguments:
        key: The key of a sealed store, by which its truth is made again. suite: Its suite, where that is not built in.

    Warns of what `scores.slips` and `suites.declared` tell. Raises InputError for no store, no truth, another key, no estimates,
    estimates that do not fit, or two with the same label.
    """
    refuse_forked()
    from ...captures import open_captures
    from ...captures.estimates import list_estimates, read_estimates
    from ...captures.sizes import sizes_of
    from ..bounds.instrument import true_scene
    from ..judges import judge_of
    from ..judges.bound import bounds_of, truths_of
    from ..judges.drawn import with_draws
    from ..scores.slips import slip_warnings, slips_of

    captures = open_captures(data)
    judge_of(captures.modality)  # refuses a modality that is not scored, before anything is read
    sizes = sizes_of(captures.load(0))
    tables = [
        read_estimates(path, len(captures), sizes, modality=captures.modality, captures_sha256=captures.sha256)
        for path in list_estimates(estimates)
    ]
    _check(tables, estimates, failure_at)
    again = None if key is None else making_again(captures, key, suite)
    rows: list[dict[str, Any]] = []
    slips: list[dict[str, Any]] = []
    notes: dict[str, None] = {}
    for index in range(len(captures)):
        capture = captures[index]
        place: dict[str, Any] = {}
        draws: tuple[Draw, ...] = ()
        if again is not None:
            cell, capture, draws = again(index, capture)
            place = {"scene": cell.scene_name, "seed": cell.seed}
        _refuse_untrue(capture, f"{data}, capture {index}")
        scene = true_scene(capture) if isinstance(capture.attrs.get("truth_scene"), str) else None
        notes |= dict.fromkeys([declared_note(scene)] if scene is not None else [])
        truth, bound = truths_of(capture), with_draws(bounds_of(capture), capture, draws)
        for table in tables:
            named = _key(table, captures, index, capture.attrs, scene) | place
            rows += _scored(named, table, index, truth, bound, failure_at)
            slips += [named | row for row in slips_of(table.gives, table.arrays[index] or {}, truth)]
    for sentence in (*filter(None, notes), *slip_warnings(slips)):
        warnings.warn(sentence, stacklevel=3)
    return rows


def _scored(
    named: dict[str, Any],
    table: Estimates,
    index: int,
    truth: Mapping[str, Truth],
    bound: Mapping[str, Bound],
    failure_at: float | None,
) -> list[dict[str, Any]]:
    """The rows of one file on one capture."""
    from ..scores.score import score_rows

    costs = {name: getattr(table, name)[index] for name in ("cpu_s", "wall_s", "peak_bytes")}
    return score_rows(
        named,
        table.gives,
        truth,
        bound,
        table.arrays[index],
        status=table.status[index],
        failure_at=failure_at,
        **costs,
    )


def _refuse_untrue(capture: xr.Dataset, where: str) -> None:
    if capture.attrs.get("truth_kind") == "none":
        sealed = seal_of(capture.attrs) is not None
        raise InputError(
            "The capture holds no truth to score against.", where=where, value="none",
            next_step="it is sealed: give the organiser's key with --sealed KEYFILE" if sealed else "",
        )  # fmt: skip


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


def _key(
    table: Estimates, captures: CaptureSet, index: int, attrs: dict[str, Any], scene: Scene | None
) -> dict[str, Any]:
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
        "condition": MATCHED if scene is None else told_condition(MATCHED, scene),
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
