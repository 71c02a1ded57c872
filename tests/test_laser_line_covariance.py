"""The covariance that a rig of a laser line declares: variances that are none."""

from __future__ import annotations

import pytest

from beambench import InputError
from beambench.scenes.load import load_scene


@pytest.mark.parametrize(
    "covariance", [[[-1e-12, 0.0], [0.0, 1.0]], [[0.0, 1e-12], [1e-12, 1.0]], [[1e308, 0.0], [0.0, 1.0]]]
)
def test_variances_below_0_or_beyond_numbers_are_refused(covariance: list[list[float]]) -> None:
    """Small ones were taken for rounding, and huge ones failed when the capture was written."""
    held = {"paths": ["camera.focal_length_m", "port.stand_off_m"], "covariance": covariance}
    with pytest.raises(InputError, match="A value is not allowed") as told:
        load_scene("spotscan-wall", overrides={"rig.calibration": held})
    assert "variances from 0" in str(told.value)
