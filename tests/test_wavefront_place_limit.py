"""What a spot tells of its lenslet's mean slope: limits of known and of unknown shape, and fits that obey them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from beambench.benchmarks.checks import spot_likelihood as check
from beambench.optics.lenslets.place_limit import place_limit
from beambench.optics.lenslets.spots import pixel_share_slopes, pixel_shares

OPTICS: dict[str, Any] = {"width_px": 1.335, "half_px": 4.2, "background": 1.0, "read_noise_e": 3.0}


def test_a_plane_wave_leaves_the_bound_of_the_known_shape() -> None:
    """That of pixels integrated in closed form, a spot in the middle of one: 1 %, the midpoint rule of 6 points a pixel."""
    at, pixels = np.array([8.0]), slice(4, 13)
    share, slope = (one(at, 1.335, 17)[0, pixels] for one in (pixel_shares, pixel_share_slopes))
    spot = np.outer(share, share).ravel()
    derivative = np.stack([np.outer(share, slope).ravel(), np.outer(slope, share).ravel(), spot])
    for flux in (300.0, 3e4):
        one = place_limit(flux, 0.0, **OPTICS)
        assert one.floor == 0.0 and one.least == pytest.approx(one.bound, rel=1e-4) and one.fitted == one.bound
        light = derivative * np.array([flux, flux, 1.0])[:, None]
        exact = np.linalg.inv((light / (flux * spot + 1.0 + 9.0)) @ light.T)[0, 0] ** 0.5
        assert one.bound == pytest.approx(exact, rel=0.01)


def test_the_floor_follows_the_law_of_the_slopes() -> None:
    """(d/r0)^{5/6}, as slopes have it, whose rms is .0789 px at .1: .16 of it. A fit is at best the best reading."""
    one, half = (place_limit(3e4, ratio, **OPTICS) for ratio in (0.1, 0.05))
    assert one.floor / half.floor == pytest.approx(2.0 ** (5.0 / 6.0), rel=1e-6)
    assert one.floor == pytest.approx(0.155 * 0.0789, rel=0.05)
    for flux in check.FLUXES:
        limit = place_limit(flux, 0.1, **OPTICS)
        assert limit.bound < limit.least < limit.fitted
    with pytest.raises(ValueError, match="positive"):
        place_limit(0.0, 0.1, **OPTICS)


@pytest.mark.parametrize("flux", [300.0, 3e4])
def test_in_turbulence_the_fit_errs_by_what_the_lenslet_sees_beside_its_slope(flux: float) -> None:
    """Rung `isolated`, d/r0 = .1: at 30,000 photoelectrons noise is a fourteenth of the mean square error. 1,024 values scatter by
    2.2 %; that the truth's mean gradient is a sum over 16 samples, and phases are not small, is worth 10 %."""
    capture = check.isolated(flux, 0.1, 8)
    rms, efficiency, _ = check.measured_of(capture, "spot-ml")
    limit = place_limit(flux, 0.1, **OPTICS)
    assert 0.85 < rms / limit.fitted < 1.12
    assert efficiency < 1.2 * (limit.bound / limit.least) ** 2, "no reading of the image can have more"
