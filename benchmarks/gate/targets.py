"""What is timed against another version: each estimator of a run on a capture, and the generation of its scenes."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...estimators.labels import label_of
from ...scenes.errors import InputError
from ..runner.protocol import write_capture, write_meta
from ..suites.suite import cell_name

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["targets_of"]

_CONDITION = "matched"  # the declared rig as the store holds it; the same work as under any other condition


def targets_of(folder: Path, table: pd.DataFrame, scratch: Path, *, render: bool) -> dict[str, dict[str, Any]]:
    """{subject: what a worker opens}: every estimator on the first capture that it answered, and every scene once.

    Main arguments:
        folder: of the run, with its captures. table: its scores. scratch: folder for the captures that workers read.
        render: whether the generation of the scenes is timed, too.

    Raises:
        InputError: the run has no captures any more, or one cannot be read.
    """
    from ...captures import open_captures
    from ...captures.hide import hide_truth

    found: dict[str, dict[str, Any]] = {}
    for number, (store, labels) in enumerate(_by_capture(folder, table).items()):
        if not store.is_dir():
            raise InputError(
                "A capture of the run is missing: without it nothing can be timed.", where=str(store),
                allowed="the folder of a run with its captures", next_step="run the suite again",
            )  # fmt: skip
        capture = open_captures(store)[0]
        place = scratch / f"{number:04d}"
        hidden = hide_truth(capture)
        write_capture(place, hidden)
        write_meta(place, hidden, _CONDITION)
        for label in labels:
            found[f"{label} on {store.stem}"] = {
                "kind": "estimate", "label": label, "folder": str(place), "condition": _CONDITION,
            }  # fmt: skip
        if render:
            rung = json.loads(capture.attrs["fidelity"])
            found[f"generate {store.stem}"] = {
                "kind": "render", "scene": json.loads(capture.attrs["truth_scene"]), "seed": int(capture.attrs["seed"]),
                "fidelity": rung["rung"], "rtol": float(rung.get("rtol", 1e-3)),
            }  # fmt: skip
    return found


def _by_capture(folder: Path, table: pd.DataFrame) -> dict[Path, list[str]]:
    """{store: labels} of the first capture of each scene that has answers, and of each label."""
    chosen: dict[str, Path] = {}
    for row in _answered(table):
        label = label_of(str(row["estimator"]), str(row["params"]))
        if label not in chosen:
            levels = [
                (str(row[axis]), _level(row[level])) for axis, level in (("stress", "level"), ("stress2", "level2"))
            ]
            chosen[label] = folder / "captures" / f"{cell_name(str(row['scene']), levels, int(row['seed']))}.zarr"
    stores: dict[Path, list[str]] = {}
    for label, store in chosen.items():
        stores.setdefault(store, []).append(label)
    return stores


def _answered(table: pd.DataFrame) -> Iterator[dict[str, Any]]:
    rows = table[table["status"] == "ok"].drop_duplicates(["scene", "stress", "level", "seed", "estimator", "params"])
    for row in rows.to_dict(orient="records"):
        yield {str(name): value for name, value in row.items()}


def _level(text: Any) -> float:
    return float(text) if str(text) not in ("", "nan") else math.nan
