"""The response of an estimate to the truth's detail: 1 by itself, that of a mean in closed form, nothing without detail."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from beambench.benchmarks.scores.resolution import (
    RESOLUTION_COLUMNS,
    gives_up,
    pooled_response,
    read_resolution,
    resolution_rows,
    resolution_warnings,
    response,
    write_resolution,
)
from beambench.benchmarks.scores.truth import Truth
from beambench.captures.layouts import stage_of

KEY = {
    "suite": "s", "scene": "wall", "stress": "none", "level": math.nan, "stress2": "none", "level2": math.nan, "seed": 1,
    "condition": "matched", "estimator": "e", "params": "",
}  # fmt: skip


def mean_of(image: np.ndarray, width: int) -> np.ndarray:
    """Mean over `width` neighbours along the last axis; ends as they are."""
    half = width // 2
    found = image.copy()
    found[..., half:-half] = np.lib.stride_tricks.sliding_window_view(image, width, axis=-1).mean(axis=-1)
    return found


@pytest.mark.parametrize(("width", "kept"), [(3, 0.5), (5, 0.1)])
def test_a_mean_over_neighbours_keeps_what_a_step_shows(width: int, kept: float) -> None:
    """By hand, h the step: second differences h, h, −h, −h; after a mean over three 2h/3, h/3, …, over five h/5, 0, …"""
    step = np.where(np.arange(40) < 20, 0.0, 1.0)[None].repeat(3, axis=0)
    found, _, n = response(mean_of(step, width), np.ones(step.shape, bool), step, [1])
    assert found == pytest.approx(kept) and n == 3 * 36


def test_the_transfer_is_that_of_a_period_of_four() -> None:
    """cos(πx/2), period four: a mean over three has the transfer (1 + 2 cos(π/2))/3 = 1/3."""
    wave = np.cos(0.5 * np.pi * np.arange(200))[None]
    (inside,) = (slice(2, -2),)
    found, _, _ = response(mean_of(wave, 3)[:, inside], np.ones((1, 196), bool), wave[:, inside], [1])
    assert found == pytest.approx(1.0 / 3.0)


def test_noise_leaves_it_at_one_and_its_standard_error_is_true() -> None:
    """400 draws: the mean within 4 of its standard errors, the stated error within 15 % of the spread (4 · 3.5 %)."""
    rng = np.random.default_rng(3)
    truth, valid = rng.standard_normal((16, 16)), rng.random((16, 16)) > 0.1
    drawn = [response(truth + 2.0 * rng.standard_normal(truth.shape), valid, truth, [0, 1]) for _ in range(400)]
    values, stated = (np.array([one[i] for one in drawn]) for i in (0, 1))
    assert abs(values.mean() - 1.0) < 4.0 * values.std() / 20.0
    assert np.sqrt((stated**2).mean()) == pytest.approx(values.std(), rel=0.15)


def test_invalid_elements_and_planes_tell_nothing() -> None:
    row, col = np.mgrid[:12, :12]
    plane, everywhere = 2.0 + 0.1 * row + 0.25 * col, np.ones((12, 12), bool)
    assert math.isnan(response(np.zeros((12, 12)), everywhere, np.full((12, 12), 3.0), [0, 1])[0])
    stage = stage_of("gated")
    answer = {"range": plane + 0.01, "sigma": np.ones((12, 12)), "valid": everywhere}
    noisy = answer | {"range": plane + np.random.default_rng(1).normal(0.0, 0.1, (12, 12))}
    assert resolution_rows(KEY, stage, noisy, {"range": Truth.plain(plane)}) == []
    rough = plane + np.random.default_rng(2).standard_normal((12, 12))
    spoilt = np.where(row == 5, 1e300, rough)
    (one,) = resolution_rows(KEY, stage, answer | {"range": spoilt, "valid": row != 5}, {"range": Truth.plain(rough)})
    assert one["response"] == 1.0
    assert resolution_rows(KEY, stage, answer | {"range": rough, "valid": row < 0}, {"range": Truth.plain(rough)}) == []


def test_who_smooths_is_named_and_the_table_is_read_back(tmp_path: Path) -> None:
    rng, stage = np.random.default_rng(5), stage_of("gated")
    rows = []
    for seed in (1, 2):
        truth = rng.standard_normal((16, 24))
        noisy = truth + rng.standard_normal(truth.shape)
        for name, value in (("honest", noisy), ("smooth", np.broadcast_to(noisy.mean(1, keepdims=True), truth.shape))):
            answer = {"range": value, "sigma": np.ones(truth.shape), "valid": np.ones(truth.shape, bool)}
            rows += resolution_rows(
                KEY | {"estimator": name, "seed": seed}, stage, answer, {"range": Truth.plain(truth)}
            )
    write_resolution(tmp_path, rows)
    read = read_resolution(tmp_path)
    assert len(read) == 4 and tuple(read[0]) == RESOLUTION_COLUMNS
    (told,) = resolution_warnings(read)
    assert told.startswith("smooth keeps") and resolution_warnings(rows) == [told]
    honest = pooled_response(row for row in read if row["estimator"] == "honest")
    assert abs(honest[0] - 1.0) < 4.0 * honest[1] and not gives_up(honest)
    assert (
        read_resolution(tmp_path / "none") == []
        and math.isnan(pooled_response([])[0])
        and not gives_up(pooled_response([]))
    )
