"""Delays of a gated scene as a list: an even list gives the bits of the stepped spec, an uneven one the closed form."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import xarray as xr
from scipy.special import ndtr

from beambench.benchmarks.bounds.gated import gated_bound
from beambench.benchmarks.suites.stress_axes import AXES
from beambench.captures.hide import hide_truth
from beambench.estimators import list_estimators, run_estimator
from beambench.generator.generate import generate
from beambench.optics.constants import C_M_PER_S
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene

SMALL: dict[str, Any] = {"rig.camera.rows": 6, "rig.camera.cols": 6}


def listed(values: Any, **more: Any) -> dict[str, Any]:
    return {"rig.delays": {"kind": "listed", "values_s": [float(v) for v in values], **more}}


@pytest.mark.parametrize("fidelity", ["direct", "scatter"])
def test_an_even_list_gives_the_bits_of_the_stepped_spec(fidelity: str) -> None:
    base = "flat-wall" if fidelity == "direct" else "harbour-wall"
    spec = load_scene(base, SMALL).rig.delays  # type: ignore[union-attr]
    more = {"repeats": 2, "laser_off": 3}
    stepped = generate(
        load_scene(base, SMALL | {f"rig.delays.{name}": value for name, value in more.items()}),
        seed=4, capture_key=1, fidelity=fidelity,
    )  # fmt: skip
    one = generate(load_scene(base, SMALL | listed(spec.settings_s, **more)), seed=4, capture_key=1, fidelity=fidelity)
    assert set(one.variables) == set(stepped.variables)
    for name in stepped.variables:
        np.testing.assert_array_equal(one[name].values, stepped[name].values, err_msg=str(name))
    assert one.attrs["rig"] == stepped.attrs["rig"]


def uneven() -> np.ndarray[Any, Any]:
    """Delays from 26 to 37 ns, .3 ns apart at first and .05 ns in the end, across an echo at 33.4 ns."""
    return 1e-9 * (26.0 + np.cumsum(np.linspace(0.3, 0.05, 63)))


def scene(**more: Any) -> Any:
    """A wall square to the axis, seen by a narrow view, in a Gaussian pulse (σ .5 ns) and a rectangular gate of 1.5 ns."""
    return load_scene("flat-wall", SMALL | listed(uneven()) | {
        "rig.camera.focal_length_m": 1.0, "rig.laser.illumination.half_angle_rad": 0.2,
        "rig.laser.pulse": {"kind": "gaussian", "fwhm_s": 0.5e-9 * 2.354820045},
        "rig.gates": [{"kind": "rectangular", "width_s": 1.5e-9, "transmission": 1.0}],
        "rig.laser.energy_fluctuation": 0.0, "rig.laser.jitter_frame_s": 0.0, "rig.laser.jitter_shot_s": 0.0, **more,
    })  # fmt: skip


@pytest.fixture(scope="module")
def capture() -> xr.Dataset:
    return generate(
        scene(**{"rig.pulses_per_slice": 4000}), seed=2, capture_key=1, fidelity="direct", truth_electrons=True
    )


def test_an_uneven_list_follows_the_closed_form(capture: xr.Dataset) -> None:
    np.testing.assert_array_equal(capture["delay"].values, uneven())
    tau = 2 * capture["truth_range"].values / C_M_PER_S * float(_index())
    u = (tau - uneven()[:, None, None]) / 0.5e-9
    # R(u) = ∫ p(t) g(t + u) dt: the pulse between −u and 1.5 ns − u.
    response = ndtr(3.0 - u) - ndtr(-u)
    light = capture["truth_electrons"].values - capture["truth_background"].values.reshape(len(u), 1, 1)
    expected = capture["truth_amplitude"].values * response
    assert np.abs(light - expected).max() < 2e-3 * expected.max()


def _index() -> float:
    from beambench.scenes.medium_index import group_index

    made = scene()
    return group_index(made.medium, made.rig.wavelength_m)


@pytest.mark.parametrize("name", list_estimators("gated"))
def test_every_estimator_reads_uneven_delays(capture: xr.Dataset, name: str) -> None:
    found = run_estimator(name, hide_truth(capture))
    valid = found["valid"].values
    delays = {"start_s": 26.3e-9, "step_s": 0.17e-9, "count": 64}
    even = generate(scene(**{"rig.pulses_per_slice": 4000, "rig.delays": delays}), seed=5, fidelity="direct")
    known = run_estimator(name, hide_truth(even))
    assert valid.all() == known["valid"].values.all() and valid.any() == known["valid"].values.any()
    if not valid.any():
        return
    error, usual = (
        (one["range"] - held["truth_range"]).values[one["valid"].values].mean()
        for one, held in ((found, capture), (known, even))
    )
    # Against an even grid of the same number: means over 36 pixels whose standard errors are some .3 mm. The first three
    # answer with the place of a slice or with a curve through three of them, and err by a share of their distance.
    limit_m = {"peak": 0.026, "parabola": 0.02, "log-gaussian": 0.02, "threshold": 0.006}.get(name, 0.0015)
    assert abs(error - usual) < limit_m, (name, error, usual)


def test_the_bound_of_an_uneven_list_is_reached(capture: xr.Dataset) -> None:
    """Independent information: Poisson light with the declared noise, R from the normal distribution."""
    bound = gated_bound(capture)
    found = run_estimator("poisson-ml", hide_truth(capture))
    error = (found["range"] - capture["truth_range"]).values
    z = (error / bound.sigma).std()
    assert 0.65 < z < 1.4  # 36 pixels: a standard error of 12 %
    tau = 2 * capture["truth_range"].values / C_M_PER_S * _index()
    u = (tau - uneven()[:, None, None]) / 0.5e-9
    pdf = lambda x: np.exp(-0.5 * x * x) / np.sqrt(2 * np.pi)  # noqa: E731
    alpha = capture["truth_amplitude"].values
    detector = scene().rig.detector
    floor = detector.read_noise_e**2 + 1 / (12 * detector.gain_dn_per_e**2)
    mean = np.maximum(capture["truth_electrons"].values.astype(float), 0) + floor
    slope = alpha * (pdf(-u) - pdf(3.0 - u)) / 0.5e-9
    gradient = np.stack([slope, ndtr(3.0 - u) - ndtr(-u), np.ones_like(u)], axis=-1)
    information = np.einsum("kija,kijb,kij->ijab", gradient, gradient, 1 / mean)
    sigma = np.sqrt(np.linalg.inv(information)[..., 0, 0]) * C_M_PER_S / 2 / _index()
    # The moment form of Poisson light with read noise is a few per cent below the exact one in the dark slices.
    np.testing.assert_allclose(bound.sigma, sigma, rtol=0.05)


def test_a_plain_average_would_be_pulled_by_uneven_delays(capture: xr.Dataset) -> None:
    """The reason for the weights: without them the slices that lie close to each other count too much."""
    counts = capture["counts"].values.astype(float) - float(scene().rig.detector.offset_dn)
    t = uneven()[:, None, None]
    wide = np.gradient(uneven())[:, None, None]
    truth = 2 * capture["truth_range"].values / C_M_PER_S * _index() - 0.75e-9  # R's centroid: the middle of the gate
    plain = ((t * counts).sum(axis=0) / counts.sum(axis=0) - truth).mean()
    whole = ((t * wide * counts).sum(axis=0) / (wide * counts).sum(axis=0) - truth).mean()
    assert abs(whole - plain) > 0 and abs(plain) > 3 * abs(whole)


@pytest.mark.parametrize(
    ("delays", "where"),
    [
        ({"kind": "listed", "values_s": [1e-9]}, "rig.delays.values_s"),
        ({"kind": "listed", "values_s": [1e-9, 1e-9]}, "rig.delays"),
        ({"kind": "listed", "values_s": [1e-9, 2.0]}, "rig.delays.values_s.1"),
        ({"kind": "listed"}, "rig.delays.values_s"),
        ({"kind": "even", "start_s": 0.0, "step_s": 1e-9, "count": 3}, "rig.delays"),
        ({"start_s": 0.0, "count": 3}, "rig.delays.step_s"),
        ({"values_s": [0.0, 1e-9]}, "rig.delays"),
    ],
)
def test_wrong_delays_are_refused_by_their_place(delays: dict[str, Any], where: str) -> None:
    with pytest.raises(InputError) as caught:
        load_scene("flat-wall", SMALL | {"rig.delays": delays})
    assert where in caught.value.where


def test_a_late_delay_in_a_list_is_beyond_the_next_pulse() -> None:
    rig = load_scene("flat-wall", SMALL).rig
    period = rig.detector.exposure_s / rig.pulses_per_slice  # type: ignore[union-attr]
    with pytest.raises(InputError, match="next pulse"):
        load_scene("flat-wall", SMALL | listed([30e-9, 1.1 * period, 31e-9]))


@pytest.mark.parametrize("axis", ["delay-step", "window-start"])
def test_stresses_of_even_steps_do_not_apply_to_a_list(axis: str) -> None:
    with pytest.raises(InputError) as caught:
        AXES[axis].overrides(scene(), 2.0)
    assert "rig.delays" in str(caught.value)
