"""The detector's chain link by link: what multiplies what, and what is clipped, each by a hand computation.

Each test fails for one wrong order of the chain: PRNU left out or applied to the dark current, DSNU left out, the full well
applied after the read noise too. Fixed patterns are written by hand, so that `fixed_pattern` has no part in it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from beambench.generator.detector import FixedPattern, detect
from beambench.scenes.rigs.parts import Detector, Intensifier

BASE: dict[str, Any] = {
    "dark_current_e_per_s": 0.0, "exposure_s": 1e-3, "read_noise_e": 0.0, "prnu": 0.1, "dsnu_e": 1.0,
    "gain_dn_per_e": 1.0, "offset_dn": 0.0, "full_well_e": 1e9, "adc_bits": 16, "fixed_pattern_seed": 1,
}  # fmt: skip
#: Relative response and dark offset (electrons) of three pixels.
RESPONSE, OFFSET = (0.5, 1.0, 1.4), (-30.0, 0.0, 45.0)
FRAMES = 4000
TUBE = {"gain": 4.0, "excess_noise_factor": 1.6, "phosphor_sigma_px": 0.0}


def frames(
    mean: float,
    *,
    response: tuple[float, ...] = (1.0, 1.0, 1.0),
    offset_e: tuple[float, ...] = (0.0, 0.0, 0.0),
    **changes: Any,
) -> NDArray[np.float64]:
    """Counts (frame, pixel) of three pixels under `mean` photoelectrons."""
    chip = Detector.model_validate(BASE | changes)
    pattern = FixedPattern(np.array([response], np.float32), np.array([offset_e], np.float32))
    expected = np.full((FRAMES, 1, 3), mean, np.float32)
    return detect(expected, chip, pattern, 11, 3).astype(np.float64)[:, 0]


@pytest.mark.parametrize("tube", [None, Intensifier.model_validate(TUBE)])
def test_the_relative_response_multiplies_light(tube: Intensifier | None) -> None:
    """Means 1000 ρ G, variances 1000 ρ G² F² + 1/12: 4,000 frames, within 4 standard errors.

    A standard error of the mean is below .003 of it (tube) where a missing ρ errs by 30 % and more.
    """
    gain, excess = (1.0, 1.0) if tube is None else (4.0, 1.6)
    y = frames(1000.0, response=RESPONSE, intensifier=tube)
    mean = 1000.0 * np.array(RESPONSE) * gain
    variance = mean * gain * excess + 1.0 / 12.0
    assert np.all(np.abs(y.mean(axis=0) - mean) < 4.0 * np.sqrt(variance / FRAMES))
    # Nearly Gaussian: the standard error of a variance is √(2/n) of it.
    assert np.all(np.abs(y.var(axis=0, ddof=1) / variance - 1.0) < 4.5 * np.sqrt(2.0 / FRAMES))


@pytest.mark.parametrize("tube", [None, Intensifier.model_validate(TUBE)])
def test_the_relative_response_leaves_dark_electrons_alone(tube: Intensifier | None) -> None:
    """In the dark all pixels have the Poisson mean of 800, whatever their response to light: 4 of .45 electrons."""
    y = frames(0.0, response=RESPONSE, dark_current_e_per_s=8e5, intensifier=tube)
    assert np.all(np.abs(y.mean(axis=0) - 800.0) < 4.0 * np.sqrt((800.0 + 1.0 / 12.0) / FRAMES))
    assert np.all(np.abs(y.var(axis=0, ddof=1) / (800.0 + 1.0 / 12.0) - 1.0) < 4.5 * np.sqrt(2.0 / FRAMES))


def test_dark_offsets_are_added_before_the_gain_and_hold_no_noise() -> None:
    """Mean K (μ + d_i) + offset, variance that of the light alone: K²μ + 1/12."""
    y = frames(500.0, offset_e=OFFSET, gain_dn_per_e=2.0, offset_dn=100.0)
    mean, variance = 2.0 * (500.0 + np.array(OFFSET)) + 100.0, 4.0 * 500.0 + 1.0 / 12.0
    assert np.all(np.abs(y.mean(axis=0) - mean) < 4.0 * np.sqrt(variance / FRAMES))
    assert np.all(np.abs(y.var(axis=0, ddof=1) / variance - 1.0) < 4.5 * np.sqrt(2.0 / FRAMES))


def test_the_full_well_holds_electrons_back_but_not_the_read_noise() -> None:
    """A brimful well gives 1000 electrons in every frame; read noise of 20 then falls to both sides of it.

    Clipped once more after the read noise, the mean would be 1000 − 20/√(2π) = 992.0 and half of all frames equal.
    """
    y = frames(1e5, full_well_e=1000.0, read_noise_e=20.0)
    assert np.all(np.abs(y.mean(axis=0) - 1000.0) < 4.0 * 20.0 / np.sqrt(FRAMES))
    assert np.all(np.abs(y.std(axis=0, ddof=1) / 20.0 - 1.0) < 4.0 / np.sqrt(2.0 * FRAMES))
    above = (y > 1000.5).mean(axis=0)
    assert np.all(np.abs(above - 0.49) < 4.0 * 0.5 / np.sqrt(FRAMES))  # P(20 z > .5) = .490


def test_the_full_well_is_not_moved_by_a_dark_offset() -> None:
    """The offset belongs to the readout: a brimful well of 1000 reads 1000 + d_i, no noise at all."""
    y = frames(1e5, full_well_e=1000.0, offset_e=OFFSET)
    np.testing.assert_array_equal(y, np.broadcast_to(1000.0 + np.array(OFFSET), y.shape))


def test_the_full_well_counts_dark_electrons_too() -> None:
    """2,000 photoelectrons alone stay below the well of 2,500; with 2,000 dark electrons it is full in every frame."""
    alone = frames(2000.0, full_well_e=2500.0)
    assert np.all(np.abs(alone.mean(axis=0) - 2000.0) < 4.0 * np.sqrt(2000.0 / FRAMES))
    both = frames(2000.0, full_well_e=2500.0, dark_current_e_per_s=2e6)
    assert np.all(both == 2500.0)
