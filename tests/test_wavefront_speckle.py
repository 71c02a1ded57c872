"""Speckle of a diffuse target, the tilt of a platform, and lenslets that are lost by chance."""

from __future__ import annotations

import json
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
import xarray as xr
from scipy.special import j1, jv

from beambench.benchmarks.bounds.wavefront import wavefront_bounds
from beambench.generator.generate import generate
from beambench.generator.random import Stage
from beambench.generator.wavefront.speckle import disc_field
from beambench.optics.lenslets.spots import pixel_share_slopes, pixel_shares
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene
from beambench.scenes.medium_index import phase_index
from beambench.scenes.rigs.wavefront import wavefront_rig
from beambench.scenes.rigs.wavefront_geometry import lattice_of, spot_px
from beambench.scenes.scene import Scene

PITCH, PIXEL, FOCAL, WAVE, BEAM, RANGE = 150e-6, 17.8e-6, 6.7e-3, 532e-9, 5e-3, 4.0
#: One lenslet of 4 × 4 in a diffuse target's light.
ONE: dict[str, Any] = {
    "rig.propagation": "phase-screens", "rig.turbulence": {"kind": "none"}, "rig.reflection": "diffuse",
    "rig.laser.pulse_energy_j": 1e-4, "rig.lenslets.across": 4, "rig.pupil.diameter_m": 0.6e-3, "rig.pupil.modes": 3,
    "rig.lenslets.missing": [[r, c] for r in range(4) for c in range(4) if (r, c) != (1, 1)], "rig.camera.rows": 44,
    "rig.camera.cols": 44, "rig.detector.intensifier": None, "rig.detector.adc_bits": 16, "rig.detector.gain_dn_per_e": 1.0,
}  # fmt: skip


def scene_of(**changes: Any) -> Scene:
    return load_scene("gated-turbulence", ONE | changes)


@lru_cache(maxsize=4)
def lit(looks: int, frames: int, seed: int) -> xr.Dataset:
    scene = scene_of(**{"rig.effects": {"speckle_looks": looks}, "rig.frames.count": frames})
    return generate(scene, seed=seed, fidelity="geometric", truth_electrons=True)


def pairs(function: Any) -> float:
    """Mean of function(Δx, Δy) over pairs of points in a lenslet: its integral over the triangle functions of both axes."""
    node, weight = np.polynomial.legendre.leggauss(40)
    t, w = 0.5 * (node + 1.0), weight * (1.0 - 0.5 * (node + 1.0))  # ∫₀¹ 2(1 − t) f(t) dt
    x, y = np.meshgrid(t * PITCH, t * PITCH)
    return float((function(x, y) * w * w[:, None]).sum())


def disc(x: Any, y: Any) -> tuple[Any, Any, Any]:
    """μ = 2J₁(v)/v, ∂μ/∂x, ∂²μ/∂x²: with (J₁/v)' = −J₂/v and (J₂/v²)' = −J₃/v²."""
    a = np.pi * BEAM / (WAVE / phase_index(scene_of().medium, WAVE) * RANGE)
    v = a * np.hypot(x, y)
    return (
        2 * j1(v) / v,
        -2 * a**2 * x * jv(2, v) / v**2,
        2 * a**4 * x**2 * jv(3, v) / v**3 - 2 * a**2 * jv(2, v) / v**2,
    )


def test_a_field_is_gaussian_with_the_covariance_of_a_disc() -> None:
    """1,500 draws at 8 × 8 samples: ⟨|g|²⟩ = 1 and ⟨|g|⁴⟩ = 2; covariances within four standard errors of 2J₁(v)/v."""
    rng, cycles = np.random.default_rng(1), 0.11
    drawn = np.array([disc_field(8, cycles, rng) for _ in range(1500)])
    power = np.abs(drawn) ** 2
    # Neighbouring samples belong together: the standard error is that of the means of draws.
    for moment, want in ((power, 1.0), (power**2, 2.0)):
        of_draw = moment.mean(axis=(1, 2))
        assert abs(of_draw.mean() - want) < 4 * of_draw.std() / np.sqrt(1500)
    for down, along in ((0, 3), (4, 0), (5, 6), (7, 7)):
        product = (drawn[:, 0, 0] * np.conj(drawn[:, down, along])).real
        v = 2 * np.pi * cycles * np.hypot(down, along)
        assert abs(product.mean() - 2 * j1(v) / v) < 4 * product.std() / np.sqrt(1500)


@pytest.mark.parametrize(("looks", "frames"), [(1, 1000), (16, 100)])
def test_the_contrast_of_a_lenslets_light_is_that_of_m_patterns(looks: int, frames: int) -> None:
    """σ²/⟨N⟩² = ⟨|μ|²⟩ over pairs of points of the lenslet, over M (Goodman 2007, sec. 4.6): 1/M but for what it averages. The
    standard error of a variance of a gamma law of shape M is √((2 + 6/M)/n); four of them, and 2 % for the samples."""
    capture = lit(looks, frames, 3)
    light = capture["truth_electrons"].values.sum(axis=(1, 2)) - capture["truth_background"].values * 44 * 44
    whole = pixel_shares([10.0], spot_px(wavefront_rig(scene_of())), 44).sum()
    ratio = light / capture["truth_flux"].values[:, 0]
    contrast = ratio.var() / ratio.mean() ** 2
    want = pairs(lambda x, y: disc(x, y)[0] ** 2) / looks
    assert abs(ratio.mean() / whole**2 - 1.0) < 4 * np.sqrt(want / frames) + 0.02
    assert abs(contrast / want - 1.0) < 4 * np.sqrt((2 + 6 / looks) / frames) + 0.02
    assert 0.8 / looks < want < 1.0 / looks


def _moved(capture: xr.Dataset) -> np.ndarray:
    """Displacement (frame, axis) [px] of the one spot from images without noise: its profile and three derivatives by the place,
    Taylor's series of a sum of moved spots, whose first term is the mean displacement."""
    rig = wavefront_rig(scene_of())
    lattice, width = lattice_of(rig), spot_px(rig)
    image = capture["truth_electrons"].values - capture["truth_background"].values[:, None, None]
    found = []
    for profile, at in ((image.sum(axis=1), lattice.col_px), (image.sum(axis=2), lattice.row_px)):
        before, here, after = (pixel_share_slopes(at + d, width, 44)[0] for d in (-0.01, 0.0, 0.01))
        basis = [pixel_shares(at, width, 44)[0], here, (after - before) / 0.02, (after - 2 * here + before) / 1e-4]
        fit = np.linalg.lstsq(np.stack(basis, axis=1), profile.T, rcond=None)[0]
        found.append(fit[1] / fit[0])
    return np.stack(found, axis=1)


def test_speckle_moves_spots_as_its_covariance_says() -> None:
    """With J = Im g*∂g, ⟨J(x) J(x')⟩ = ½(μ'² − μμ'') of a circular Gaussian field (moments of four), and the mean slope over the
    lenslet has the variance of that over pairs, /k² M, for many patterns; as the light that it is divided by follows a gamma law of
    shape M, times M/(M − 1). 300 frames, two axes: a standard error of 6 %, four of them, and 3 % for the samples."""
    moved = _moved(lit(16, 300, 3)) * PIXEL / FOCAL

    def product(x: Any, y: Any) -> Any:
        value, slope, bend = disc(x, y)
        return 0.5 * (slope**2 - value * bend)

    want = pairs(product) * (WAVE / (2.0 * np.pi)) ** 2 / (16 - 1)
    assert abs(moved.var() / want - 1.0) < 4 * np.sqrt(2 / 600) + 0.03
    assert np.abs(moved.mean(axis=0)).max() < 4 * np.sqrt(want / 300)


def test_one_pattern_moves_spots_as_a_field_made_by_fourier_transform() -> None:
    """M = 1: the ratio has a heavy tail, so that medians of |s| are compared with 2,000 fields of an own code (white noise, cut by
    a disc in frequency); a median of n has the relative standard error of some 1.3/√n here."""
    rng, size, per = np.random.default_rng(6), 96, 8
    step = PITCH / per
    f = np.fft.fftfreq(size, step)
    inside = np.hypot(f[:, None], f[None, :]) <= 0.5 * BEAM / (WAVE / phase_index(scene_of().medium, WAVE) * RANGE)
    slopes = []
    for _ in range(2000):
        noise = rng.standard_normal((2, size, size))
        u = np.fft.ifft2((noise[0] + 1j * noise[1]) * inside)[: per + 2, : per + 2]
        turn = np.angle(u[1:-1, 2:] * np.conj(u[1:-1, :-2])) / (2 * step)
        power = np.abs(u[1:-1, 1:-1]) ** 2
        slopes.append((power * turn).sum() / power.sum() * WAVE / (2 * np.pi))
    moved = _moved(lit(1, 1000, 3)) * PIXEL / FOCAL
    ratio = np.median(np.abs(moved)) / np.median(np.abs(slopes))
    assert abs(ratio - 1.0) < 4 * 1.3 * np.sqrt(1 / 2000 + 1 / 2000) + 0.03


def test_truth_is_the_waters_and_the_bound_does_not_claim_to_know_speckle() -> None:
    with_it, without = lit(16, 300, 3), generate(scene_of(**{"rig.frames.count": 300}), seed=3, fidelity="geometric")
    for name in ("truth_slope", "truth_flux", "truth_zernike", "truth_field"):
        np.testing.assert_array_equal(with_it[name].values, without[name].values)
    small, again = (
        generate(scene_of(**{"rig.effects": {"speckle_looks": 4}}), seed=3, fidelity="geometric") for _ in range(2)
    )
    assert np.array_equal(small["counts"], again["counts"])
    assert wavefront_bounds(small)["spot"].kind == "quasi"
    named = {one["name"]: one for one in json.loads(small.attrs["fidelity"])["effects"]}
    assert (
        named["speckle of a diffuse target"]["modelled"]
        and named["speckle of a diffuse target"]["predicted_relative_size"] == 0.5
    )


@pytest.mark.parametrize("rung", ["isolated", "coherent"])
def test_fields_carry_speckle_too(rung: Any) -> None:
    """The lit place is .6 px wide in the image: spots of 32 patterns are as bright in all, and wider."""
    scene = scene_of(**{"rig.effects": {"speckle_looks": 32}, "rig.frames.count": 2})
    one, other = (
        generate(one, seed=8, fidelity=rung, truth_electrons=True)["truth_electrons"].values.mean(axis=0)
        for one in (scene, scene_of(**{"rig.frames.count": 2}))
    )
    assert one.sum() / other.sum() == pytest.approx(1.0, abs=4 / np.sqrt(64))
    assert one.max() / one.sum() < 0.97 * other.max() / other.sum()


def test_a_mirror_and_speckle_finer_than_samples_are_refused() -> None:
    with pytest.raises(InputError, match="mirror has no speckle"):
        scene_of(**{"rig.reflection": "mirror", "rig.effects": {"speckle_looks": 2}})
    with pytest.raises(InputError, match="speckle_looks"):
        scene_of(**{"rig.effects": {"speckle_looks": 0}})
    near = {"target.0.shape.center_m": [0.0, 0.0, 0.1], "rig.frames.start_s": 0.0, "rig.effects": {"speckle_looks": 2}}
    with pytest.raises(InputError, match="too far apart for the speckle"):
        generate(scene_of(**near), seed=1, fidelity="geometric")


def test_a_platform_that_turns_tilts_frames_and_not_the_reference() -> None:
    """2 × 400 angles of 1 mrad rms: a standard error of 2.5 %, four of them; truth, spots and the field agree."""
    change = {
        "rig.effects": {"pointing_jitter_rad": 1e-3},
        "rig.frames.count": 400,
        "rig.reflection": "mirror",
        "rig.laser.pulse_energy_j": 1e-10,
    }
    capture = generate(scene_of(**change), seed=9, capture_key=1, fidelity="geometric", truth_electrons=True)
    slope = capture["truth_slope"].values[:, 0]
    assert abs(slope.std() / 1e-3 - 1.0) < 0.1 and np.abs(slope.mean(axis=0)).max() < 4 * 1e-3 / 20
    tilt = capture["truth_zernike"].values[:, :2]
    np.testing.assert_allclose(tilt, slope * 2 * np.pi / WAVE * 0.6e-3 / 4, rtol=1e-6, atol=1e-9)
    moved = _moved(capture)
    near = np.abs(slope) < 5e-4  # within a fifth of a pixel the series holds
    np.testing.assert_allclose(moved[near], slope[near] * FOCAL / PIXEL, atol=2e-3)
    still = generate(scene_of(**change | {"rig.effects": None}), seed=9, capture_key=1, fidelity="geometric")
    np.testing.assert_array_equal(capture["reference"], still["reference"])
    assert Stage.POINTING == 21 and Stage.SPECKLE == 11  # never renumbered


@pytest.mark.parametrize("propagation", ["phase-screens", "split-step"])
def test_the_tilt_adds_to_the_waters_phase(propagation: str) -> None:
    change = {
        "rig.propagation": propagation, "rig.reflection": "mirror", "rig.frames.count": 2, "rig.lenslets.missing": [],
        "rig.turbulence": {"kind": "layers", "layers": [{"range_m": 3.0, "r0_m": 5e-3}]},
    }  # fmt: skip
    still, moved = (
        generate(scene_of(**change, **{"rig.effects": effects}), seed=10, capture_key=1, fidelity="geometric")[
            "truth_slope"
        ].values
        for effects in (None, {"pointing_jitter_rad": 5e-4})
    )
    added = moved - still
    assert np.ptp(added, axis=1).max() < 1e-7 and np.abs(added).max() > 1e-4


def test_lenslets_lost_by_chance_are_nested_and_as_many_as_asked() -> None:
    base = {"rig.lenslets.across": 10, "rig.pupil.diameter_m": 1.5e-3, "rig.pupil.shape": "square", "rig.lenslets.missing": [],
            "rig.camera.rows": 96, "rig.camera.cols": 96}  # fmt: skip
    held = {}
    for share in (0.0, 0.1, 0.37, 0.9):
        lattice = lattice_of(
            wavefront_rig(scene_of(**base, **{"rig.lenslets.missing_share": share, "rig.lenslets.missing_seed": 4}))
        )
        held[share] = set(zip(lattice.row.tolist(), lattice.col.tolist(), strict=True))
        assert len(held[share]) == 100 - round(100 * share)
    assert held[0.9] < held[0.37] < held[0.1] < held[0.0]
    other = lattice_of(wavefront_rig(scene_of(**base, **{"rig.lenslets.missing_share": 0.37})))
    assert set(zip(other.row.tolist(), other.col.tolist(), strict=True)) != held[0.37]
