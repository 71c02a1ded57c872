"""Split-step propagation in the wavefront rig: phase screens where turbulence is weak, Rytov's variance, energy, truth."""

from __future__ import annotations

import json
import warnings
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad

from beambench.generator.generate import generate
from beambench.generator.wavefront.field import Pupils
from beambench.generator.wavefront.propagated import Waves, propagated
from beambench.generator.wavefront.scintillation import rytov_of
from beambench.generator.wavefront.truth import irradiances, slopes
from beambench.optics.turbulence.propagation import thin_layer_scintillation
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene
from beambench.scenes.rigs.wavefront import wavefront_rig
from beambench.scenes.rigs.wavefront_geometry import lattice_of

WATER = 532e-9 / 1.335
SMALL: dict[str, Any] = {
    "rig.lenslets.across": 6, "rig.pupil.diameter_m": 0.8e-3, "rig.pupil.modes": 10, "rig.camera.rows": 72, "rig.camera.cols": 72,
    "rig.frames.count": 1, "rig.frames.reference_exposures": 1,
}  # fmt: skip


def _pupils(layers: list[dict[str, float]], reflection: str = "mirror", seed: int = 1, **change: Any) -> Pupils:
    turbulence = {"kind": "layers", "layers": layers}
    scene = load_scene(
        "gated-turbulence", {**SMALL, "rig.turbulence": turbulence, "rig.reflection": reflection, **change}
    )
    rig = wavefront_rig(scene)
    return Pupils(rig, lattice_of(rig), seed, 1)


def _log_variance(pupils: Pupils, range_m: float, frames: int) -> tuple[float, float]:
    """(variance of log irradiance, its standard error) over frames."""
    logs = np.stack([np.log(np.abs(propagated(pupils, k, range_m, WATER)[0]) ** 2) for k in range(frames)])
    own = ((logs - logs.mean()) ** 2).mean(axis=(1, 2))
    return float(own.mean()), float(own.std(ddof=1) / np.sqrt(frames))


def test_weak_turbulence_is_that_of_phase_screens() -> None:
    """What diffraction adds to phase and amplitude is of the size of Rytov's σ: σ²/4 is the variance of log amplitude."""
    pupils = _pupils([{"range_m": 0.005, "r0_m": 1.0e-2}, {"range_m": 0.01, "r0_m": 2.0e-2}])
    field, phase = propagated(pupils, 0, 0.012, WATER)
    rest = np.angle(field * np.exp(-1j * phase))
    rest -= rest.mean()
    water = {"kind": "layers", "layers": [layer.model_dump() for layer in pupils.layers]}
    scene = load_scene("gated-turbulence", {**SMALL, "rig.turbulence": water})
    rytov = rytov_of(wavefront_rig(scene), 0.012, scene.medium)
    assert rytov < 5e-3 and phase.std() > 4 * np.sqrt(rytov)
    assert rest.std() < np.sqrt(rytov)
    assert 0.1 * np.sqrt(rytov) < np.abs(field).std() < np.sqrt(rytov)


@pytest.mark.parametrize("strength", [1.0, 0.3])
def test_rytovs_variance_of_a_point_source(strength: float) -> None:
    """5.32 (z(1 − z/r)/k r0²)^{5/6} of a spherical wave behind a thin layer; weak, so that the next order is some 5 %."""
    r0 = 1.3e-3 * strength ** (-3 / 5)
    pupils = _pupils([{"range_m": 0.3, "r0_m": r0}], "diffuse")
    found, error = _log_variance(pupils, 0.5, 24)
    expected = thin_layer_scintillation(r0, 0.3 * 0.2 / 0.5, WATER)
    assert 0.005 < expected < 0.1
    assert abs(found - expected) < 4 * error + 0.05 * expected
    assert error < 0.15 * expected


def test_rytovs_variance_of_a_mirror() -> None:
    """Both passes see the same layer: 16π ∫ κ Φ (sin(κ²z/2k) + sin(κ²(2r − z)/2k))² dκ … by quadrature, normalised by one pass."""
    z, r, r0 = 0.2, 0.3, 4.5e-3
    k = 2 * np.pi / WATER

    def integral(ways: tuple[float, ...]) -> float:
        scale = np.sqrt(k / max(ways))
        parts = [
            quad(
                lambda x: x ** (-8 / 3) * sum(np.sin(x * x * scale**2 * way / (2 * k)) for way in ways) ** 2,
                a,
                b,
                limit=800,
            )[0]
            for a, b in ((0.0, 1.0), (1.0, 6.0), (6.0, 40.0))
        ]
        return float(sum(parts) * scale ** (-5 / 3))

    expected = thin_layer_scintillation(r0, z, WATER) * integral((z, 2 * r - z)) / integral((z,))
    found, error = _log_variance(_pupils([{"range_m": z, "r0_m": r0}]), r, 24)
    assert 0.01 < expected < 0.1
    assert abs(found - expected) < 4 * error + 0.05 * expected
    assert error < 0.15 * expected


@pytest.mark.parametrize(("r0_m", "frames"), [(0.8e-3, 60), (0.3e-3, 120)])
def test_light_is_neither_gained_nor_lost(r0_m: float, frames: int) -> None:
    """The mean irradiance is that of the flat wave, within its sampling error and 1 % for the beam's soft edge."""
    pupils = _pupils([{"range_m": 0.3, "r0_m": r0_m}])
    light = np.array([np.mean(np.abs(propagated(pupils, k, 0.4, WATER)[0]) ** 2) for k in range(frames)])
    error = light.std(ddof=1) / np.sqrt(frames)
    assert error < 0.04
    assert abs(light.mean() - 1.0) < 4 * error + 0.01


def test_without_turbulence_the_field_is_flat() -> None:
    scene = load_scene("gated-turbulence", {**SMALL, "rig.turbulence": {"kind": "none"}})
    rig = wavefront_rig(scene)
    field, phase = Waves(rig, Pupils(rig, lattice_of(rig), 1, 1), WATER).at(0, 4.0)
    assert np.all(field == 1.0) and np.all(phase == 0.0)


def test_the_slope_of_a_field_with_a_branch_point() -> None:
    """u = (x − p) + i(y − q): Im u*∇u = (q − y, x − p), so that the slope of a lenslet of side d about c is (q − c_y, c_x − p)/k
    over |c − (p, q)|² + d²/6."""
    scene = load_scene("gated-turbulence", {**SMALL, "rig.pupil.samples": 32, "rig.pupil.shape": "square"})
    rig = wavefront_rig(scene)
    lattice = lattice_of(rig)
    side = len(lattice.grid_m) + 2
    x = lattice.step_m * (np.arange(side) - 0.5 * (side - 1))
    p, q, d, k = 21e-6, -40e-6, 150e-6, 2 * np.pi / 532e-9
    found = slopes((x[None, :] - p) + 1j * (x[:, None] - q), lattice, 532e-9)
    away = (lattice.x_m - p) ** 2 + (lattice.y_m - q) ** 2 + d**2 / 6
    expected = np.stack([q - lattice.y_m, lattice.x_m - p], axis=1) / (k * away[:, None])
    # Samples a 32nd of a lenslet apart; the zero lies within a lenslet.
    np.testing.assert_allclose(found, expected, atol=5e-3 * np.abs(expected).max())
    power = irradiances((x[None, :] - p) + 1j * (x[:, None] - q), lattice)
    np.testing.assert_allclose(power, away, rtol=1e-2)


@pytest.mark.parametrize("rung", ["geometric", "isolated", "coherent"])
def test_a_lenslets_light_is_that_of_its_irradiance(rung: str) -> None:
    """The light in the image of the one lenslet is `truth_flux`, up to the far tails and what varies within a cell."""
    others = [[r, c] for r in range(6) for c in range(6) if (r, c) != (2, 2)]
    scene = load_scene("gated-turbulence", {**SMALL, "rig.lenslets.missing": others, "rig.detector.intensifier": None})
    for seed in (1, 2):
        capture = generate(scene, seed=seed, fidelity=rung, rtol=1e-3, truth_electrons=True)
        light = float((capture["truth_electrons"].values[0] - 0.1).sum())
        flux = float(capture["truth_flux"].values[0, 0])
        assert 0.96 * flux < light < 1.01 * flux
        assert abs(flux / 3131.8 - 1.0) > 0.02  # not that of even light


def test_the_scene_scintillates_and_does_not_warn() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        capture = generate(load_scene("gated-turbulence", {"rig.frames.count": 2}), seed=1, fidelity="geometric")
    effects = {line["name"]: line for line in json.loads(capture.attrs["fidelity"])["effects"]}
    assert effects["scintillation"]["modelled"]
    assert json.loads(capture.attrs["truth_scene"])["rig"]["propagation"] == "split-step"
    assert "propagation" not in json.loads(capture.attrs["rig"])
    flux = capture["truth_flux"].values
    assert 0.4 < flux.std() / flux.mean() < 1.6
    inside = np.abs(capture["truth_field"].values) > 0
    assert np.isnan(capture["truth_phase"].values[inside]).sum() < 0.02 * inside.sum()
    assert np.isfinite(capture["truth_zernike"].values).all()


def test_a_scene_without_the_choice_means_phase_screens() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        one, two = (
            generate(
                load_scene("gated-turbulence", {**SMALL, "rig.propagation": choice}),
                seed=3,
                capture_key=5,
                fidelity="isolated",
            )
            for choice in (None, "phase-screens")
        )
    assert np.array_equal(one["counts"], two["counts"])
    assert np.ptp(one["truth_flux"].values) == 0.0


def test_a_way_that_needs_too_large_a_grid_is_refused() -> None:
    strong = {"kind": "layers", "layers": [{"range_m": 3.0, "r0_m": 1.0e-4}]}
    with pytest.raises(InputError, match="spreads over too many"):
        generate(load_scene("gated-turbulence", {**SMALL, "rig.turbulence": strong}), seed=1, fidelity="geometric")
