"""The bound of every pixel against closed forms and an independent computation with `optics.likelihood`, and its limits."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest

from beambench.benchmarks.bounds.gated import gated_bound
from beambench.benchmarks.bounds.gated_instrument import light_path, noise_model
from beambench.benchmarks.bounds.instrument import true_scene
from beambench.benchmarks.written.gated import written_capture
from beambench.optics.constants import C_M_PER_S, FWHM_PER_SIGMA
from beambench.optics.correlation import response as correlation
from beambench.optics.correlation import waveforms
from beambench.optics.likelihood import fisher
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene
from beambench.scenes.medium_index import group_index
from beambench.scenes.sampling import optics_gate, optics_pulse
from beambench.scenes.scene import Scene

ROWS, COLS = 4, 6
QUIET = {
    "rig.camera.rows": ROWS, "rig.camera.cols": COLS, "rig.detector.read_noise_e": 0.0, "rig.ambient_e_per_s": 0.0,
    "rig.detector.dark_current_e_per_s": 0.0, "rig.detector.gain_dn_per_e": 50.0, "rig.detector.full_well_e": 1e6,
    "medium.index": {"kind": "explicit", "phase": 1.0, "group": 1.0},
}  # fmt: skip


def scene(**changes: Any) -> Scene:
    return load_scene("flat-wall", {**QUIET, **{key.replace("__", "."): value for key, value in changes.items()}})


def test_dense_gaussian_stack_meets_its_closed_form() -> None:
    # FWHM 1 ns and N = 10,027 photoelectrons in all: cσ_t/(2√N) = .6357 mm. A gate of Gaussian shape and a pulse that
    # is short against it make R Gaussian of known width; a wide window in fine steps makes sums integrals.
    sigma = 1e-9 / FWHM_PER_SIGMA
    pulse, gate = 0.2e-9, math.sqrt(1.0 - 0.2**2) * 1e-9
    step = 0.05e-9
    made = scene(
        rig__laser__pulse={"kind": "gaussian", "fwhm_s": pulse},
        rig__gates=[{"kind": "gaussian", "fwhm_s": gate, "transmission": 1.0}],
        rig__delays={"start_s": 29.0e-9, "step_s": step, "count": 160, "repeats": 1, "laser_off": 0},
    )
    u = np.linspace(-5e-9, 6e-9, 4001)
    area = np.trapezoid(
        correlation.correlation(optics_pulse(made.rig.laser.pulse), optics_gate(made.rig.gates[0]), u), u
    )
    amplitude = 10_027 / (area / step)
    # A background of 1e-6 electrons keeps 1/μ finite far away and carries no weight. ADC: 1/12 DN² at 50 DN/e, 3e-5 e².
    bound = gated_bound(written_capture(made, amplitude, 1e-6))
    expected = C_M_PER_S * sigma / (2 * math.sqrt(10_027))
    assert expected == pytest.approx(0.6357e-3, rel=1e-3)
    np.testing.assert_allclose(bound.sigma, expected, rtol=2e-3)
    assert bound.kind == "exact"
    assert bound.scale == pytest.approx(C_M_PER_S * sigma / 2, rel=1e-4)
    span = step * 159
    assert bound.window == pytest.approx(C_M_PER_S / 2 * (span + math.sqrt(12) * sigma), rel=1e-4)
    assert bound.prior == pytest.approx(bound.window / math.sqrt(12))


@pytest.mark.parametrize(("amplitude", "background", "read"), [(5.0, 0.3, 2.0), (300.0, 20.0, 1.0), (3000.0, 0.1, 5.0)])
def test_the_bound_agrees_with_the_general_one_of_optics(amplitude: float, background: float, read: float) -> None:
    made = scene(rig__detector__read_noise_e=read, rig__detector__gain_dn_per_e=1.0)
    ranges = 4.9 + 0.01 * np.arange(ROWS * COLS).reshape(ROWS, COLS)
    data = written_capture(made, amplitude, background, ranges)
    got = gated_bound(data).sigma
    pulse, gate = optics_pulse(made.rig.laser.pulse), optics_gate(made.rig.gates[0])
    u = 2 * ranges.ravel() / C_M_PER_S - data["delay"].values[:, None]
    r, slope = correlation.correlation(pulse, gate, u), correlation.correlation_slope(pulse, gate, u)
    table = fisher.information_table(noise_model(made.rig))
    want = fisher.range_bound(
        amplitude * r + background, amplitude * slope, r, np.ones_like(r), table, group_index=1.0
    ).reshape(ROWS, COLS)
    np.testing.assert_allclose(got, want, rtol=1e-3)


def test_profiling_costs_what_the_full_matrix_says() -> None:
    made = scene(rig__detector__read_noise_e=3.0)
    data = written_capture(made, 40.0, 5.0)
    table = fisher.information_table(noise_model(made.rig))
    pulse, gate = optics_pulse(made.rig.laser.pulse), optics_gate(made.rig.gates[0])
    u = 2 * 5.0 / C_M_PER_S - data["delay"].values
    r, slope = correlation.correlation(pulse, gate, u), correlation.correlation_slope(pulse, gate, u)
    gradient = np.stack([40.0 * slope * 2 / C_M_PER_S, r, np.ones_like(r)])
    matrix = (table(40.0 * r + 5.0) * gradient) @ gradient.T
    want = math.sqrt(np.linalg.inv(matrix)[0, 0])
    np.testing.assert_allclose(gated_bound(data).sigma, want, rtol=1e-3)


def test_no_information_is_infinite_and_no_truth_is_nan() -> None:
    ranges = np.full((ROWS, COLS), 5.0)
    ranges[0, 0], ranges[0, 1] = np.nan, 500.0
    amplitude = np.full((ROWS, COLS), 100.0)
    amplitude[0, 2] = 0.0
    sigma = gated_bound(written_capture(scene(), amplitude, 1.0, ranges)).sigma
    assert math.isnan(sigma[0, 0])
    assert math.isinf(sigma[0, 1])
    assert math.isinf(sigma[0, 2])
    assert np.isfinite(sigma[1:]).all()


def test_slices_that_are_dark_or_invalid_tell_nothing_of_range() -> None:
    data = written_capture(scene(), 100.0, 1.0)
    whole = gated_bound(data).sigma[0, 0]
    lit = data["laser_on"].values.copy()
    lit[::2] = False
    for name in ("laser_on", "valid"):
        less = data.assign_coords({name: ("slice", lit, data[name].attrs)})
        assert gated_bound(less).sigma[0, 0] > 1.2 * whole
    dark = data.assign_coords({"laser_on": ("slice", lit & False, data["laser_on"].attrs)})
    assert np.isinf(gated_bound(dark).sigma).all()


def test_a_declared_error_moves_what_estimators_are_told_not_the_bound() -> None:
    staged = scene().model_copy(update={"declared": {"t0_s": 3e-10, "medium.index.group": 1.1}})
    np.testing.assert_allclose(
        gated_bound(written_capture(staged, 100.0, 1.0)).sigma,
        gated_bound(written_capture(scene(), 100.0, 1.0)).sigma,
        rtol=1e-12,
    )


def test_the_bistatic_path_and_its_derivative() -> None:
    made = scene(rig__laser__position_m=[0.4, -0.2, 0.1])
    ranges = np.full((ROWS, COLS), 2.0)
    step = 1e-6
    path, slope = light_path(ranges, made.rig)
    numeric = (light_path(ranges + step, made.rig)[0] - light_path(ranges - step, made.rig)[0]) / (2 * step)
    np.testing.assert_allclose(slope, numeric, rtol=1e-8)
    assert path.shape == (ROWS, COLS)
    # Central ray by hand would be (0, 0, 1); the nearest pixels are half a pitch from it on both sides.
    assert path.mean() == pytest.approx(2.0 + math.dist((0, 0, 2.0), (0.4, -0.2, 0.1)), rel=1e-3)


def test_index_jitter_and_intensifier_act_as_they_must() -> None:
    base = gated_bound(written_capture(scene(), 100.0, 1.0)).sigma[0, 0]
    water = scene(medium__index={"kind": "explicit", "phase": 1.33, "group": 1.36})
    in_water = gated_bound(written_capture(water, 100.0, 1.0, 5.0 / 1.36)).sigma[0, 0]
    assert group_index(water.medium, 532e-9) == 1.36
    assert in_water == pytest.approx(base / 1.36, rel=1e-4)
    jitter = gated_bound(written_capture(scene(rig__laser__jitter_shot_s=5e-10), 100.0, 1.0))
    assert jitter.sigma[0, 0] > 1.1 * base
    assert jitter.kind == "quasi", "the mean delay of a slice's pulses is drawn"
    broad = waveforms.broadened(optics_pulse(scene().rig.laser.pulse), 5e-10)
    assert waveforms.pulse_variance(broad) > waveforms.pulse_variance(optics_pulse(scene().rig.laser.pulse))
    tube = {"gain": 20.0, "excess_noise_factor": 2.0, "phosphor_sigma_px": 0.0}
    coarse: dict[str, Any] = {"rig__detector__gain_dn_per_e": 0.3, "rig__detector__full_well_e": 1e6}
    intensified = gated_bound(written_capture(scene(rig__detector__intensifier=tube, **coarse), 1000.0, 1.0)).sigma[
        0, 0
    ]
    bare = gated_bound(written_capture(scene(), 1000.0, 1.0)).sigma[0, 0]
    # Between no excess noise and the moment form's √F², which exact information undercuts.
    assert 1.1 * bare < intensified < math.sqrt(2.0) * bare


@pytest.mark.parametrize(
    "changes",
    [
        {"rig__laser__energy_fluctuation": 0.02},
        {"rig__laser__jitter_frame_s": 1e-11},
        {"rig__detector__intensifier": {"gain": 10.0, "excess_noise_factor": 1.5, "phosphor_sigma_px": 0.7}},
    ],
)
def test_what_the_likelihood_does_not_hold_makes_the_bound_quasi(changes: dict[str, Any]) -> None:
    assert gated_bound(written_capture(scene(**changes), 100.0, 1.0)).kind == "quasi"


def test_captures_that_do_not_tell_enough() -> None:
    data = written_capture(scene(), 100.0, 1.0)
    bound = gated_bound(data.drop_vars("truth_amplitude"))
    assert bound.kind == "none"
    assert np.isnan(bound.sigma).all()
    del data.attrs["truth_scene"]
    with pytest.raises(InputError, match="true scene"):
        true_scene(data)
    data.attrs["truth_scene"] = json.dumps({"name": "x"})
    with pytest.raises(InputError):
        gated_bound(data)


def test_a_window_of_thousands_of_widths_is_searched_in_part() -> None:
    from beambench.benchmarks.judges.bound import scan_of

    made = scene(rig__delays={"start_s": 20e-9, "step_s": 0.4e-9, "count": 1500, "repeats": 1, "laser_off": 0})
    scan = scan_of(written_capture(made, 300.0, 1.0))
    low, high = scan.searched_s
    assert high - low == pytest.approx(600.0 * scan.width_s)
    assert scan.window_s[0] <= low < 2 * 5.0 / C_M_PER_S < high <= scan.window_s[1]


@pytest.mark.parametrize("background", [0.0, 1e-9])
def test_two_slices_and_dark_ones_bound_a_range_by_its_exact_inverse(background: float) -> None:
    """Two slices with light y_k and two unknowns, range and amplitude: σ² = Σ (∂r/∂y_k)² y_k, from the inverse of a 2 × 2
    matrix. The slices that show nothing tell the background (J = 1/μ → ∞), so that it costs nothing."""
    made = scene(
        rig__laser__pulse={"kind": "rectangular", "width_s": 2e-9},
        rig__gates=[{"kind": "rectangular", "width_s": 1e-9, "transmission": 1.0}],
        rig__delays={"start_s": 20e-9, "step_s": 1.5e-9, "count": 20},
    )
    amplitude = 500.0
    pulse, gate = optics_pulse(made.rig.laser.pulse), optics_gate(made.rig.gates[0])
    for metres in (4.97, 5.0):
        bound = gated_bound(written_capture(made, amplitude, background, metres)).sigma[0, 0]
        u = 2 * metres / C_M_PER_S - (20e-9 + 1.5e-9 * np.arange(20))
        r, slope = correlation.correlation(pulse, gate, u), correlation.correlation_slope(pulse, gate, u)
        seen = r > 0
        assert seen.sum() == 2
        jacobian = np.stack([amplitude * slope[seen] * 2 / C_M_PER_S, r[seen]], axis=1)
        expected = np.sqrt(np.linalg.inv(jacobian)[0] ** 2 @ (amplitude * r[seen]))
        # ADC of 50 DN per electron; between the table's nodes J is known to 3e-4. A bound that skips what is dark is infinite.
        assert bound == pytest.approx(float(expected), rel=5e-3)
