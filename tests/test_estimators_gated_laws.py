"""Laws of gated estimators in their own standard errors: stricter than those of `estimators check`, which know only steps.

On one stack of 360 pixels with 5,000 photoelectrons each: shift, gain, and mirrored pixels.
"""

from __future__ import annotations

import json

import numpy as np
import pytest
import xarray as xr

from beambench.benchmarks.written.gated_stack import GaussianRig, stack_capture
from beambench.estimators import list_estimators, run_estimator
from beambench.optics.constants import C_M_PER_S

NAMES = list_estimators("gated")
#: Estimators with a printed correction that depends on the range itself; `test_estimators_laws` bounds their shift.
PRINTED = ("chua-2017", "chua-2017-orthogonal")
RIG = GaussianRig(offset_dn=20.0, gain_dn_per_e=2.0, read_noise_e=1.0)
SHAPE = (9, 40)


def _capture() -> xr.Dataset:
    rng = np.random.default_rng(11)
    tau = rng.uniform(RIG.delay_s[14], RIG.delay_s[-14], SHAPE) + RIG.centre_s
    electrons = rng.poisson(RIG.electrons(tau, 5e3, 3.0)) + rng.normal(size=(RIG.slices, *SHAPE))
    return stack_capture(RIG, np.round(20 + 2 * electrons).clip(0, 65535).astype(np.uint16))


@pytest.mark.parametrize("name", [name for name in NAMES if name not in PRINTED])
def test_later_delays_move_the_range(name: str) -> None:
    # By cΔ/2n_g. Where the table of R starts elsewhere the iterations stop elsewhere, within .04 standard errors.
    capture, shift = _capture(), 0.4321e-9
    before = run_estimator(name, capture)
    after = run_estimator(name, capture.assign_coords(delay=capture["delay"] + shift))
    assert (before["valid"] == after["valid"]).all() and before["valid"].values.any()
    moved = (after["range"] - before["range"]).values
    assert np.nanmax(np.abs(moved - shift * C_M_PER_S / 2) / before["sigma"].values) < 0.04


@pytest.mark.parametrize("name", NAMES)
def test_counts_and_gain_doubled_are_the_same_electrons(name: str) -> None:
    # But for the converter's noise, a hundredth of the read noise.
    capture = _capture()
    before = run_estimator(name, capture)
    counts = (40 + 2 * (capture["counts"].astype(np.float64) - 20)).clip(0, 65535).astype(np.uint16)
    rig = json.loads(capture.attrs["rig"])
    rig["detector"] |= {"gain_dn_per_e": 4.0, "offset_dn": 40.0}
    twice = capture.assign(counts=counts.assign_attrs(capture["counts"].attrs)).assign_attrs(rig=json.dumps(rig))
    after = run_estimator(name, twice)
    assert (before["valid"] == after["valid"]).all() and before["valid"].values.any()
    assert float((np.abs(after["range"] - before["range"]) / before["sigma"]).max()) < 0.06


@pytest.mark.parametrize("name", NAMES)
def test_mirrored_pixels_have_mirrored_answers_bit_by_bit(name: str) -> None:
    # The printed models depend on the place in the image: mirrored pixels have the same radius.
    capture = _capture()
    flipped = capture.copy(deep=True)
    flipped["counts"].values = np.ascontiguousarray(capture["counts"].values[:, :, ::-1])
    one, two = run_estimator(name, capture), run_estimator(name, flipped)
    for key in ("range", "sigma", "valid"):
        if (
            name == "radiometric-average"
        ):  # stops within a part of sigma: the beam angle's last bit differs between the sides
            np.testing.assert_allclose(one[key].values[:, ::-1], two[key].values, rtol=1e-9)
        else:
            np.testing.assert_array_equal(one[key].values[:, ::-1], two[key].values)
