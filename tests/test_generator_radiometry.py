"""Absolute photoelectrons against Mitsuba's own sensor, emitter and BSDF, and a lens that is integrated here."""

from __future__ import annotations

import numpy as np
import pytest

from beambench.generator.generate import generate
from beambench.generator.rays.backend import mitsuba
from beambench.scenes.load import load_scene

PIXELS, PITCH, FOCAL, F_NUMBER = 15, 400e-6, 5e-3, 20.0


def _radiance() -> np.ndarray:
    """Radiance of each pixel, per W/sr of a point source at the camera, by Mitsuba's sensor, emitter, BSDF and integrator."""
    mi = mitsuba()
    fov = float(np.degrees(2.0 * np.arctan(0.5 * PIXELS * PITCH / FOCAL)))
    film = {
        "type": "hdrfilm",
        "width": PIXELS,
        "height": PIXELS,
        "rfilter": {"type": "box"},
        "pixel_format": "luminance",
    }
    sensor = {"type": "perspective", "fov": fov, "fov_axis": "x", "near_clip": 1e-3, "film": film,
              "to_world": mi.ScalarTransform4f().look_at(origin=[0, 0, 0], target=[0, 0, 1], up=[0, -1, 0]),
              "sampler": {"type": "independent"}}  # fmt: skip
    wall = {"type": "rectangle", "to_world": mi.ScalarTransform4f().translate([0, 0, 5]).rotate([0, 1, 0], 180).scale(20),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "spectrum", "value": 0.5}}}  # fmt: skip
    world = mi.load_dict({"type": "scene", "integrator": {"type": "path", "max_depth": 2}, "sensor": sensor, "wall": wall,
                          "lamp": {"type": "point", "position": [0, 0, 0],
                                   "intensity": {"type": "spectrum", "value": 1.0}}})  # fmt: skip
    image = np.asarray(mi.render(world, spp=8192, seed=1))
    return image.reshape(PIXELS, PIXELS, -1)[:, :, 0].astype(np.float64)


def _lens() -> np.ndarray:
    """Irradiance per radiance at each pixel, sr: ∫ cosθ₁ cosθ₂/d² dA over the aperture, a focal length before the sensor."""
    share, turn = (np.arange(400) + 0.5) / 400, np.pi * (3.0 - np.sqrt(5.0)) * np.arange(400)
    radius = 0.5 * FOCAL / F_NUMBER * np.sqrt(share)
    place = PITCH * (np.arange(PIXELS) - PIXELS // 2)
    dx = radius * np.cos(turn) - place[None, :, None]
    dy = radius * np.sin(turn) - place[:, None, None]
    square = dx**2 + dy**2 + FOCAL**2
    return np.asarray((FOCAL**2 / square**2).mean(axis=2) * np.pi * (0.5 * FOCAL / F_NUMBER) ** 2)


@pytest.mark.parametrize("vignetting", ["cos4", "none"])
def test_photoelectrons_are_those_of_mitsubas_sensor_behind_a_real_aperture(vignetting: str) -> None:
    """Energy 2.5 µJ in a cone of 1 rad, quantum efficiency .4, transmission .8, h and c written out; no factor of ours.

    Tolerance 3e-3: the aperture of f/20 is 6e-4 off its small-lens limit, Mitsuba's noise over 8,192 samples of a pixel whose
    light varies by 3 % is 3e-4 (four of them: 1.3e-3), our rays' rtol is 1e-3. cos⁴ is .37 in the corner: one cosine too few or
    too many would err by 20 % there.
    """
    scene = load_scene("flat-wall", {
        "rig.camera.rows": PIXELS, "rig.camera.cols": PIXELS, "rig.camera.pixel_pitch_m": PITCH,
        "rig.camera.focal_length_m": FOCAL, "rig.camera.f_number": F_NUMBER, "rig.camera.vignetting": vignetting,
        "rig.laser.illumination.half_angle_rad": 1.0, "target.0.shape.width_m": 40.0, "target.0.shape.height_m": 40.0,
        "rig.laser.pulse_energy_j": 2.5e-6,
    })  # fmt: skip
    pulses = int(generate(scene, seed=1, rtol=1e-3)["pulses"].values.flat[0])
    ours = generate(scene, seed=1, rtol=1e-3)["truth_amplitude"].values
    per_sr = 2.5e-6 / (2.0 * np.pi * (1.0 - np.cos(1.0)))
    electrons = 0.4 * 0.8 * 532e-9 / (6.62607015e-34 * 299_792_458.0)
    lens = _lens()
    if vignetting == "none":
        lens = np.full_like(lens, lens[PIXELS // 2, PIXELS // 2])
    expected = pulses * per_sr * _radiance() * lens * PITCH**2 * electrons
    assert lens.min() / lens.max() < 0.45 or vignetting == "none"
    np.testing.assert_allclose(ours, expected, rtol=3e-3)
