"""Calibration of laser lines: corners of a board, bundle adjustment through refraction, and real images."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from beambench.benchmarks.checks.laser_stereo15 import LINES, found_lines, read_image, seen_lines

# ---------------------------------------------------------------- a piece of a real image


def test_fifteen_lines_are_found_on_a_real_image() -> None:
    """48 rows of a real image. The lines are 37 px apart at this distance, evenly to 1 px, and straight: each leaves its own
    straight line by less than .35 px rms (.2 px of speckle and noise); a finder that merges or loses lines fails the count."""
    image = read_image(Path(__file__).parent / "laser_stereo15" / "lines.png")
    row, col = found_lines(2.0 * image[..., 1] - image[..., 0], 25, 20)
    lines = seen_lines(row, col, least=24)
    assert len(lines) == LINES
    places = []
    for at, column in lines:
        assert at.size >= 36
        fit = np.polyfit(at, column, 1)
        assert np.sqrt(np.mean((column - np.polyval(fit, at)) ** 2)) < 0.35
        places.append(float(np.polyval(fit, 24.0)))
    assert np.abs(np.diff(places) - 37.0).max() < 1.5
