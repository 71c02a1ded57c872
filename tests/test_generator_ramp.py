"""Light scattered once, near the rig and for any pulse: the ramp's quadrature against an integration that shares no code.

The integration runs over the range r₂ along the camera's ray, on some 10⁵ points, with its own geometry, phase function,
beam, response of pulse and gate (normal distribution functions) and photoelectrons per radiance.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import ndtr

from beambench.generator.gated.gates import gate_tables
from beambench.generator.gated.view import view_of
from beambench.generator.water.phase import phase_of
from beambench.generator.water.ramp import backscatter_electrons
from beambench.scenes.load import load_scene
from beambench.scenes.rigs.gated import gated_rig
from beambench.scenes.scene import Scene

N_GROUP, ABSORPTION, SCATTERING, G = 1.36, 0.366, 1.824, 0.9
LIGHT = 299792458.0
BASELINES = {"coaxial": (0.0, 0.0, 0.0), "beside": (0.25, -0.1, 0.05)}
BEAMS = {"gaussian": ("gaussian", 0.3), "flat-top": ("flat-top", 0.2), "pencil": ("gaussian", 5e-3)}
PIXELS = ((2, 2), (0, 4))


def water(pulse_s: float, gate_s: float, beam: str, lamp: tuple[float, float, float]) -> Scene:
    profile, half_angle = BEAMS[beam]
    # The beam crosses the middle pixel's ray at .6 m, where all its profile is seen; along its axis if both are at one place.
    x, y, z = -lamp[0], -lamp[1], 0.6 - lamp[2]
    offset = [float(np.arctan2(x, z)), float(np.arctan2(y, np.hypot(x, z)))] if any(lamp) else [2e-3, -1e-3]
    return load_scene(
        "flat-wall",
        {
            "rig.camera.rows": 5, "rig.camera.cols": 5, "rig.camera.pixel_pitch_m": 2e-4, "rig.camera.focal_length_m": 3e-3,
            "rig.camera.f_number": 2.0, "rig.camera.vignetting": "none",
            "medium.index": {"kind": "explicit", "phase": 1.34, "group": N_GROUP},
            "medium.absorption_per_m": ABSORPTION, "medium.scattering_per_m": SCATTERING,
            "medium.phase_function": {"kind": "henyey-greenstein", "g": G},
            "rig.laser.pulse": {"kind": "gaussian", "fwhm_s": pulse_s}, "rig.laser.position_m": list(lamp),
            "rig.laser.illumination": {"profile": profile, "half_angle_rad": half_angle, "offset_rad": offset},
            "rig.gates": [{"kind": "rectangular", "width_s": gate_s, "transmission": 1.0}],
        },
    )  # fmt: skip


def generated(scene: Scene, delay: Any, end_m: float) -> Any:
    phase = phase_of(scene)
    assert phase is not None
    return backscatter_electrons(
        scene, view_of(scene), phase, gate_tables(scene), np.zeros(len(delay), np.int32), delay, np.ones(len(delay)),
        np.full((5, 5), end_m), None, forward=False,
    )  # fmt: skip


def integrated(scene: Scene, pulse_s: float, gate_s: float, delay: Any, end_m: float, row: int, col: int) -> Any:
    """∫ b β̃(ψ) I(θ)/r₁² e^{−c(r₁ + r₂)} R(n_g(r₁ + r₂)/c − t) dr₂ · photoelectrons per radiance, on a dense grid."""
    rig = gated_rig(scene)
    camera, laser = rig.camera, rig.laser
    d = np.array([(col - 2) * camera.pixel_pitch_m, (row - 2) * camera.pixel_pitch_m, camera.focal_length_m])
    d /= np.linalg.norm(d)
    s = np.asarray(laser.position_m)
    nearest = float(np.linalg.norm(s)) + 2 * camera.focal_length_m / camera.f_number
    last = end_m if np.isfinite(end_m) else (delay.max() + gate_s + 6 * pulse_s) * LIGHT / N_GROUP / 2 + 1.0
    edges = np.unique(np.concatenate([np.geomspace(1e-4, last, 60_000), np.linspace(1e-4, last, 60_000)]))
    r2, width = 0.5 * (edges[1:] + edges[:-1]), np.diff(edges)
    way = r2[:, None] * d - s
    r1 = np.sqrt(np.einsum("ij,ij->i", way, way))
    path = r1 + r2
    azimuth, elevation = laser.illumination.offset_rad
    axis = np.array([np.sin(azimuth) * np.cos(elevation), np.sin(elevation), np.cos(azimuth) * np.cos(elevation)])
    theta = np.arctan2(np.linalg.norm(np.cross(way, axis), axis=1), way @ axis)
    w = laser.illumination.half_angle_rad
    if laser.illumination.profile == "gaussian":
        total = quad(lambda t: 2 * np.pi * np.sin(t) * np.exp(-2 * (t / w) ** 2), 0, min(6 * w, np.pi / 2))[0]
        intensity = np.exp(-2 * (theta / w) ** 2) / total
    else:
        intensity = (theta <= w) / (2 * np.pi * (1 - np.cos(w)))
    cosine = -(way @ d) / r1
    turned = (1 - G * G) / (4 * np.pi * (1 + G * G - 2 * G * cosine) ** 1.5)
    light = SCATTERING * turned * intensity / r1**2 * np.exp(-(ABSORPTION + SCATTERING) * path) * width
    light[path < nearest] = 0.0
    per_radiance = (
        rig.pulses_per_slice * laser.pulse_energy_j * np.pi * camera.pixel_pitch_m**2 / (4 * camera.f_number**2)
        * camera.transmission * camera.quantum_efficiency * laser.wavelength_m / (6.62607015e-34 * LIGHT)
    )  # fmt: skip
    sigma = pulse_s / np.sqrt(8 * np.log(2))
    u = path * N_GROUP / LIGHT - delay[:, None]
    response = ndtr((gate_s - u) / sigma) - ndtr(-u / sigma)
    return per_radiance * (response @ light)


@pytest.mark.parametrize("baseline", BASELINES)
@pytest.mark.parametrize("beam", BEAMS)
@pytest.mark.parametrize("pulse_s", [1e-10, 1e-9, 7e-9, 2e-8])
def test_single_scattering_of_any_pulse_beam_and_baseline(pulse_s: float, beam: str, baseline: str) -> None:
    """Every slice that has 10⁻⁴ of the brightest one's light, from gates that open before the pulse leaves to late ones.

    .3 % of each slice: a rule that takes e^{−c·path} or a beam's edge at the middle of a node errs by 2 to 30 % here, and
    nodes that follow R alone by 4 to 16 % for pulses of 7 ns.
    """
    gate_s, lamp = pulse_s, BASELINES[baseline]
    scene = water(pulse_s, gate_s, beam, lamp)
    delay = np.linspace(-1.5 * pulse_s, 1.5e-8 + 2.0 * pulse_s, 9)
    found = generated(scene, delay, 1.2)
    for row, col in PIXELS:
        expected = integrated(scene, pulse_s, gate_s, delay, 1.2, row, col)
        if (row, col) != PIXELS[0] and beam == "pencil":
            # The ray passes the beam, of which the generator keeps all but 2·10⁻⁸ of its peak.
            assert found[:, row, col].max() <= 1e-6 * found.max()
            continue
        bright = expected > 1e-4 * expected.max()
        assert bright.any()
        assert np.abs(found[bright, row, col] / expected[bright] - 1).max() < 3e-3, (row, col)
