"""The full rung of laser lines, and what `auto` takes: against closed forms, a quadrature and photons of other code."""

from __future__ import annotations

import json
import warnings
from typing import Any

import numpy as np
import pytest
import xarray as xr

from beambench.captures.validate import validate
from beambench.generator.generate import generate
from beambench.generator.laser_line.expected import frame_light, tracing_of
from beambench.generator.laser_line.full import Rest
from beambench.generator.laser_line.setting import Setting, poses_of, setting_of
from beambench.optics.water.phase_forms import phase_cdf, phase_density
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene
from beambench.scenes.scene import Scene

AIR = {
    "name": "air", "index": {"kind": "explicit", "phase": 1.0, "group": 1.0}, "absorption_per_m": 0.0,
    "scattering_per_m": 0.0,
}  # fmt: skip
SMALL: dict[str, Any] = {
    "rig.frames.lit": 1, "rig.camera.rows": 24, "rig.camera.cols": 32, "rig.camera.pixel_pitch_m": 6 * 57.8125e-6,
}  # fmt: skip


def _water(absorption: float, scattering: float, g: float) -> dict[str, Any]:
    return {
        "name": "test water", "index": {"kind": "explicit", "phase": 1.335, "group": 1.357}, "absorption_per_m": absorption,
        "scattering_per_m": scattering, "phase_function": {"kind": "henyey-greenstein", "g": g},
    }  # fmt: skip


def _rest(scene: Scene, samples: int, seed: int = 1) -> tuple[Setting, Any, Rest]:
    setting = setting_of(scene)
    pose = poses_of(setting.rig)[0][0]
    light = frame_light(setting, pose, 1e-2, wide=True)
    tracing = tracing_of(setting, pose, light, (seed, 0, 0))
    tracing.add(samples)
    return setting, light, tracing.result(light.line.ravel(), 0.0)


@pytest.mark.parametrize("kind", ["sphere", "wall"])
def test_full_is_direct_in_clear_air_on_a_convex_target(kind: str) -> None:
    """Nothing of a convex target faces another part of it: a ray that leaks through a surface would show as light."""
    shape: dict[str, Any] = {"kind": "sphere", "center_m": [0.0, 0.0, 1.2], "radius_m": 0.4}
    changes = SMALL | {"medium": AIR} | ({"target.0.shape": shape} if kind == "sphere" else {})
    scene = load_scene("spotscan-wall", changes)
    direct, full = (
        generate(scene, seed=1, fidelity=rung, truth_electrons=True, rtol=1e-3) for rung in ("direct", "full")
    )
    difference = full["truth_electrons"].values - direct["truth_electrons"].values
    # Sub-pixel grids are those of .7 of the request: both rungs are within it.
    whole = float(np.sqrt((direct["truth_electrons"].values ** 2).mean()))
    sigma = np.hypot(full["truth_standard_error"].values, 1e-3 * whole)
    assert whole > 0 and (np.abs(difference) <= 3.0 * sigma).all()
    assert (full["truth_background"].values == direct["truth_background"].values[0]).all()
    told = {line["name"]: line["modelled"] for line in json.loads(full.attrs["fidelity"])["effects"]}
    assert told["interreflection"] and told["multiple scattering"] and told["curtain of scattered light"]


def _corner(opening_deg: float = 45.0, albedo: float = 0.6) -> list[dict[str, Any]]:
    """Two walls that meet at right angles in a vertical edge 1.1 m ahead, without light beyond their first bounces at the sides."""
    width = 0.5
    a = np.deg2rad(opening_deg)
    walls = []
    for name, side in (("left", -1), ("right", 1)):
        x, z = side * 0.5 * width * np.sin(a), 1.1 - 0.5 * width * np.cos(a)
        walls.append(
            {
                "name": name, "material": {"kind": "lambert", "albedo": albedo},
                "shape": {
                    "kind": "rectangle", "center_m": [x, 0.0, z], "width_m": width, "height_m": 0.8, "tilt_x_deg": 0.0,
                    "tilt_y_deg": side * (90.0 - opening_deg),
                },
            }
        )  # fmt: skip
    return walls


def test_the_corners_second_bounce_is_that_of_a_quadrature() -> None:
    """Light of the line on one wall of a corner, by a sum over points of the line for each pixel of the other wall. Albedo .1:
    third bounces are a hundredth of the light. It would see a wrong power of the distance, cosine, π or unit."""
    albedo = 0.1
    changes = SMALL | {
        "medium": AIR, "rig.port": {"kind": "none"}, "target": _corner(albedo=albedo), "rig.lens_sigma_px": 0.0,
        "rig.laser.rotation_deg": [0.0, -6.0, 0.0], "rig.laser.position_m": [0.25, 0.0, 0.02],
    }  # fmt: skip
    scene = load_scene("spotscan-wall", changes)
    setting, light, rest = _rest(scene, 2048)
    rows, cols = light.line.shape
    # The walls as planes through the edge: points x of the left wall have n·x = n·e.
    edge = np.array([0.0, 0.0, 1.1])
    normal = {side: np.array([-side, 0.0, -1.0]) / np.sqrt(2.0) for side in (-1, 1)}
    along = {side: np.array([side, 0.0, -1.0]) / np.sqrt(2.0) for side in (-1, 1)}
    source, frame = setting.sheet.source, setting.sheet.frame
    phi = np.linspace(-1, 1, 4001)[:-1] * setting.sheet.fan_half_angle_rad
    phi = phi + 0.5 * (phi[1] - phi[0])
    beam = frame[:, 2][:, None] * np.cos(phi) + frame[:, 1][:, None] * np.sin(phi)
    reach = {side: normal[side] @ (edge - source) / (normal[side] @ beam) for side in (-1, 1)}

    def on(side: int, at: np.ndarray) -> np.ndarray:
        away = along[side] @ (at - edge[:, None])
        return (away >= 0) & (away <= 0.5) & (np.abs(at[1]) <= 0.4)

    spots = {side: source[:, None] + beam * reach[side] for side in (-1, 1)}
    first = {side: on(side, spots[side]) & (reach[side] > 0) for side in (-1, 1)}
    flux = 1.0 / phi.size
    expected = np.zeros((rows, cols))
    part = (np.arange(4) + 0.5) / 4 - 0.5
    for down in part:
        for right in part:
            row, col = (v.ravel() for v in np.mgrid[:rows, :cols].astype(float))
            origin, d = setting.camera.rays(row + down, col + right)
            for side in (-1, 1):
                at = origin + d * (normal[side] @ (edge[:, None] - origin) / (normal[side] @ d))
                seen = on(side, at)
                lit = spots[-side][:, first[-side]]
                way = lit[:, None, :] - at[:, seen][:, :, None]
                gap = np.sqrt((way**2).sum(axis=0))
                cosines = np.tensordot(normal[side], way, 1) * np.tensordot(-normal[-side], way, 1) / gap**2
                radiance = (albedo / np.pi) ** 2 * flux * (np.maximum(cosines, 0.0) / gap**2).sum(axis=1)
                value = np.zeros(row.size)
                value[seen] = radiance * setting.per_radiance(row[seen] + down, col[seen] + right)
                expected += value.reshape(rows, cols) / part.size**2
    found, sigma = rest.light.reshape(rows, cols), rest.sigma.reshape(rows, cols)
    bright = expected > 0.05 * expected.max()
    assert bright.sum() > 100
    z = (found - expected)[bright] / np.hypot(sigma[bright], 0.02 * expected[bright])
    # 2 %: third bounces (at most albedo of the second), and 16 points of a pixel.
    assert np.abs(z).max() < 5.0 and (z**2).mean() < 1.5
    total = found[bright].sum() / expected[bright].sum()
    assert 0.99 < total < 1.0 + albedo / 2
    assert rest.epsilon < 0.01


def _photons(setting: Setting, count: int, seed: int, bins: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard error of the light of two and more events in blocks of pixels, by photons that leave the laser in water
    before an endless wall z = 1 of albedo .5. At each event but the first, a photon is counted where the camera sees it, by
    its chance of reaching the lens. The way to the wall, free paths and turns are NumPy's; nothing of the path tracer is used."""
    rng = np.random.default_rng(seed)
    scene, rig, sheet = setting.scene, setting.rig, setting.sheet
    a, b, c = scene.medium.absorption_per_m, scene.medium.scattering_per_m, scene.medium.attenuation_per_m
    phase, albedo = scene.medium.phase, 0.5
    assert phase is not None
    angle = np.linspace(0.0, np.pi, 20_001)
    cdf = phase_cdf(phase, angle)
    phi = rng.uniform(-1, 1, count) * sheet.fan_half_angle_rad
    place = np.repeat(sheet.source[:, None], count, axis=1)
    d = sheet.frame[:, 2][:, None] * np.cos(phi) + sheet.frame[:, 1][:, None] * np.sin(phi)
    weight, number = np.ones(count), np.arange(count)
    rows, cols = rig.camera.rows, rig.camera.cols
    per = np.zeros((count, bins[0] * bins[1]), np.float32)
    area = _pixel_area(setting)
    for event in range(9):
        to_wall = np.where(d[2] > 0, (1.0 - place[2]) / np.where(d[2] > 0, d[2], 1.0), np.inf)
        free = -np.log1p(-rng.random(weight.size)) / b
        hit = to_wall < free
        step = np.minimum(to_wall, free)
        place = place + d * step
        weight = weight * np.exp(-a * step)
        keep = np.isfinite(step) & (np.abs(place) < 6.0).all(axis=0)
        place, d, weight, number, hit = place[:, keep], d[:, keep], weight[keep], number[keep], hit[keep]
        if event > 0:
            row, col = setting.camera.project(place)
            good = np.isfinite(row) & np.isfinite(col)
            good[good] &= (np.abs(row[good] - (rows - 1) / 2) < rows / 2) & (
                np.abs(col[good] - (cols - 1) / 2) < cols / 2
            )
            origin, view = setting.camera.rays(row[good], col[good])
            back = np.linalg.norm(place[:, good] - origin, axis=0)
            psi = np.arccos(np.clip(-(d[:, good] * view).sum(axis=0), -1, 1))
            turned = np.where(hit[good], albedo / np.pi * np.abs(view[2]), phase_density(phase, psi))
            value = weight[good] * turned * np.exp(-c * back) * setting.per_radiance(row[good], col[good])
            value = value / area(row[good], col[good], back)
            box = np.minimum(((row[good] + 0.5) * bins[0] / rows).astype(int), bins[0] - 1) * bins[1]
            box += np.minimum(((col[good] + 0.5) * bins[1] / cols).astype(int), bins[1] - 1)
            np.add.at(per, (number[good], box), value)
        psi = np.where(hit, np.arcsin(np.sqrt(rng.random(weight.size))), np.interp(rng.random(weight.size), cdf, angle))
        axis = np.where(hit, np.array([[0.0], [0.0], [-1.0]]), d)
        d = _turned(axis, psi, rng.uniform(0, 2 * np.pi, weight.size))
        weight = weight * np.where(hit, albedo, 1.0)
    mean = per.mean(axis=0, dtype=np.float64)
    return mean.reshape(bins), (per.std(axis=0, dtype=np.float64) / np.sqrt(count)).reshape(bins)


def _turned(axis: np.ndarray, psi: np.ndarray, azimuth: np.ndarray) -> np.ndarray:
    helper = np.where(np.abs(axis[0]) < 0.9, np.array([[1.0], [0.0], [0.0]]), np.array([[0.0], [1.0], [0.0]]))
    one = np.cross(axis, helper, axis=0)
    one = one / np.linalg.norm(one, axis=0)
    two = np.cross(axis, one, axis=0)
    return np.asarray(axis * np.cos(psi) + np.sin(psi) * (one * np.cos(azimuth) + two * np.sin(azimuth)))


def _pixel_area(setting: Setting) -> Any:
    """Area [m²] square to the ray that a pixel covers at a distance beyond the port."""

    def area(row: np.ndarray, col: np.ndarray, back: np.ndarray) -> np.ndarray:
        middle, d = setting.camera.rays(row, col)
        at = middle + d * back
        ends = [setting.camera.rays(row + i, col + j) for i, j in ((0.5, 0), (-0.5, 0), (0, 0.5), (0, -0.5))]
        spots = [o + w * ((d * (at - o)).sum(axis=0) / (d * w).sum(axis=0)) for o, w in ends]
        return np.asarray(np.linalg.norm(np.cross(spots[0] - spots[1], spots[2] - spots[3], axis=0), axis=0))

    return area


def test_scattered_light_is_that_of_photons_of_other_code() -> None:
    """Halo, second curtain and light between water and wall, together, in four blocks of columns.

    Photons near the lens weigh much, so that a block without them states too small an error: all blocks take their mean one.
    """
    shape = {"tilt_x_deg": 0.0, "tilt_y_deg": 0.0, "width_m": 20.0, "height_m": 20.0}
    changes = SMALL | {"medium": _water(0.5, 0.5, 0.8)} | {f"target.0.shape.{k}": v for k, v in shape.items()}
    setting, light, rest = _rest(load_scene("spotscan-wall", changes), 128)
    found = rest.light.reshape(24, 4, 8).sum(axis=(0, 2))
    own = np.sqrt((rest.sigma**2).reshape(24, 4, 8).sum(axis=(0, 2)))
    value, sigma = (part[0] for part in _photons(setting, 200_000, 3, (1, 4)))
    error = np.hypot(own, np.sqrt((sigma**2).mean()))
    assert (np.abs(found - value) < 3.0 * error).all()
    # What it could see: some per cent of the whole.
    total = float(np.sqrt((error**2).sum()) / value.sum())
    assert total < 0.04 and abs(found.sum() / value.sum() - 1.0) < 3.0 * total
    assert light.line.sum() > 0


def test_the_halo_is_that_of_paths() -> None:
    """In water that turns light by small angles, halo and paths agree in columns beside the line within 3 standard errors, and 8 %
    that the small-angle picture and the single distance of the wall allow."""
    changes = SMALL | {"medium": _water(0.1, 0.1, 0.97), "rig.camera.pixel_pitch_m": 3 * 57.8125e-6}
    _, light, rest = _rest(load_scene("spotscan-wall", changes), 512)
    shape = light.line.shape
    off = np.rint(np.arange(shape[1]) - light.truth.column[:, :1]).astype(int)
    found, sigma = rest.light.reshape(shape), rest.sigma.reshape(shape)
    for away in (0, 1, 2, 4):
        own = np.abs(off) == away
        value, model = found[own].sum(), light.scattered.halo[own].sum()
        error = np.sqrt((sigma[own] ** 2).sum())
        assert abs(value - model) < 3.0 * error + 0.08 * model, away


def _full(scene: Scene, seed: int, rtol: float = 0.05) -> xr.Dataset:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return generate(scene, seed=seed, capture_key=5, fidelity="full", rtol=rtol, truth_electrons=True)


def test_equal_seeds_give_equal_bits_and_the_error_is_stated() -> None:
    scene = load_scene(
        "spotscan-wall", SMALL | {"medium": _water(0.1, 0.3, 0.9), "rig.frames.lit": 2, "rig.camera.rows": 12}
    )
    one, two, other = (_full(scene, seed) for seed in (3, 3, 4))
    for name in ("counts", "truth_electrons", "truth_standard_error"):
        assert np.array_equal(one[name], two[name])
    assert not np.array_equal(one["truth_electrons"], other["truth_electrons"])
    # A rig at rest sees the same light in every frame.
    assert np.array_equal(one["truth_electrons"].values[0], one["truth_electrons"].values[1])
    validate(one)
    told = json.loads(one.attrs["fidelity"])
    assert told["reached"] and told["standard_error"] <= 0.05 and told["samples_per_pixel"] >= 16
    z = (one["truth_electrons"].values - other["truth_electrons"].values)[0]
    z = z / np.hypot(one["truth_standard_error"].values, other["truth_standard_error"].values)[0]
    # 384 pixels with errors of few, skew samples; the lattice errs less than independent numbers.
    assert 0.3 < np.sqrt((z**2).mean()) < 1.4


def test_rungs_nest() -> None:
    scene = load_scene("spotscan-wall", SMALL | {"medium": _water(0.1, 0.3, 0.9), "rig.camera.rows": 12})
    direct = generate(scene, seed=1, fidelity="direct", truth_electrons=True, rtol=1e-2)["truth_electrons"].values
    full = _full(scene, 1)
    assert (full["truth_electrons"].values >= direct * (1 - 1e-3)).all()
    assert full["truth_background"].dims == ("frame", "row", "col")


def test_auto_traces_light_between_surfaces_that_the_others_leave_out() -> None:
    walls = _corner(albedo=0.9)
    base = SMALL | {
        "medium": AIR, "rig.port": {"kind": "none"}, "rig.laser.rotation_deg": [0.0, -6.0, 0.0],
        "rig.laser.position_m": [0.25, 0.0, 0.02],
    }  # fmt: skip
    rungs = {}
    for rtol in (0.3, 0.01):
        scene = load_scene("spotscan-wall", base | {"target": walls})
        told = json.loads(generate(scene, seed=1, fidelity="auto", rtol=rtol).attrs["fidelity"])
        rungs[rtol] = told["rung"]
        assert set(told["chosen"]["predicted_error"]) == {"direct", "full"}
    assert rungs == {0.3: "direct", 0.01: "full"}


def test_a_scattering_medium_needs_its_phase_function() -> None:
    scene = load_scene("spotscan-wall", SMALL | {"medium.scattering_per_m": 0.1})
    with pytest.raises(InputError, match="phase function"):
        generate(scene, seed=1, fidelity="full")


def test_traced_light_is_out_of_focus_where_the_line_is() -> None:
    """A wall square to the camera in water: a lens focused beyond it blurs as a wider point spread does, path by path."""
    f, number, pitch = 0.02, 2.0, 1e-5
    scene = load_scene("spotscan-wall", SMALL | {"medium": _water(0.1, 0.3, 0.9), "rig.port": {"kind": "none"}})
    data = scene.model_dump(mode="json")
    data["rig"]["camera"] |= {"focal_length_m": f, "f_number": number, "pixel_pitch_m": pitch, "rows": 8}
    wall = data["target"][0]["shape"]
    wall |= {"tilt_x_deg": 0.0, "tilt_y_deg": 0.0}
    depth = wall["center_m"][2]
    sensor, image = 1 / (1 / f - 1 / (0.5 * depth)), 1 / (1 / f - 1 / depth)
    blur = 0.25 * f / number * abs(1 - sensor / image) / pitch
    wide = float(np.hypot(blur, data["rig"]["lens_sigma_px"]))
    images = []
    for change in ({"effects": {"focus": {"distance_m": 0.5 * depth}}}, {"lens_sigma_px": wide}):
        made = load_scene({**data, "rig": {**data["rig"], **change}})
        images.append(_rest(made, 16)[2].light)
    assert blur > 1.0 and images[0].max() > 0
    np.testing.assert_allclose(images[0], images[1], rtol=1e-4)  # depths are traced in single precision
