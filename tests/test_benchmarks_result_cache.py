"""Cached results: reused only for the same capture, estimator, parameters, source and machine; never for a failure."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beambench.benchmarks.runner import result_cache
from beambench.benchmarks.runner.estimator_labels import Chosen, check_estimators
from beambench.benchmarks.runner.result_cache import ResultCache, source_of
from beambench.benchmarks.runner.session import Job, Outcome

SUITE: dict[str, Any] = {
    "suite": "kept", "scenes": ["flat-wall"], "seeds": {"test": [1, 2]}, "estimators": ["peak", "weighted-average"],
}  # fmt: skip
SIZE = {"rig.camera.rows": 8, "rig.camera.cols": 8}


def _job(folder: Path, value: int = 1, rig: str = "{}", condition: str = "matched") -> Job:
    folder.mkdir(exist_ok=True)
    np.save(folder / "counts.npy", np.full((2, 3, 4), value, np.uint16))
    (folder / f"meta-{condition}.json").write_text(rig)
    return Job(0, folder, condition, "gated", {"row": 3, "col": 4})


def _outcome(job: Job, status: str = "ok") -> Outcome:
    arrays = {"range": np.full((3, 4), 5.0), "sigma": np.full((3, 4), 0.1), "valid": np.ones((3, 4), bool)}
    return Outcome(job, status, arrays, cpu_s=0.1, wall_s=0.2, peak_bytes=300.0)


def test_an_answer_is_taken_up_again(tmp_path: Path) -> None:
    (peak,) = check_estimators(["peak"])
    job = _job(tmp_path / "a")
    cache = ResultCache(tmp_path / "kept")
    assert cache.get(job, peak) is None
    cache.put(_outcome(job), peak)
    found = ResultCache(tmp_path / "kept").get(job, peak)
    assert (
        found is not None and found.status == "ok" and (found.cpu_s, found.wall_s, found.peak_bytes) == (0.1, 0.2, 300)
    )
    for name, array in _outcome(job).arrays.items():
        assert (found.arrays[name] == array).all() and found.arrays[name].dtype == array.dtype
    # The same bytes under another name and number are the same capture.
    assert ResultCache(tmp_path / "kept").get(_job(tmp_path / "elsewhere"), peak) is not None


def test_everything_that_an_answer_depends_on_is_in_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (peak, other) = check_estimators(["peak", "weighted-average[background=outside]"])
    job = _job(tmp_path / "a")
    keys = {ResultCache(tmp_path).key(job, peak), ResultCache(tmp_path).key(job, other)}
    keys.add(ResultCache(tmp_path).key(_job(tmp_path / "b", value=2), peak))
    keys.add(ResultCache(tmp_path).key(_job(tmp_path / "c", rig='{"t0_s": 1}'), peak))
    with monkeypatch.context() as patch:
        patch.setattr(result_cache, "source_of", lambda name: "another source")
        keys.add(ResultCache(tmp_path).key(job, peak))
    with monkeypatch.context() as patch:
        patch.setattr(result_cache, "machine", lambda: {"processor": "another"})
        keys.add(ResultCache(tmp_path).key(job, peak))
    with monkeypatch.context() as patch:
        patch.setattr(result_cache, "versions", lambda: {"numpy": "another"})
        keys.add(ResultCache(tmp_path).key(job, peak))
    assert len(keys) == 7 and "" not in keys
    # A calibrated rig that equals the matched one is the same input under either name of the condition.
    assert ResultCache(tmp_path).key(_job(tmp_path / "d", condition="calibrated"), peak) in keys


def test_failures_and_unknown_sources_are_not_kept(tmp_path: Path) -> None:
    (peak,) = check_estimators(["peak"])
    job = _job(tmp_path / "a")
    cache = ResultCache(tmp_path / "kept")
    cache.put(_outcome(job, "timeout: call over 1 s"), peak)
    cache.put(_outcome(job), Chosen("nobody-knows", "", "nobody-knows"))
    assert source_of("nobody-knows") == "" and cache.kept == 0 and not (tmp_path / "kept").exists()


def test_a_damaged_file_is_no_answer(tmp_path: Path) -> None:
    (peak,) = check_estimators(["peak"])
    job = _job(tmp_path / "a")
    cache = ResultCache(tmp_path / "kept")
    cache.put(_outcome(job), peak)
    (file,) = (tmp_path / "kept").iterdir()
    for damage in (b"", b"PK", file.read_bytes()[:200]):
        file.write_bytes(damage)
        assert cache.get(job, peak) is None


def test_the_oldest_go_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import os

    cache = ResultCache(tmp_path)
    for number in range(5):
        (tmp_path / f"{number}.npz").write_bytes(b"x" * 100)
        os.utime(tmp_path / f"{number}.npz", (number, number))
    monkeypatch.setattr(result_cache, "_MOST_BYTES", 250)
    cache.prune()
    assert sorted(path.stem for path in tmp_path.iterdir()) == ["3", "4"]


def test_a_run_takes_up_what_another_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Equal tables, byte for byte, times included; without the flag nothing is read or kept."""
    from beambench import run

    monkeypatch.setattr(result_cache, "cache_root", lambda: tmp_path / "kept")
    run(SUITE, overrides=SIZE, out=tmp_path / "plain", report=False)
    assert not (tmp_path / "kept").exists()
    runs = [run(SUITE, overrides=SIZE, out=tmp_path / name, report=False, cache=True).out for name in ("one", "two")]
    counts = [json.loads((folder / "run.json").read_text())["answers_from_cache"] for folder in runs]
    assert counts == [0, 4]
    assert (runs[0] / "scores.csv").read_bytes() == (runs[1] / "scores.csv").read_bytes()
    plain = (tmp_path / "plain" / "accuracy.csv").read_bytes()
    assert all((folder / "accuracy.csv").read_bytes() == plain for folder in runs)


def test_other_weights_in_the_same_file_are_another_answer(tmp_path: Path) -> None:
    weights = tmp_path / "w.npz"
    label = f"learned[weights={weights}]"
    chosen, cache = Chosen("learned", f"weights={weights}", label), ResultCache(tmp_path / "cache")
    job = _job(tmp_path / "job")
    names = set()
    for content in (b"one", b"two"):
        weights.write_bytes(content)
        names.add(cache.key(job, chosen))
    assert len(names) == 2
