"""χ² of a delay scan with few laser-off frames: the noise of the dark level is no light."""

from __future__ import annotations

import math

import numpy as np
import pytest

from beambench.estimators.calibration.gated_delay_scan import delay_scan_values, known_range
from beambench.estimators.calibration.gated_scan import read_scan
from beambench.generator.generate import generate
from beambench.scenes.load import load_scene


@pytest.mark.parametrize("dark", [4, 16])
def test_chi_square_is_that_of_its_degrees_of_freedom_whatever_the_number_of_dark_frames(dark: int) -> None:
    """Of pixels that the wall fills, in a scan most of whose delays are dark: 1 within four standard errors and the half
    percent that the slope of the photon transfer errs by. It was .965 with four dark frames, and .974 with sixteen."""
    delays = {
        "kind": "listed", "values_s": list(29.5e-9 + 0.15e-9 * np.arange(64)), "repeats": 6, "laser_off": dark
    }  # fmt: skip
    scene = {"rig.camera.rows": 48, "rig.camera.cols": 48, "rig.camera.pixel_pitch_m": 34e-6, "rig.delays": delays}
    capture = generate(load_scene("flat-wall", scene), seed=3)
    fit = delay_scan_values(read_scan(capture), known_range(capture)).fit
    filled = fit.single & (fit.amplitude > 0.9 * np.median(fit.amplitude[fit.amplitude > 0.5 * fit.amplitude.max()]))
    chi2 = fit.chi2[filled] / fit.dof
    assert filled.sum() > 1000
    assert chi2.mean() == pytest.approx(1.0, abs=4 * math.sqrt(2.0 / fit.dof / filled.sum()) + 0.005)
