"""Line finders against the bound over width and light, what joins rows, and speed beside `np.argmax` and other packages."""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np
import pytest

from beambench.benchmarks.checks.line_accuracy import line_errors
from beambench.benchmarks.peers.along_line import rise_rows, step_answer
from beambench.benchmarks.peers.line_finders import CHAIN, against_argmax, against_peers, exponents


@pytest.mark.parametrize("width", [0.75, 1.2, 2.0])
@pytest.mark.parametrize("snr", [10.0, 30.0])
def test_the_best_finder_of_one_row_meets_the_bound_with_a_true_sigma(width: float, snr: float) -> None:
    """4096 rows: four standard errors of an rms are .044. It sees a sigma that is 5 % wrong, and light or pixels left unused."""
    got = line_errors("line-ml", width, snr, seeds=8)
    assert got["outliers"] < 2e-3
    assert 1 - 0.044 < got["ratio"] < 1.05 + 0.022
    assert got["z_rms"] == pytest.approx(1.0, abs=0.05)
    assert abs(got["bias"]) < 4 / np.sqrt(4096)


def test_a_line_without_light_is_an_outlier_and_no_guess() -> None:
    assert line_errors("line-ml", 0.5, 0.5, seeds=1)["outliers"] > 0.98


@pytest.mark.parametrize(
    ("label", "rows"),
    [("line-ml", 0.8), ("line-log-gaussian", 0.8), ("line-steger", 2.56 * 0.9), ("line-steger[scale=2.0]", 2.56 * 2.0)],
)
def test_the_step_response_is_that_of_the_smoothing(label: str, rows: float) -> None:
    """A Gaussian of σ rows rises from 10 to 90 % over 2.56 σ; straight lines between rows add up to a tenth at σ = .9."""
    assert rise_rows(label) == pytest.approx(rows, rel=0.11)


def test_a_step_is_answered_from_nothing_to_all() -> None:
    answer = step_answer("line-steger")
    good = answer[np.isfinite(answer)]
    assert abs(good[0]) < 1e-3 and abs(good[-1] - 1) < 1e-3 and (np.diff(good) > -1e-6).all()
    assert answer[47:49].mean() == pytest.approx(0.5, abs=0.02)


def test_a_frame_is_found_and_triangulated_within_20_argmax() -> None:
    """The cheapest exact chain at the large size: 9 to 12 times on two processors. The most precise one: 11 times on a quiet
    machine, 17 and 18 beside busy processes, which slow argmax less. A small frame costs what a call costs: 16 times where
    argmax takes 40 µs, 44 to 55 where it takes 17 µs beside busy processes."""
    small, large = against_argmax(((256, 192), (1024, 1280)), turns=8)
    assert large["cheapest"] < 20 * large["argmax"], large
    assert large["chain"] < 30 * large["argmax"], large
    assert small["cheapest"] < 100 * small["argmax"], small


def test_the_exponents_are_those_of_the_times() -> None:
    """Times of 2 µs a row and 3 ns a pixel are split into these; a cost of pixels alone has the power 1."""
    sizes = ((100, 80), (400, 900), (1000, 1300))
    table = [{"rows": r, "cols": c, "x": 2e-6 * r + 3e-9 * r * c, "y": 1e-9 * r * c} for r, c in sizes]
    power, per_row, per_pixel = exponents(table, "x")
    assert power < 0.9 and per_row == pytest.approx(2e-6) and per_pixel == pytest.approx(3e-9)
    assert exponents(table, "y")[0] == pytest.approx(1.0)
    assert CHAIN.startswith("line-ml+")


@pytest.mark.peer
def test_ours_are_faster_and_more_accurate_than_opencv() -> None:
    if find_spec("cv2") is None:
        pytest.skip("opencv-python-headless is not installed (extra `peers`)")
    table = against_peers(768, 960, slow=False)
    ours, peer = table["line-ml"], table["opencv-steger"]
    assert peer["found"] > 0.99 and peer["rms_px"] < 0.05, "the peer works"
    assert ours["rms_px"] < peer["rms_px"] and ours["cpu_s"] < peer["cpu_s"]


@pytest.mark.peer
def test_ours_are_200_times_as_fast_as_ridge_detection() -> None:
    if find_spec("ridge_detection") is None:
        pytest.skip("ridge-detection is not installed (extra `peers`)")
    table = against_peers(256, 192, turns=3)
    ours, peer = table["line-ml"], table["ridge-detection"]
    assert peer["found"] > 0.95 and peer["rms_px"] < 0.1, "the peer works"
    assert ours["rms_px"] < peer["rms_px"] and 200 * ours["cpu_s"] < peer["cpu_s"]
