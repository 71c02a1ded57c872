"""Stores of example captures for tests of exports: one file a chunk, or a data set of shards with parts and drawn values."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import xarray as xr

from beambench.captures import finalize
from beambench.captures.example import example_capture
from beambench.captures.store.journal import JOURNAL, mark_journal
from beambench.captures.store.shard_finish import write_request
from beambench.captures.store.shard_writer import ShardWriter
from beambench.scenes.datasets.content import scene_content
from beambench.scenes.datasets.spec import Dataset

from ._data_sets import TINY, tiny

__all__ = ["PARTS", "capture_of", "data_set", "drawn_set"]

#: The part of each capture of a modality.
PARTS = ("train", "test", "train", "validation", "train")
LENGTH = 2


def capture_of(modality: str, number: int) -> xr.Dataset:
    """Capture `number`: all variables, also the optional ones."""
    return example_capture(modality, seed=number).assign_attrs(seed=number)


def data_set(path: Path, modalities: tuple[str, ...], count: int = len(PARTS)) -> Path:
    """A data set of `count` captures of each modality, numbered through, in shards of two."""
    partial = path.with_name(path.name + ".partial")
    partial.mkdir(parents=True)
    with open(partial / JOURNAL, "xb") as file:
        mark_journal(file)
    told = {"dataset": "small", "title": "Small & odd", "licence": "CC0-1.0", "citation": "Nobody, 2026"}
    write_request(
        partial,
        {"name": "small", "version": 2, "count": count * len(modalities), "identity": "i", "numbers": ["albedo"],
         "texts": ["kind"], "dataset": told},
    )  # fmt: skip
    for order, modality in enumerate(modalities):
        for shard, begin in enumerate(range(0, count, LENGTH)):
            own = range(begin, min(begin + LENGTH, count))
            rows = range(order * count + own.start, order * count + own.stop)
            with ShardWriter(partial, modality, shard, rows, LENGTH, last=own.stop == count) as writer:
                for number in own:
                    drawn: dict[str, object] = {"albedo": number / 8} if number else {"albedo": 0.0, "kind": "sand"}
                    facts = {"part": PARTS[number % len(PARTS)], "values": drawn, "base": "wall", "draw": number}
                    writer.append(capture_of(modality, number), facts)
                writer.close()
    finalize(path)
    return path


#: A scene as captures record it.
SCENE: dict[str, Any] = {
    "target": [
        {
            "name": "wall", "shape": {"kind": "rectangle", "center_m": [0.0, 0.0, 5.0]},
            "material": {"kind": "lambert", "albedo": 0.5},
        }
    ],
    "medium": {"name": "air", "absorption_per_m": 0.0},
}  # fmt: skip


def drawn_set(path: Path, count: int = 30, *, twin: int | None = None, **told: Any) -> Path:
    """A data set as `generate` makes it, of example captures: an albedo drawn for each, and its scene recorded.

    `twin`: this capture has the scene of the first one, but stays in its own part.
    """
    data = tiny(TINY, captures=count, dataset="drawn", **told)
    data["parameters"] = {"albedo": data["parameters"]["albedo"]}
    spec = Dataset.model_validate(data)
    partial = path.with_name(path.name + ".partial")
    partial.mkdir(parents=True)
    with open(partial / JOURNAL, "xb") as file:
        mark_journal(file)
    write_request(
        partial,
        {"name": "drawn", "version": 1, "count": count, "identity": "i", "numbers": ["albedo"], "texts": [],
         "dataset": spec.model_dump(mode="json")},
    )  # fmt: skip
    with ShardWriter(partial, "gated", 0, range(count), count, last=True) as writer:
        for number in range(count):
            albedo = 0.1 + 0.8 * ((0 if number == twin else number) * 0.618034 % 1.0)
            scene = copy.deepcopy(SCENE)
            scene["target"][0]["material"]["albedo"] = albedo
            capture = example_capture("gated", seed=number, optional=False).assign_attrs(truth_scene=json.dumps(scene))
            content = scene_content(scene, ("target", "medium"))
            facts = {"part": ("train", "train", "test")[number % 3], "values": {"albedo": albedo}, "base": "step"}
            writer.append(capture, facts | {"draw": number, "scene_sha256": content})
        writer.close()
    finalize(path)
    return path
