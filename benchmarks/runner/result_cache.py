"""Cache of results between runs: equal captures, estimators, parameters and machines need not be measured twice.

The key is a SHA-256 of everything on which a result can depend: every byte that the child reads (arrays, and the declared
rig of the condition), the label with its parameters, the estimator's source, the versions of the packages, and the machine.
Only results with status "ok" are stored; failures and skips are tried again. Scores are computed anew from every result, so
that truth, bounds and thresholds never come from the cache. Times and memory are those of the first measurement, and marked
as such (costs.csv, `source`).

A run uses the cache only with `--cache`: times are half of the result of a run, and by default they are measured.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from ...captures.layouts import stage_of
from ...optics.jit import user_cache
from ...scenes.errors import InputError
from ...scenes.npz import read_npz
from ..folders.record import machine, versions
from .estimator_labels import Chosen
from .protocol import content_id, file_sums, misshapen, unsound
from .session import Job, Outcome

__all__ = ["ResultCache", "cache_root", "source_of"]

#: Largest size of the cache; beyond it the oldest results are deleted.
_MOST_BYTES = 2 * 2**30
_COSTS = ("cpu_s", "wall_s", "peak_bytes")


def cache_root() -> Path:
    """(user cache)/beambench/results."""
    return user_cache() / "results"


@lru_cache(maxsize=64)
def source_of(name: str) -> str:
    """A hash of an estimator's source and version; "" if its source is unknown, so that its results are not stored.

    Built-in estimators share one hash of the folders that estimators may import. The hash of a plug-in is over the files of
    its distribution; a distribution that is installed for editing lists none, so its results are not stored.
    """
    from ...estimators import BUILTIN
    from ...estimators.labels import links_of

    links = links_of(name)
    if len(links) > 1:
        parts = [source_of(link) for link in links]
        return hashlib.sha256("".join(parts).encode()).hexdigest() if all(parts) else ""
    if name in BUILTIN:
        return _rooms()
    from ...estimators.points import plugin_points

    points = [point for point in plugin_points() if point.name == name]
    home = points[0].dist if len(points) == 1 else None
    if home is None:
        return ""
    module = points[0].value.partition(":")[0].replace(".", "/")
    files = [path for path in home.files or () if path.suffix in {".py", ".so", ".pyd"}]
    if not any(str(path).startswith(module.split("/")[0]) for path in files):
        return ""
    digest = hashlib.sha256(f"{home.name} {home.version}".encode())
    for path in sorted(files, key=str):
        try:
            digest.update(str(path).encode() + Path(str(path.locate())).read_bytes())
        except OSError:
            return ""
    return digest.hexdigest()


@lru_cache(maxsize=1)
def _rooms() -> str:
    folder = Path(__file__).resolve().parent
    digest = hashlib.sha256()
    import importlib.util

    for room in ("estimators", "optics", "captures", "scenes"):
        spec = importlib.util.find_spec(f"beambench.{room}")
        if spec is None or not spec.submodule_search_locations:
            raise InputError("A folder of the package is missing.", where=str(folder), value=room)
        place = Path(next(iter(spec.submodule_search_locations)))
        # Built-in weights count as source.
        for path in sorted([*place.rglob("*.py"), *place.rglob("*.npz")]):
            digest.update(f"{room}/{path.relative_to(place)}".encode() + path.read_bytes())
    for name in ("child.py", "attempt.py", "sealed.py", "tree.py"):  # the code that makes and times a call
        digest.update((folder / name).read_bytes())
    return digest.hexdigest()


def _named_files(label: str) -> list[str]:
    """SHA-256 of the files that a label's parameters name (weights), as a path does not identify the contents."""
    from ...estimators.labels import parse_label

    values = [value for value in parse_label(label)[1].values() if isinstance(value, str) and os.path.isabs(value)]
    return [hashlib.sha256(Path(value).read_bytes()).hexdigest() for value in sorted(values) if os.path.isfile(value)]


class ResultCache:
    """Results on disk, one file each.

    Main arguments:
        root: the folder; created on the first write. `hits` and `kept` count the results that were read and stored.
    """

    def __init__(self, root: Path | None = None) -> None:
        self.root = root if root is not None else cache_root()
        self.hits = self.kept = 0
        self._setting = json.dumps([machine(), versions()], sort_keys=True)
        self._captures: dict[tuple[Path, str], str] = {}

    def key(self, job: Job, chosen: Chosen) -> str:
        """The key of a result; "" if the estimator's source is unknown."""
        source = source_of(chosen.name)
        if not source:
            return ""
        parts = [self._capture(job), chosen.label, source, self._setting, *_named_files(chosen.label)]
        return hashlib.sha256("\n".join(parts).encode()).hexdigest()

    def _capture(self, job: Job) -> str:
        place = (job.folder, job.condition)
        if place not in self._captures:
            self._captures[place] = content_id(file_sums(job.folder), job.condition)
        return self._captures[place]

    def get(self, job: Job, chosen: Chosen) -> Outcome | None:
        """The stored result; None if there is none or its file is damaged."""
        key = self.key(job, chosen)
        path = self.root / f"{key}.npz"
        if not key or not path.is_file():
            return None
        try:
            data = read_npz(path, "The result")
            word = str(data["stage"])
            arrays = {name: data[name] for name in stage_of(word).dims()}
            costs = [float(value) for value in data["costs"]]
            cpu_calls, wall_calls = (tuple(map(float, data[name])) for name in ("cpu_calls", "wall_calls"))
        except (ValueError, KeyError, TypeError, InputError):
            return None
        known = dict(job.sizes)
        wrong = [
            name for name, dims in stage_of(word).dims().items() if misshapen(name, dims, arrays[name].shape, known)
        ]
        if wrong or len(costs) != len(_COSTS) or unsound(arrays, stage_of(word)):
            return None
        if not all(math.isfinite(value) and value >= 0 for value in (*costs, *cpu_calls, *wall_calls)):
            return None
        self.hits += 1
        cpu_s, wall_s, peak_bytes = costs
        return Outcome(
            job, "ok", arrays, cpu_s=cpu_s, wall_s=wall_s, peak_bytes=peak_bytes, cpu_calls=cpu_calls,
            wall_calls=wall_calls, word=word,
        )  # fmt: skip

    def put(self, outcome: Outcome, chosen: Chosen) -> None:
        """Store a result, unless it is a failure. Nothing happens if the cache cannot be written."""
        key = self.key(outcome.job, chosen) if outcome.status == "ok" else ""
        if not key:
            return
        partial = self.root / f"{key}.{os.getpid()}.partial"
        try:
            self.root.mkdir(parents=True, exist_ok=True)
            arrays: dict[str, Any] = {name: outcome.arrays[name] for name in outcome.stage.dims()}
            with open(partial, "wb") as file:
                for name in ("cpu_calls", "wall_calls"):
                    arrays[name] = np.array(getattr(outcome, name), np.float64)
                np.savez_compressed(
                    file,
                    stage=np.str_(outcome.stage.word),
                    costs=np.array([getattr(outcome, name) for name in _COSTS]),
                    **arrays,
                )
            os.replace(partial, self.root / f"{key}.npz")
        except OSError:
            partial.unlink(missing_ok=True)
            return
        self.kept += 1

    def prune(self) -> None:
        """Delete the oldest results until the cache is within its size."""
        if not self.root.is_dir():
            return
        found = sorted((path.stat().st_mtime, path.stat().st_size, path) for path in self.root.glob("*.npz"))
        total = sum(size for _, size, _ in found)
        for _, size, path in found:
            if total <= _MOST_BYTES:
                return
            path.unlink(missing_ok=True)
            total -= size
