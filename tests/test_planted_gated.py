"""A gated stack against hand computations: ambient light, vignetting, jitter, energy fluctuation, and the scored bound.

Every reference is written here: the response of a Gaussian pulse under a rectangular gate is a difference of error
functions, the information of a sample a sum over Poisson numbers and ADC codes.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri
from scipy.stats import poisson

from beambench.benchmarks.bounds.gated import gated_bound
from beambench.benchmarks.written.gated import written_capture
from beambench.generator.generate import generate
from beambench.scenes.load import load_scene

Float = NDArray[np.float64]
C = 299_792_458.0
SIGMA_P = 1e-9 / (2.0 * math.sqrt(2.0 * math.log(2.0)))  # of a pulse of 1 ns
#: A wall at 5 m in vacuum: both ways take 33.356 ns on the axis.
TAU = 10.0 / C
FEW = {"rig.camera.rows": 2, "rig.camera.cols": 2, "medium.index": {"kind": "explicit", "phase": 1.0, "group": 1.0}}


def stack(changes: dict[str, Any], *, seed: int = 3) -> xr.Dataset:
    return generate(load_scene("flat-wall", FEW | changes), seed=seed, truth_electrons=True)


def expected(capture: xr.Dataset) -> Float:
    """Expected photoelectrons of the target alone, (slice, pixel), relative to the pixel's amplitude."""
    background = np.asarray(capture["truth_background"].values, np.float64).reshape(capture.sizes["slice"], -1)[:, :1]
    light = capture["truth_electrons"].values.astype(np.float64).reshape(capture.sizes["slice"], -1) - background
    return np.asarray(light / capture["truth_amplitude"].values.ravel()[None])


def slices_at(start_s: float, repeats: int) -> dict[str, Any]:
    """The same delay `repeats` times."""
    return {"start_s": start_s, "step_s": 1e-10, "count": 1, "repeats": repeats, "laser_off": 0}


GATE_10 = [{"kind": "rectangular", "width_s": 10e-9, "transmission": 1.0}]


# --- ambient light ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("pulses", [1, 50, 400])
def test_ambient_light_comes_through_every_gate_of_a_slice(pulses: int) -> None:
    """Rate × (transmission × width) × pulses: 2e9 · .6 · 2 ns · N = 2.4 N photoelectrons, and 7 dark electrons."""
    changes = {
        "rig.pulses_per_slice": pulses, "rig.ambient_e_per_s": 2e9, "rig.detector.dark_current_e_per_s": 7e3,
        "rig.gates": [{"kind": "rectangular", "width_s": 2e-9, "transmission": 0.6}],
        "rig.delays": {"start_s": 33e-9, "step_s": 1e-10, "count": 1, "repeats": 1, "laser_off": 400},
    }  # fmt: skip
    capture = stack(changes)
    level = 2.4 * pulses + 7.0
    np.testing.assert_allclose(capture["truth_background"].values, level, rtol=1e-6)
    dark = ~capture["laser_on"].values
    np.testing.assert_allclose(capture["truth_electrons"].values[dark], level, rtol=1e-6)
    # 400 slices of 4 pixels without the laser: Poisson, read noise of 2 electrons, rounding; gain 1, offset 100.
    counts = capture["counts"].values[dark].astype(np.float64) - 100.0
    assert abs(counts.mean() - level) < 4.0 * math.sqrt((level + 4.0 + 1.0 / 12.0) / counts.size)


# --- vignetting ---------------------------------------------------------------------------------------------------

#: 9 × 9 pixels of 100 µm behind 2.5 mm: the corner's ray is at tanθ = √2 · 4 · .04 = .226.
WIDE = {
    "rig.camera.rows": 9, "rig.camera.cols": 9, "rig.camera.pixel_pitch_m": 1e-4, "target.0.shape.width_m": 12.0,
    "target.0.shape.height_m": 12.0, "rig.delays": slices_at(30e-9, 1), "rig.gates": GATE_10,
    "rig.laser.illumination": {"profile": "flat-top", "half_angle_rad": 0.6, "offset_rad": [0.0, 0.0]},
    "medium.index": {"kind": "explicit", "phase": 1.0, "group": 1.0},
}  # fmt: skip


@pytest.mark.parametrize(("vignetting", "power"), [("none", 3), ("cos4", 7)])
def test_the_corner_against_the_centre(vignetting: str, power: int) -> None:
    """A flat wall under light that is even over solid angle: cos²θ/z² of distance, cosθ of Lambert, cos⁴θ of the lens.

    At the corner cos⁷θ = .839 and cos³θ = .928. A pixel's mean differs from its centre by some
    power·(pitch/f)²/12 = 1e-3; one power of the cosine more or less is 2.5 %.
    """
    scene = load_scene("flat-wall", WIDE | {"rig.camera.vignetting": vignetting})
    light = generate(scene, seed=1, rtol=1e-4)["truth_amplitude"].values
    cosine = 1.0 / math.sqrt(1.0 + 2.0 * (4.0 * 1e-4 / 2.5e-3) ** 2)
    assert light[0, 0] / light[4, 4] == pytest.approx(cosine**power, rel=3e-3)
    edge = 1.0 / math.sqrt(1.0 + (4.0 * 1e-4 / 2.5e-3) ** 2)
    assert light[4, 8] / light[4, 4] == pytest.approx(edge**power, rel=3e-3)


# --- speed of a pulse ---------------------------------------------------------------------------------------------


def test_a_pulse_travels_at_the_group_index() -> None:
    """Phase index 1.30, group index 1.37: half of the light is in where the gate opens 2 n_g r/c after the pulse.

    At the phase index the echo would come 2.3 ns earlier, five σ of the pulse. The pixel's ray is longer by 2e-5.
    """
    index = {"kind": "explicit", "phase": 1.30, "group": 1.37}
    for early, share in ((0.0, 0.5), (SIGMA_P, float(ndtr(1.0))), (-SIGMA_P, float(ndtr(-1.0)))):
        capture = stack({"medium.index": index, "rig.gates": GATE_10, "rig.delays": slices_at(1.37 * TAU - early, 1)})
        np.testing.assert_allclose(expected(capture)[0], share, atol=2e-3)


# --- what is drawn per slice --------------------------------------------------------------------------------------


def test_jitter_per_slice_moves_the_delay() -> None:
    """4,000 slices at one setting: each slice's own delay, from the closed form of R's rising edge.

    R(u) = Φ(u/σ_p) near the opening of a gate of 10 ns, so u_k = σ_p Φ⁻¹(S_k/α) = τ − t_k. Mean τ − t and standard
    deviation σ_j = .3 ns, within 4 standard errors (1.1 % of σ_j); neighbours independent. Without jitter: none at all.
    """
    n, jitter = 4000, 0.3e-9
    still = {"rig.delays": slices_at(TAU, n), "rig.gates": GATE_10}
    moved = stack(still | {"rig.laser.jitter_frame_s": jitter})
    u = SIGMA_P * ndtri(np.clip(expected(moved)[:, 0], 1e-7, 1.0 - 1e-7))
    start = SIGMA_P * float(ndtri(expected(stack({**still, "rig.delays": slices_at(TAU, 1)}))[0, 0]))
    assert abs(start) < 2e-12  # half of the light at the gate's edge; the pixel's ray is longer by 2e-5
    assert abs(u.mean() - start) < 4.0 * jitter / math.sqrt(n)
    assert u.std(ddof=1) == pytest.approx(jitter, rel=4.0 / math.sqrt(2.0 * n), abs=0.0)
    assert abs(float(np.corrcoef(u[1:], u[:-1])[0, 1])) < 4.0 / math.sqrt(n)
    # All pixels of a slice move together.
    other = SIGMA_P * ndtri(np.clip(expected(moved)[:, 3], 1e-7, 1.0 - 1e-7))
    np.testing.assert_allclose(other, u, atol=2e-12)


def test_energy_fluctuates_by_its_rms() -> None:
    """4,000 slices on R's plateau: S_k/α is the energy of slice k: mean 1, rms 5 %, within 4 standard errors (1.1 %)."""
    n, rms = 4000, 0.05
    energy = expected(stack({
        "rig.delays": slices_at(TAU - 5e-9, n), "rig.gates": GATE_10, "rig.laser.energy_fluctuation": rms,
    }))  # fmt: skip
    assert abs(energy[:, 0].mean() - 1.0) < 4.0 * rms / math.sqrt(n)
    assert energy[:, 0].std(ddof=1) == pytest.approx(rms, rel=4.0 / math.sqrt(2.0 * n))
    assert abs(float(np.corrcoef(energy[1:, 0], energy[:-1, 0])[0, 1])) < 4.0 / math.sqrt(n)
    np.testing.assert_allclose(energy[:, 3], energy[:, 0], rtol=1e-4)


@pytest.mark.parametrize("jitter", [0.0, 0.4e-9])
def test_jitter_of_many_pulses_broadens_the_response(jitter: float) -> None:
    """Var R = σ_p² + w²/12 + σ_j² for a gate of w: second moment of the stack over delays 20 ps apart.

    σ_j = .4 ns adds 61 % to .263 ns². 10⁶ pulses a slice: what is left of their jitter is .4 ps. Sums over a fine grid of a
    smooth R are exact to far below 1e-3; single precision of the stack leaves 1e-4.
    """
    capture = stack({
        "rig.laser.jitter_shot_s": jitter, "rig.pulses_per_slice": 1_000_000, "rig.detector.exposure_s": 10.0,
        "rig.detector.dark_current_e_per_s": 0.0, "rig.ambient_e_per_s": 0.0,
        "rig.laser.pulse_energy_j": 2.5e-10, "rig.gates": [{"kind": "rectangular", "width_s": 1e-9, "transmission": 1.0}],
        "rig.delays": {"start_s": TAU - 5e-9, "step_s": 2e-11, "count": 451, "repeats": 1, "laser_off": 0},
    })  # fmt: skip
    shape, t = expected(capture)[:, 0], TAU - capture["delay"].values
    mean = float((shape * t).sum() / shape.sum())
    variance = float((shape * (t - mean) ** 2).sum() / shape.sum())
    assert mean == pytest.approx(0.5e-9, abs=2e-12)  # the middle of the gate
    assert shape.sum() * 2e-11 == pytest.approx(1e-9, rel=2e-3, abs=0.0)  # ∫R = the gate's area, whatever the jitter
    wanted = SIGMA_P**2 + 1e-18 / 12.0 + jitter**2
    assert variance == pytest.approx(wanted, rel=5e-3, abs=0.0)
    # The bound's scale is c σ_R/2 of the same response.
    assert gated_bound(capture).scale == pytest.approx(0.5 * C * math.sqrt(wanted), rel=2e-3)


# --- the scored bound ---------------------------------------------------------------------------------------------


def fisher(mu: float, read: float, gain: float, offset: float, top: int) -> float:
    """J(μ) of one sample: Σ_y (∂P/∂μ)²/P over ADC codes y, P(y) = Σ_n Poisson(n; μ) [Φ(upper) − Φ(lower)]."""
    n = np.arange(0, int(mu + 12.0 * math.sqrt(mu) + 40.0))
    # The code y is read where y − ½ ≤ gain·e + offset < y + ½; the ends hold all that lies beyond.
    edge = (np.arange(0, top + 2) - 0.5 - offset) / gain
    edge[0], edge[-1] = -np.inf, np.inf
    share = np.diff(ndtr((edge[:, None] - n[None]) / read), axis=0)
    weight = poisson.pmf(n, mu)
    slope = np.where(n > 0, poisson.pmf(n - 1, mu), 0.0) - weight  # ∂/∂μ of a Poisson probability
    p, dp = share @ weight, share @ slope
    seen = p > 1e-280
    return float((dp[seen] ** 2 / p[seen]).sum())


def test_the_information_written_here_has_its_limits() -> None:
    """1/μ of a counter without noise; 1/(μ + σ²) of much light; far less where the ADC's cell is 40 electrons."""
    assert fisher(20.0, 1e-3, 1.0, 0.0, 400) == pytest.approx(1.0 / 20.0, rel=1e-6)
    assert fisher(900.0, 10.0, 1.0, 50.0, 3000) == pytest.approx(1.0 / 1000.0, rel=2e-3)
    assert fisher(20.0, 3.0, 1.0 / 40.0, 10.0, 60) < 0.9 / (20.0 + 9.0)


@pytest.mark.parametrize(("read", "gain"), [(0.3, 1.0), (3.0, 1.0), (8.0, 0.1)])
def test_the_scored_bound_knows_read_noise_and_rounding(read: float, gain: float) -> None:
    """One pixel, 12 slices of at most 40 photoelectrons over 2 of background: F from the sums above, R from erf.

    F = Σ_k J(μ_k) a_k a_kᵀ of (range, amplitude, background), inverted in full. Tolerance 1 %, of which the tabulated J takes
    .1 %. Without the read noise the bound would be lower by 24 % (3 e) and 48 % (8 e); at .3 e it must not matter (.5 %).
    """
    alpha, level = 40.0, 2.0
    scene = load_scene("flat-wall", FEW | {
        "rig.detector.read_noise_e": read, "rig.detector.gain_dn_per_e": gain, "rig.detector.offset_dn": 20.0,
        "rig.detector.adc_bits": 8, "rig.detector.full_well_e": 1e6, "rig.detector.dark_current_e_per_s": 0.0,
        "rig.delays": {"start_s": TAU - 2.4e-9, "step_s": 0.35e-9, "count": 12, "repeats": 1, "laser_off": 0},
    })  # fmt: skip
    capture = written_capture(scene, alpha, level, 5.0)
    u = TAU - capture["delay"].values
    shape = ndtr(u / SIGMA_P) - ndtr((u - 1e-9) / SIGMA_P)
    bell = np.exp(-0.5 * (u / SIGMA_P) ** 2) - np.exp(-0.5 * ((u - 1e-9) / SIGMA_P) ** 2)
    slope = bell / (SIGMA_P * math.sqrt(2.0 * math.pi)) * 2.0 / C
    a = np.stack([alpha * slope, shape, np.ones_like(shape)])
    information = np.array([fisher(float(m), read, gain, 20.0, 255) for m in alpha * shape + level])
    want = math.sqrt(np.linalg.inv((information * a) @ a.T)[0, 0])
    np.testing.assert_allclose(gated_bound(capture).sigma, want, rtol=0.01)
