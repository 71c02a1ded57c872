"""Whether the split of a data set leaks: equal scenes in two parts, and scenes that are nearly equal.

The hashes are computed again from the scenes that the captures record (`truth_scene`), not taken from the index.
"""

from __future__ import annotations

import hashlib
import json
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...captures.store.shard_set import ShardedSet
from ...scenes.datasets.content import scene_content
from ...scenes.errors import InputError
from ...scenes.json_keys import read_json
from ..folders.progress import Progress

__all__ = ["Leaks", "Near", "check_split"]

Array = np.ndarray[Any, Any]


@dataclass(frozen=True)
class Near:
    """How near the scenes of a part are to those of `train`: the greatest difference of any value, as a share of its range.

    Main arguments:
        part: its name. count: scenes that have a neighbour of their kind in `train`. least, median: of the nearest neighbours.
        pairs: (distance, capture, capture in train) of the nearest ones.
    """

    part: str
    count: int
    least: float
    median: float
    pairs: list[tuple[float, int, int]]


@dataclass
class Leaks:
    """The result of the check.

    Main arguments:
        scenes: different scenes, by their hash. captures: how many were read. by: what makes scenes the same.
        shared: {hash: parts} of what is in two parts. unlike: captures whose hash is not the recorded one.
        unread: captures whose scene names a file that is not here; their recorded hash was taken.
        near: for each part but train. own: median distance of a scene of train to its nearest other one there, NaN without.
    """

    scenes: int = 0
    captures: int = 0
    by: tuple[str, ...] = ("target", "medium")
    shared: dict[str, list[str]] = field(default_factory=dict)
    unlike: int = 0
    unread: int = 0
    near: list[Near] = field(default_factory=list)
    own: float = float("nan")


def check_split(sets: list[ShardedSet], by: tuple[str, ...], tell: Progress) -> Leaks:
    """Read the scene of every capture, hash it anew, and look for scenes in two parts and for near ones.

    Raises:
        InputError: a receipt is damaged.
    """
    found = Leaks(by=by)
    parts: dict[str, set[str]] = defaultdict(set)
    scenes: dict[str, tuple[int, str, dict[str, float], str]] = {}
    total, done = sum(map(len, sets)), 0
    for one in sets:
        for place in range(len(one)):
            facts = one.index(place)
            scene = _scene(one.attributes(place))
            content, group = _hashes(scene, facts, by, found)
            part = str(facts.get("part", ""))
            parts[group].add(part)
            if content not in scenes:
                leaves = dict(_leaves({key: scene.get(key) for key in ("target", "medium")}))
                numbers = {k: float(v) for k, v in leaves.items() if _is_number(v) and not k.endswith(".seed")}
                others = {k: v for k, v in leaves.items() if k not in numbers}
                kind = hashlib.sha256(json.dumps([sorted(numbers), others], sort_keys=True).encode()).hexdigest()
                scenes[content] = (int(facts["capture"]), part, numbers, kind)
            done += 1
            tell("split", done, total, "scenes hashed")
    found.scenes, found.captures = len(scenes), done
    found.shared = {group: sorted(held) for group, held in parts.items() if len(held) > 1}
    _near(list(scenes.values()), found)
    return found


def _scene(attrs: Mapping[str, Any]) -> dict[str, Any]:
    try:
        scene = read_json(str(attrs.get("truth_scene", "")))
    except ValueError:
        return {}
    return scene if isinstance(scene, dict) else {}


def _hashes(scene: dict[str, Any], facts: Mapping[str, Any], by: tuple[str, ...], found: Leaks) -> tuple[str, str]:
    """Hash of target and medium, and of what the split goes by."""
    recorded = str(facts.get("scene_sha256", ""))
    try:
        content = scene_content(scene, ("target", "medium"))
        found.unlike += content != recorded
        if by == ("target", "medium"):
            return content, content
        return content, f"base {facts.get('base')}" if "base" in by else scene_content(scene, by)
    except InputError:
        found.unread += 1
        return recorded, recorded


def _leaves(node: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """(path, value) of what is no table or list; names of things are left out."""
    if isinstance(node, Mapping):
        for key, value in node.items():
            if key not in ("name", "title"):
                yield from _leaves(value, f"{path}.{key}")
    elif isinstance(node, list | tuple):
        for number, value in enumerate(node):
            yield from _leaves(value, f"{path}.{number}")
    else:
        yield path, node


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _near(scenes: list[tuple[int, str, dict[str, float], str]], found: Leaks) -> None:
    """Nearest neighbours among scenes that differ in numbers alone."""
    from scipy.spatial import cKDTree

    kinds: dict[str, list[tuple[int, str, dict[str, float]]]] = defaultdict(list)
    for number, part, numbers, kind in scenes:
        kinds[kind].append((number, part, numbers))
    own: list[float] = []
    pairs: dict[str, list[tuple[float, int, int]]] = defaultdict(list)
    for members in kinds.values():
        names = sorted(members[0][2])
        values = np.array([[one[2][name] for name in names] for one in members], float).reshape(
            len(members), len(names)
        )
        spread = np.ptp(values, axis=0)
        values = values[:, spread > 0] / spread[spread > 0]
        train = np.array([one[1] == "train" for one in members])
        if not values.shape[1] or not train.any():
            continue
        tree = cKDTree(values[train])
        order = np.array([one[0] for one in members])
        if train.sum() > 1:
            own += np.asarray(tree.query(values[train], k=2, p=np.inf)[0])[:, 1].tolist()
        for index in np.flatnonzero(~train):
            distance, nearest = tree.query(values[index], p=np.inf)
            part = members[int(index)][1]
            pairs[part].append((float(distance), int(order[index]), int(order[train][int(nearest)])))
    found.own = float(np.median(own)) if own else float("nan")
    for part, listed in sorted(pairs.items()):
        listed.sort()
        distances = [one[0] for one in listed]
        found.near.append(Near(part or "no part", len(listed), distances[0], float(np.median(distances)), listed[:3]))
