"""The measurement of fidelity: its family of scenes, its errors, its rules, and its tables."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beambench.benchmarks.fidelity import run as fidelity
from beambench.benchmarks.fidelity.bias import scale_bias
from beambench.benchmarks.fidelity.chart import chart_points
from beambench.benchmarks.fidelity.family import MEDIA, SHAPES, STRATA, draw_scene, family
from beambench.benchmarks.fidelity.measure import References, measure_scene, verdict
from beambench.benchmarks.fidelity.rules import decisions, policy_rows, summarise
from beambench.benchmarks.fidelity.run import COLUMNS, read_rows, run_fidelity
from beambench.generator.gated.error import replicate_error, stack_error, task_error
from beambench.generator.rays.trace import Tracer
from beambench.scenes.errors import InputError


def test_the_family_holds_every_medium_and_shape_and_is_seeded(tmp_path: Path) -> None:
    scenes = family(4, 60, tmp_path)
    names = {tuple(s.name.split("-")[:3]) for s in scenes}
    assert {n[0] for n in names} == set(MEDIA) and {n[1] for n in names} == set(SHAPES)
    assert {n[2] for n in names} == {"near", "far"}
    for medium, shapes, _ in STRATA:
        assert {(m, s) for m, s, _ in names} >= {(medium, s) for s in shapes}
    assert family(4, 60, tmp_path) == scenes
    assert family(5, 60, tmp_path) != scenes
    assert family(4, 7, tmp_path) == scenes[:7]
    for scene in scenes[:10]:
        Tracer(scene)


def _references(noise: float, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.float32(1.0) + np.float32(noise) * rng.standard_normal((2, 20, 30, 30)).astype(np.float32)


def test_error_is_free_of_the_references_noise() -> None:
    """A stack that is 3 % too bright, against two references with 20 % noise: ε = 3 % within its interval's width."""
    truth = np.ones((20, 30, 30), dtype=np.float32)
    one, two = _references(0.2, 1)
    error, low, high = stack_error(np.float32(1.03) * truth, one, two)
    assert low < 0.03 < high and error == pytest.approx(0.03, rel=0.25)


def test_intervals_of_replicates_cover() -> None:
    """True ε 3 %, 60 pairs of references with 10 % noise: the 95 % interval holds it in all but 60·.05 + 4σ = 10 at most, and
    is never so wide that it holds zero and twice as much."""
    x = np.full((20, 30, 30), 1.03, dtype=np.float32)
    missed = 0
    for seed in range(60):
        error, low, high = replicate_error(x, _references(0.1, 2 * seed), _references(0.1, 2 * seed + 1))
        missed += not low <= 0.03 / 1.0 <= high
        assert low <= error <= high and low > 0 and high < 0.06
    assert missed <= 10


def test_task_error_of_a_shift_is_the_shift_over_the_bound() -> None:
    time = np.linspace(-4, 4, 60)[:, None, None]
    one = np.ones((1, 2, 2), dtype=np.float32)
    truth = (1000 * np.exp(-(time**2) / 2) + 5).astype(np.float32) * one
    slope = (1000 * time * np.exp(-(time**2) / 2)).astype(np.float32) * one
    bound = 1 / np.sqrt(np.sum(slope[:, 0, 0] ** 2 / truth[:, 0, 0]))
    shifted = truth + 0.1 * bound * slope
    assert task_error(shifted, (truth, truth), slope, truth) == pytest.approx(0.1, rel=1e-3)
    # noise of either reference has no part in the mean: 40 % of the bound in each, 4 of 10 000 products
    rng = np.random.default_rng(1)
    many = np.tile(truth, (1, 50, 50))
    noisy = [many + 0.4 * np.sqrt(many) * rng.standard_normal(many.shape).astype(np.float32) for _ in range(2)]
    wide = np.tile(slope, (1, 50, 50))
    found = task_error(np.tile(shifted, (1, 50, 50)), (noisy[0], noisy[1]), wide, many)
    assert found == pytest.approx(0.1, abs=3 * 0.4**2 / (2 * 0.1 * math.sqrt(10_000)))


def test_a_rung_is_undecided_where_its_interval_holds_the_limit() -> None:
    assert [verdict(*pair, 0.01, "independent") for pair in ((0.0, 0.01), (0.009, 0.011), (0.0101, 0.02))] == [
        "pass", "undecided", "fail",
    ]  # fmt: skip


def _rows(
    scene: str, rtol: float | str, chosen: str, reference: str = "independent", **verdicts: str
) -> list[dict[str, Any]]:
    error = {"pass": 0.5, "fail": 2.0, "undecided": 1.0, "self-consistent": 0.5, "self-inconsistent": 2.0}
    limit = 0.2 if rtol == "noise" else float(rtol)
    return [
        {
            "scene": scene, "rtol": rtol, "limit": limit, "rung": rung, "verdict": word, "chosen": rung == chosen,
            "cpu_s": {"direct": 0.1, "scatter": 1.0, "full": 10.0}[rung], "choice_cpu_s": 0.5, "rel_error": error[word] * limit,
            "predicted_error": error[word] * limit, "task_error": 0.05, "lo": 0.4 * limit, "hi": 2 * limit,
            "reference": reference, "bias_seen": 0.02,
        }
        for rung, word in verdicts.items()
    ]  # fmt: skip


def test_policies_are_counted_over_decided_scenes_and_the_rest_is_told() -> None:
    rows = [
        *_rows("a", 0.1, "direct", direct="pass", scatter="pass", full="pass"),
        *_rows("b", 0.1, "full", direct="fail", scatter="pass", full="pass"),  # dearer than needed
        *_rows("c", 0.1, "scatter", direct="fail", scatter="undecided", full="pass"),
        *_rows("d", 0.1, "direct", direct="fail", scatter="fail", full="fail"),  # none passes
        *_rows("a", "noise", "direct", direct="pass", scatter="pass", full="pass"),
    ]
    every = decisions(rows)
    assert [d.right for d in every] == ["direct", "scatter", "full", None, "direct"]
    table = {(r["policy"], r["rtol"]): r for r in policy_rows(every) if r["reference"] == "independent"}
    auto, full, cheap = (table[p, "0.1"] for p in ("auto", "always-full", "always-cheapest"))
    assert auto["decisions"] == full["decisions"] == 3 and auto["undecided"] == 1 and auto["none_passes"] == 1
    assert auto["within_rtol"] == full["within_rtol"] == pytest.approx(2 / 3)
    assert cheap["within_rtol"] == cheap["cheapest"] == pytest.approx(1 / 3)
    assert auto["cheapest"] == pytest.approx(1 / 3) and full["cheapest"] == 0.0
    assert auto["cpu_s"] == pytest.approx(0.1 + 10.0 + 0.1 + 3 * 0.5) and full["cpu_s"] == pytest.approx(30.0)
    assert auto["lo"] < auto["within_rtol"] < auto["hi"]
    assert table["auto", "all"]["decisions"] == 3  # "noise" has rows of its own
    told = summarise(rows)
    assert told["undecided"] == 1 and told["right rung"] == {"direct": 1, "scatter": 1, "full": 0}
    assert told["contested"]["scatter"] == 1 and told["task error at rtol noise"]["below 0.1"] == 1
    points = chart_points(rows)
    assert {p["place"] for p in points} <= {"front", "dominated", "undecided"} and len(points) == 12


def test_agreement_with_our_own_full_rung_is_counted_apart() -> None:
    rows = [
        *_rows("a", 0.1, "direct", direct="pass", full="pass"),
        *_rows("b", 0.1, "direct", "own", direct="self-consistent", full="self-consistent"),
        *_rows("c", 0.1, "full", "own", direct="self-inconsistent", full="self-consistent"),
    ]
    table = {(r["reference"], r["policy"], r["rtol"]): r for r in policy_rows(decisions(rows))}
    assert table["independent", "auto", "all"]["decisions"] == 1
    assert (
        table["own", "auto", "all"]["decisions"] == 2 and table["own", "always-cheapest", "0.1"]["within_rtol"] == 0.5
    )
    assert (
        verdict(0.0, 0.005, 0.01, "own") == "self-consistent"
        and verdict(0.02, 0.03, 0.01, "own") == "self-inconsistent"
    )


def test_a_systematic_error_of_full_is_seen_by_other_code_only() -> None:
    """A stack 5 % too bright: two seeds of ours agree to their noise, two stacks of other code do not."""
    rng = np.random.default_rng(4)
    truth = 100.0 * np.exp(-0.5 * ((np.arange(16)[:, None, None] - 8.0) / 3.0) ** 2) * np.ones((16, 24, 24))

    def drawn(scale: float, noise: float, *shape: int) -> Any:
        return (scale * truth * (1.0 + noise * rng.standard_normal((*shape, *truth.shape)))).astype(np.float32)

    bright = 1.05
    own = References(drawn(bright, 0.02, 2), drawn(bright, 0.02, 2), None, math.nan)
    other = References(own.ones, own.twos, drawn(1.0, 0.2, 2), 0.01)
    rung = drawn(bright, 0.0)
    assert own.error(rung)[2] < 0.01 and verdict(*own.error(rung)[1:], 0.01, own.kind) == "self-consistent"
    assert verdict(*other.error(rung)[1:], 0.01, other.kind) == "fail"
    found = other.bias_of_full()
    assert found.interval[0] < 0.05 < found.interval[1] and found.seen <= 0.02
    assert own.bias_of_full().seen != own.bias_of_full().seen  # no other code, no bias that would have been seen


def test_the_standard_error_of_a_bias_is_its_scatter() -> None:
    rng = np.random.default_rng(5)
    truth = np.ones((4, 12, 12))
    found = [
        scale_bias(
            (truth * 1.02).astype(np.float32),
            *((truth * (1.0 + 0.3 * rng.standard_normal(truth.shape))).astype(np.float32) for _ in range(2)),
            seed=draw,
        )
        for draw in range(200)
    ]
    values = np.array([one.value for one in found])
    # The mean of 200 within 4 standard errors; the scatter of 200 is known to 5 %, the bootstrap's own to a few.
    assert abs(values.mean() - 0.02) < 4 * values.std() / math.sqrt(200)
    assert np.mean([one.sigma for one in found]) == pytest.approx(values.std(), rel=0.2)


def test_rows_of_a_dark_corner(tmp_path: Path) -> None:
    scene = draw_scene(3, 0, "air", "corner", False, tmp_path, "albedo")
    rows, told = measure_scene(scene, 3, (0.1, 0.01))
    assert [(r["rtol"], r["rung"]) for r in rows] == [(q, r) for q in (0.1, 0.01) for r in ("direct", "full")]
    assert told["references"] == "independent" and told["full_against_peer_interval"][0] < 0.01
    assert told["bias_interval"][0] < 0.0 < told["bias_interval"][1] and told["bias_seen"] <= 0.05
    direct, full = rows[2:]
    assert full["verdict"] == "pass" and full["lo"] <= full["rel_error"] <= full["hi"]
    assert direct["predicted_error"] == pytest.approx(direct["rel_error"], rel=0.3)
    assert sum(r["chosen"] for r in rows) == 2


def test_a_measurement_is_resumed_after_its_last_whole_scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[str] = []

    def measured(scene: Any, seed: int) -> Any:
        if len(seen) == 2:
            raise KeyboardInterrupt
        seen.append(scene.name)
        row = {"modality": "gated"} | _rows(scene.name, 0.1, "direct", direct="pass", full="pass")[0]
        return [row, row | {"rung": "full", "chosen": False}], {"scene": scene.name, "references": "own"}

    monkeypatch.setattr(fidelity, "measure_scene", measured)
    with pytest.raises(KeyboardInterrupt):
        run_fidelity(4, 2, tmp_path)
    assert len(read_rows(tmp_path / "fidelity.csv")) == 4 and not (tmp_path / "policies.csv").exists()
    first = list(seen)
    seen.append("a third was interrupted")
    lines: list[str] = []
    run_fidelity(4, 2, tmp_path, lines.append, resume=True)
    assert seen[:2] == first and len(seen) == 5 and lines[0].startswith("3/4")
    assert len({r["scene"] for r in read_rows(tmp_path / "fidelity.csv")}) == 4
    assert (tmp_path / "fidelity.csv").read_text().splitlines()[0] == ",".join(COLUMNS)
    assert json.loads((tmp_path / "fidelity.json").read_text())["scenes"] == 4
    assert (tmp_path / "fidelity.svg").read_text().startswith("<svg")
    assert (tmp_path / "policies.csv").read_text().startswith("policy,rtol,decisions,within_rtol,lo,hi,cheapest")
    with pytest.raises(InputError, match="other scenes"):
        run_fidelity(4, 3, tmp_path, resume=True)
