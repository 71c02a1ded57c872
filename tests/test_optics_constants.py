"""Constants against their definitions."""

from __future__ import annotations

import numpy as np
import scipy.constants

from beambench.optics import constants


def test_constants_are_those_of_the_si() -> None:
    assert scipy.constants.c == constants.C_M_PER_S
    assert scipy.constants.h == constants.PLANCK_J_S
    # To rounding: sqrt and log are within half a unit each.
    assert abs(constants.FWHM_PER_SIGMA / np.sqrt(8.0 * np.log(2.0)) - 1.0) < 4e-16
