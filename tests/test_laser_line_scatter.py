"""The scatter rung: the curtain against a Monte Carlo of single scattering, the halo's flux, and the choice between rungs."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from beambench.generator.generate import generate
from beambench.generator.laser_line.expected import frame_light
from beambench.generator.laser_line.scattered import curtain
from beambench.generator.laser_line.setting import poses_of, setting_of
from beambench.optics.water.halo import forward_share
from beambench.optics.water.phase_forms import phase_density
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene
from beambench.scenes.scene import Scene


def _water(**changes: Any) -> Scene:
    """The wall in water that scatters as Henyey-Greenstein of g = .8, with a smaller camera."""
    medium = {
        "name": "test water", "index": {"kind": "explicit", "phase": 1.335, "group": 1.357}, "absorption_per_m": 0.2,
        "scattering_per_m": 0.3, "phase_function": {"kind": "henyey-greenstein", "g": 0.8},
    }  # fmt: skip
    return load_scene("spotscan-wall", {"medium": medium, "rig.frames.lit": 1, "rig.camera.rows": 96} | changes)


def test_the_curtain_is_that_of_photons_scattered_once() -> None:
    """Photons leave as the sheet does, are scattered where their free path ends, and are counted where the camera sees that place,
    each with its chance of reaching the lens. Nothing of the closed form's geometry (no 1/sinθ, no rays of pixels) is used."""
    scene = _water()
    setting = setting_of(scene)
    rig, sheet = setting.rig, setting.sheet
    model = curtain(setting, poses_of(rig)[0][0], scene.medium.phase)  # type: ignore[arg-type]
    rng = np.random.default_rng(5)
    count, c, b = 800_000, scene.medium.attenuation_per_m, scene.medium.scattering_per_m
    phi = rng.uniform(-sheet.fan_half_angle_rad, sheet.fan_half_angle_rad, count)
    far = 1.2  # beyond the wall
    r = -np.log1p(-rng.random(count) * -np.expm1(-c * far)) / c
    weight = -np.expm1(-c * far) * b / c
    ray = sheet.frame[:, 2][:, None] * np.cos(phi) + sheet.frame[:, 1][:, None] * np.sin(phi)
    place = sheet.source[:, None] + ray * r
    # Before the wall, which leans by 15 degrees about x and is turned by −10 about y.
    a, turn = np.deg2rad(15.0), np.deg2rad(-10.0)
    facing = np.array([np.sin(turn) * -np.cos(a), np.sin(a), np.cos(turn) * -np.cos(a)])
    before = facing @ (place - np.array([[0.0], [0.0], [1.0]])) > 0
    place, ray = place[:, before], ray[:, before]
    row, col = setting.camera.project(place)
    x, y = setting.camera.slopes(row, col)
    origin, toward = setting.camera.rays(row, col)
    back = np.linalg.norm(place - origin, axis=0)
    psi = np.arccos(np.clip(-(ray * toward).sum(axis=0), -1, 1))
    # Radiance through the port: an area A_px of the pixel gathers π/(4N²) A_px of radiance L (n_i/n_o)². In reverse, a source of
    # I photons/sr at X lights the image with I e^{−cs} times this area over the area that a pixel covers at X.
    window = setting.camera.port
    assert window is not None
    step = 0.5
    corner = [setting.camera.rays(row + i * step, col + j * step) for i, j in ((0, 1), (0, -1), (1, 0), (-1, 0))]
    normal = toward
    spots = [o + d * ((normal * (place - o)).sum(axis=0) / (normal * d).sum(axis=0)) for o, d in corner]
    area = np.linalg.norm(np.cross(spots[0] - spots[1], spots[2] - spots[3], axis=0), axis=0)
    camera = rig.camera
    etendue = np.pi / 4 * camera.pixel_pitch_m**2 / camera.f_number**2 * (window.inside / window.outside) ** 2
    photons = rig.laser.power_w * rig.detector.exposure_s * rig.wavelength_m / (6.62607015e-34 * 299792458.0)
    gain = photons * camera.transmission * camera.quantum_efficiency
    value = gain / count * weight * phase_density(scene.medium.phase, psi) * np.exp(-c * back) * etendue / area  # type: ignore[arg-type]
    good = np.isfinite(row) & np.isfinite(col) & (back > 0)
    edges_row, edges_col = np.arange(0, 97, 32) - 0.5, np.arange(0, 193, 24) - 0.5
    bins = [row[good], col[good]], [edges_row, edges_col]
    total = np.histogram2d(*bins[0], bins=bins[1], weights=value[good])[0]
    square = np.histogram2d(*bins[0], bins=bins[1], weights=value[good] ** 2)[0]
    expected = model.reshape(3, 32, 8, 24).sum(axis=(1, 3))
    seen = square > 0
    assert seen.sum() >= 9
    z = (total - expected)[seen] / np.sqrt(square[seen])
    assert (
        np.abs(z).max() < 4.0 and abs(z.mean()) < 3.0 / np.sqrt(z.size) and (z**2).mean() < 1 + 4 * np.sqrt(2 / z.size)
    )
    # What the Monte Carlo can see: the whole to a fraction of a percent.
    assert np.sqrt(square.sum()) < 0.01 * total.sum()
    assert np.isfinite(x[good]).all() and np.isfinite(y[good]).all()


def test_the_curtain_ends_at_the_wall_and_where_the_laser_is_hidden() -> None:
    """The sheet meets the wall at the line; beyond it, on the far side, it lies behind the wall."""
    scene = _water()
    setting = setting_of(scene)
    pose = poses_of(setting.rig)[0][0]
    light = frame_light(setting, pose, 1e-3, wide=False)
    veil = curtain(setting, pose, scene.medium.phase)  # type: ignore[arg-type]
    column = light.truth.column[:, 0]
    at = np.arange(192)
    far, near = at < column[:, None] - 1, at > column[:, None] + 1
    assert (veil[far] == 0).all() and (veil[near] > 0).mean() > 0.5
    assert (veil >= 0).all() and np.isfinite(veil).all()


def test_the_halo_holds_what_is_scattered_forward() -> None:
    """Over all angles e^{b(r₁+r₂)(1−B)} − 1 of the unscattered light; an image that ends at ±8 degrees holds a part of it."""
    scene = _water()
    setting = setting_of(scene)
    light = frame_light(setting, poses_of(setting.rig)[0][0], 1e-3, wide=True)
    assert light.scattered is not None
    path = float(np.median(np.linalg.norm(light.truth.point, axis=-1))) * 2
    whole = np.expm1(0.3 * path * forward_share(scene.medium.phase))  # type: ignore[arg-type]
    ratio = light.scattered.halo.sum() / light.line.sum()
    assert 0.1 * whole < ratio < whole
    # g = .8 has a mean angle of 37 degrees; a phase function of g = .99 stays within the image.
    forward = _water(**{"medium.phase_function.g": 0.995})
    held = frame_light(setting_of(forward), poses_of(setting.rig)[0][0], 1e-3, wide=True)
    assert held.scattered is not None
    ratio = held.scattered.halo.sum() / held.line.sum()
    assert ratio == pytest.approx(np.expm1(0.3 * path * forward_share(forward.medium.phase)), rel=0.15)  # type: ignore[arg-type]


def test_rungs_nest_and_say_what_they_leave_out() -> None:
    scene = _water()
    direct, scatter = (generate(scene, seed=1, fidelity=rung, truth_electrons=True) for rung in ("direct", "scatter"))
    assert (scatter["truth_electrons"].values >= direct["truth_electrons"].values - 1e-3).all()
    assert scatter["truth_background"].dims == ("frame", "row", "col")
    added = scatter["truth_electrons"].values - direct["truth_electrons"].values
    assert scatter["truth_background"].values - 5.0 == pytest.approx(added, abs=0.01 * float(added.max()))
    for capture, there in ((direct, False), (scatter, True)):
        effects = {line["name"]: line for line in json.loads(capture.attrs["fidelity"])["effects"]}
        assert effects["curtain of scattered light"]["modelled"] is there
        assert effects["forward-scattered halo"]["modelled"] is there
        assert not effects["multiple scattering"]["modelled"]


def test_auto_takes_the_cheapest_rung_that_passes() -> None:
    scene = _water(
        **{
            "medium.scattering_per_m": 0.05, "medium.absorption_per_m": 0.05, "medium.phase_function.g": 0.98,
            "rig.camera.rows": 24, "rig.camera.cols": 64, "rig.camera.pixel_pitch_m": 3 * 57.8125e-6,
        }
    )  # fmt: skip
    rungs = {}
    for rtol in (0.3, 1e-2):
        chosen = json.loads(generate(scene, seed=1, fidelity="auto", rtol=rtol).attrs["fidelity"])
        rungs[rtol] = chosen["rung"]
        assert chosen["chosen"]["predicted_error"][chosen["rung"]] <= rtol
    assert rungs == {0.3: "direct", 1e-2: "scatter"}


def test_scattered_light_needs_the_phase_function() -> None:
    scene = load_scene("spotscan-wall", {"medium.scattering_per_m": 0.1})
    with pytest.raises(InputError, match="phase function"):
        generate(scene, seed=1, fidelity="scatter")
    with pytest.raises(InputError, match="phase function"):
        generate(scene, seed=1, fidelity="auto", rtol=0.5)
