"""Power laws of roughness: densities, structure function, generalised covariance, and surfaces and profiles drawn from them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import j0

from beambench.benchmarks.written.laser_line_profiles import drawn_heights, drawn_rows
from beambench.optics.roughness import (
    band_variance,
    intrinsic_covariance,
    profile_density,
    profile_factor,
    structure_function,
    surface_density_factor,
)
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene
from beambench.scenes.meshes import shape_mesh
from beambench.scenes.shapes import PowerLawRelief

SLOPES = (2.0, 2.5, 3.0, 3.5)
RELIEF = {
    "center_m": (0.0, 0.0, 2.0), "width_m": 0.6, "height_m": 0.5, "tilt_x_deg": 0.0, "tilt_y_deg": 0.0, "slope": 2.5,
    "rms_m": 0.02, "outer_m": 0.25, "inner_m": 0.008, "pitch_m": 0.004, "seed": 1,
}  # fmt: skip


# ---------------------------------------------------------------- the law, against integrals that share none of its code


@pytest.mark.parametrize("slope", SLOPES)
def test_the_density_of_profiles_is_the_surface_integrated_across(slope: float) -> None:
    """Sees a wrong factor between surface and profile, and a wrong end of the band: the integral over g is taken by trapezia."""
    rms, outer, inner = 0.02, 0.5, 0.005
    level = surface_density_factor(slope, rms, outer, inner)
    for f in (0.5, 1.5, 5.0, 40.0, 150.0):
        g = np.geomspace(1e-4, 1.0 / inner, 400_001)
        k = np.hypot(f, g)
        psi = np.where((k >= 1.0 / outer) & (k <= 1.0 / inner), level * k ** (-slope - 1.0), 0.0)
        assert profile_density(f, slope, rms, outer, inner) == pytest.approx(4.0 * np.trapezoid(psi, g), rel=2e-3)
    f = np.geomspace(1e-5, 1.0 / inner, 400_001)
    assert np.trapezoid(profile_density(f, slope, rms, outer, inner), f) == pytest.approx(rms**2, rel=1e-3)
    pure = profile_factor(slope) * level
    assert profile_density(20.0, slope, rms, outer, 1e-6) == pytest.approx(
        profile_factor(slope) * surface_density_factor(slope, rms, outer, 1e-6) * 20.0**-slope, rel=1e-3
    )
    f = np.geomspace(3.0, 30.0, 100_001)
    assert band_variance(pure, slope, 3.0, 30.0) == pytest.approx(np.trapezoid(pure * f**-slope, f), rel=1e-6)


@pytest.mark.parametrize("slope", [1.5, 2.0, 2.7])
def test_the_structure_function_is_the_integral_of_the_density(slope: float) -> None:
    f = np.geomspace(1e-7, 3e3, 2_000_001)
    for lag in (0.05, 0.4):
        summed = np.trapezoid(2.0 * f**-slope * (1.0 - np.cos(2.0 * np.pi * f * lag)), f)
        ends = 2.0 * 3e3 ** (1 - slope) / (slope - 1) + (2.0 * np.pi * lag) ** 2 * 1e-7 ** (3 - slope) / (3 - slope)
        assert structure_function(lag, 1.0, slope) == pytest.approx(summed + ends, rel=1e-3)


@pytest.mark.parametrize("aperture", [0.0, 0.01])
@pytest.mark.parametrize("slope", [2.0, 2.5, 3.0, 3.5, 4.2])
def test_the_generalised_covariance_gives_the_variance_of_contrasts(slope: float, aperture: float) -> None:
    """∫ f^−γ |Σ w e^(2πifs)|² sinc²(f a) df over all f, by trapezia. Sees factor, pole at 3 and aperture."""
    s = np.array([0.0, 0.013, 0.03, 0.034, 0.07])
    basis = np.stack([np.ones_like(s), s], axis=1)
    q = np.linalg.qr(basis, mode="complete")[0][:, 2:]
    f = np.geomspace(1e-4, 3e4, 600_001)
    for w in q.T:
        wave = np.abs(np.exp(2j * np.pi * np.outer(f, s)) @ w) ** 2 * np.sinc(f * aperture) ** 2
        want = np.trapezoid(f**-slope * wave, f)
        lag = s[:, None] - s[None, :]
        got = [w @ intrinsic_covariance(lag, slope, scale, aperture) @ w for scale in (0.07, 0.3)]
        # The waves above 3e4 cycles/m are left out of the sum: 3e4^(1−γ)/(γ − 1) of the weights, 3e-5 at γ = 2.
        assert got == pytest.approx([want] * 2, rel=2e-3, abs=1.1 * 3e4 ** (1.0 - slope) / (slope - 1.0))
    with pytest.raises(ValueError, match="slope < 5"):
        intrinsic_covariance(lag, 5.0, 1.0)


# ---------------------------------------------------------------- surfaces


def heights(shape: PowerLawRelief) -> np.ndarray:
    """Heights (row, col) of an untilted relief, from its mesh."""
    vertices, _ = shape_mesh(shape, "test")
    cols = round(shape.width_m / shape.pitch_m) + 1
    return np.asarray(shape.center_m[2] - vertices[:, 2]).reshape(-1, cols)


@pytest.mark.parametrize("slope", [2.0, 3.0])
def test_reliefs_have_the_structure_function_of_their_density(slope: float) -> None:
    """⟨(h(x + l) − h(x))²⟩ = ∫ Ψ 2(1 − J0(2πkl)) 2πk dk along rows and columns, mean over 24 seeds within 4 standard errors of
    their scatter. Sees a wrong amplitude, a wrong slope and unequal axes."""
    shape = PowerLawRelief(**(RELIEF | {"slope": slope}))
    level = surface_density_factor(slope, shape.rms_m, shape.outer_m, shape.inner_m)
    k = np.geomspace(1.0 / shape.outer_m, 1.0 / shape.inner_m, 100_001)
    lags = (1, 3, 10, 30)
    found = np.empty((24, 2, len(lags)))
    variance = np.empty(24)
    for seed in range(24):
        h = heights(shape.model_copy(update={"seed": seed}))
        variance[seed] = np.mean(h**2)
        for number, lag in enumerate(lags):
            found[seed, 0, number] = np.mean((h[:, lag:] - h[:, :-lag]) ** 2)
            found[seed, 1, number] = np.mean((h[lag:] - h[:-lag]) ** 2)
    assert abs(variance.mean() - shape.rms_m**2) < 4.0 * variance.std(ddof=1) / np.sqrt(24) + 0.02 * shape.rms_m**2
    for number, lag in enumerate(lags):
        y = level * k ** (-slope - 1.0) * 2.0 * np.pi * k * 2.0 * (1.0 - j0(2.0 * np.pi * k * lag * shape.pitch_m))
        want = np.trapezoid(y, k)
        mean, error = found[:, :, number].mean(axis=0), found[:, :, number].std(axis=0, ddof=1) / np.sqrt(24)
        # 2 %: the lattice of waves samples the lowest octave coarsely.
        assert (np.abs(mean - want) < 4.0 * error + 0.02 * want).all()


def test_reliefs_are_equal_for_equal_seeds_and_face_the_camera() -> None:
    shape = PowerLawRelief(**RELIEF)
    h = heights(shape)
    assert h.shape == (126, 151) and np.array_equal(h, heights(shape))
    assert not np.allclose(h, heights(shape.model_copy(update={"seed": 2})))
    vertices, faces = shape_mesh(shape, "test")
    assert len(vertices) == h.size and len(faces) == 2 * 125 * 150
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    assert (np.cross(b - a, c - a)[:, 2] < 0).all()
    tilted, _ = shape_mesh(shape.model_copy(update={"tilt_y_deg": 30.0}), "test")
    assert np.linalg.norm(tilted - [0, 0, 2], axis=1) == pytest.approx(np.linalg.norm(vertices - [0, 0, 2], axis=1))


@pytest.mark.parametrize(
    ("change", "seen"),
    [({"inner_m": 1e-3}, "2 pitch_m <= inner_m"), ({"outer_m": 1e-3}, "inner_m < outer_m"), ({"pitch_m": 1e-5}, "heights"),
     ({"slope": 1.0}, "slope"), ({"rms_m": 0.0}, "rms_m"), ({"seed": -1}, "seed")],
)  # fmt: skip
def test_impossible_reliefs_are_refused(change: dict[str, object], seen: str) -> None:
    with pytest.raises(InputError, match=seen):
        load_scene("seafloor-down", {f"target.0.shape.{name}": value for name, value in change.items()})


# ---------------------------------------------------------------- drawn profiles


@pytest.mark.parametrize("slope", [2.0, 3.0])
def test_drawn_heights_have_the_density_that_was_asked_for(slope: float) -> None:
    """Variance of second differences of 4000 profiles against the sum over waves: 4 standard errors, √(2/n) of 400 independent
    ones each. Sees a wrong level or slope of the draws that all surveys below are made of."""
    step, period = 0.01, 512
    h = drawn_heights(np.random.default_rng(3), 64, step, slope, 2e-6, profiles=4000, period=period)
    f = np.arange(1, period // 2 + 1) / (period * step)
    density = 2e-6 * (f / 10.0) ** -slope / (period * step)
    for lag in (1, 8):
        bend = h[:, 2 * lag :: 16] - 2.0 * h[:, lag:-lag:16][:, : h[:, 2 * lag :: 16].shape[1]] + h[:, : -2 * lag : 16]
        want = (density * 16.0 * np.sin(np.pi * f * lag * step) ** 4).sum()
        # The highest wave has no sine part: its share is counted once, not twice.
        assert np.mean(bend**2) == pytest.approx(want, rel=4.0 * np.sqrt(2.0 / 4000) + 0.01)


def test_lost_rows_have_their_share_and_length() -> None:
    kept = drawn_rows(np.random.default_rng(1), 2000, 256, 200 / 256, 2.6)
    assert kept.mean() == pytest.approx(200 / 256, abs=4e-3)
    ends = np.flatnonzero(np.diff(np.pad(~kept[:, 1:-1], ((0, 0), (1, 1))).ravel().astype(int)))
    assert (ends[1::2] - ends[::2]).mean() == pytest.approx(2.6, abs=0.05)
