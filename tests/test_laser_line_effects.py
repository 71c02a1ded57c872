"""Effects that a laser-line rig may have: focus and Scheimpflug tilt, speckle, motion within an exposure, blooming."""

from __future__ import annotations

import json
import warnings
from typing import Any

import numpy as np
import pytest

from beambench.generator.generate import generate
from beambench.generator.laser_line.detected import bloomed
from beambench.optics.defocus import apparent_depth, disc_diameter, scheimpflug_tangent
from beambench.optics.dome import DomePort
from beambench.optics.pinhole import Pinhole
from beambench.optics.port import FlatPort
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene
from beambench.scenes.rigs.laser_line_effects import Blooming

BASE: dict[str, Any] = {"rig.frames.lit": 1, "rig.camera.rows": 24}


def _capture(effects: dict[str, Any] | None, seed: int = 1, **more: Any) -> Any:
    changes = (
        BASE
        | {k.replace("__", "."): v for k, v in more.items()}
        | ({} if effects is None else {"rig.effects": effects})
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return generate(load_scene("spotscan-wall", changes), seed=seed, capture_key=1, truth_electrons=True, rtol=1e-3)


def test_the_disc_of_a_point_is_that_of_rays_through_the_lens() -> None:
    """Rays from a point to the lens's rim and on to the image by similar triangles; their second moment on the sensor is D²/16."""
    f, n, focus, s = 0.025, 4.0, 1.0, 0.7
    disc = float(disc_diameter(s, 0.0, focal_length_m=f, f_number=n, focus_m=focus, tilt_tangent=0.0))
    sensor, image = 1 / (1 / f - 1 / focus), 1 / (1 / f - 1 / s)
    rng = np.random.default_rng(1)
    r, a = 0.5 * f / n * np.sqrt(rng.random(400_000)), rng.uniform(0, 2 * np.pi, 400_000)
    x = r * np.cos(a) * (1.0 - sensor / image)
    assert 2 * np.abs(x).max() == pytest.approx(disc, rel=1e-3)
    assert x.var() == pytest.approx(disc**2 / 16, rel=4 * np.sqrt(1.0 / 400_000))


def test_the_laser_plane_is_sharp_on_a_scheimpflug_sensor() -> None:
    """Every point of the plane, not only that on the axis; an untilted sensor has that one only."""
    turn = np.deg2rad(-10.0)
    normal, source = np.array([np.cos(turn), 0.0, -np.sin(turn)]), np.array([0.15, 0.0, 0.0])
    f, pitch = 0.025, 57.8e-6
    depth, tangent = scheimpflug_tangent(normal, source, f)
    z = np.linspace(0.5, 3.0, 40)
    x = (normal @ source - normal[2] * z) / normal[0]
    lens: dict[str, Any] = {"focal_length_m": f, "f_number": 2.8, "focus_m": depth}
    # x on the tilted sensor: v X/Z with v = v₀ + x tanτ.
    image = f * depth / (depth - f)
    at = image * (x / z) / (1.0 - tangent * x / z)
    assert np.abs(disc_diameter(z, at, tilt_tangent=tangent, **lens)).max() < 1e-12
    assert disc_diameter(z, at, tilt_tangent=0.0, **lens).max() > pitch


@pytest.mark.parametrize(
    "port", [FlatPort(0.03, 0.01, 1.0, 1.52, 1.34), DomePort((0.0, 0.0, -0.01), 0.08, 0.008, 1.0, 1.5, 1.34)]
)  # fmt: skip
def test_the_apparent_depth_is_where_rays_near_the_axis_seem_to_meet(port: Any) -> None:
    """Two pupils 20 µm apart look at one point; the rays inside meet, prolonged, at the apparent depth. A pupil that is moved is a
    camera whose port and point are moved the other way."""
    from dataclasses import replace

    depth, step = 0.9, 2e-5
    if isinstance(port, DomePort):
        aside: Any = replace(port, center_m=(-step, 0.0, port.center_m[2]))
    else:
        aside = port
    point = np.array([[-step], [0.0], [depth]])
    x = (Pinhole(1.0, 0.0, 0.0, port=aside).project(point)[1])[0]
    assert -step / x == pytest.approx(float(apparent_depth(depth, port)), rel=1e-4)


def test_defocus_widens_the_line_by_its_second_moment() -> None:
    """Truth's width and the image's own second moment, both with the disc's D²/16 added. A rig without effects keeps its bits."""
    plain = _capture(None)
    assert "effects" not in json.loads(plain.attrs["truth_scene"])["rig"]
    blurred = _capture({"focus": {"distance_m": 0.6}}, rig__camera__f_number=4.0)
    scene = load_scene("spotscan-wall", BASE)
    window = json.loads(plain.attrs["rig"])
    flat = FlatPort(0.03, 0.01, window["port"]["inside_index"], 1.52, window["medium"]["phase_index"])
    z = blurred["truth_point"].values[0, :, 0, 2]
    disc = disc_diameter(
        apparent_depth(z, flat), 0.0, focal_length_m=0.025, f_number=4.0, focus_m=float(apparent_depth(0.6, flat)),
        tilt_tangent=0.0,
    )  # fmt: skip
    extra = (disc / 4 / scene.rig.camera.pixel_pitch_m) ** 2  # type: ignore[attr-defined]
    assert extra.min() > 0.1
    width = [c["truth_width"].values[0, :, 0] ** 2 for c in (plain, blurred)]
    np.testing.assert_allclose(width[1] - width[0], extra, rtol=2e-3)
    light = blurred["truth_electrons"].values[0] - blurred["truth_background"].values[0]
    x = np.arange(light.shape[1])
    mean = (light * x).sum(axis=1) / light.sum(axis=1)
    seen = (light * (x - mean[:, None]) ** 2).sum(axis=1) / light.sum(axis=1) - 1 / 12
    np.testing.assert_allclose(seen, width[1], rtol=0.02)
    sharp = _capture({"focus": {"sensor_tilt_deg": "scheimpflug"}}, rig__camera__f_number=4.0)
    np.testing.assert_allclose(sharp["truth_width"].values[0, :, 0] ** 2, width[0], rtol=0.02)


def test_speckle_has_its_contrast_and_leaves_the_mean() -> None:
    """Bright pixels of many seeds: relative variance 1/M above that of photons and readout."""
    looks = 25.0
    plain, frames = _capture(None), [_capture({"speckle_looks": looks}, seed=s)["counts"].values[0] for s in range(14)]
    mean = plain["truth_electrons"].values[0].astype(float)
    bright = mean > 0.3 * mean.max()
    rig = json.loads(plain.attrs["rig"])["detector"]
    value = (np.stack(frames)[:, bright] - rig["offset_dn"]) / rig["gain_dn_per_e"]
    ratio = value / mean[bright]
    noise = (mean[bright] + rig["read_noise_e"] ** 2 + 1 / 12 / rig["gain_dn_per_e"] ** 2) / mean[bright] ** 2
    count = ratio.size
    assert abs(ratio.mean() - 1.0) < 4 * np.sqrt((1 / looks + noise.mean()) / count)
    assert ratio.var(axis=0, ddof=1).mean() - noise.mean() == pytest.approx(
        1 / looks, rel=5 * np.sqrt(2.5 / count) + 0.02
    )
    one, two = (_capture({"speckle_looks": looks}, seed=3)["counts"].values for _ in range(2))
    assert np.array_equal(one, two)


def test_motion_within_an_exposure_is_the_mean_of_its_poses() -> None:
    """The rig recedes from a wall square to it: the line's column moves by L, and its variance grows by L²/12."""
    more = {"rig__motion_m_per_s": [0.0, 0.0, -4.0], "rig__detector__exposure_s": 5e-3}
    still, moving = _capture(None, **more), _capture({"exposure_poses": 16}, **more)
    ends = [
        _capture(
            None, **(more | {"rig__motion_m_per_s": [0.0, 0.0, 0.0], "target__0__shape__center_m": [0.0, 0.0, 1.0 + d]})
        )
        for d in (-0.01, 0.01)
    ]
    moved = np.abs(ends[1]["truth_column"].values - ends[0]["truth_column"].values)[0, :, 0]
    assert moved.min() > 0.5
    x = np.arange(192)
    variance = []
    for capture in (still, moving):
        light = capture["truth_electrons"].values[0] - capture["truth_background"].values[0]
        mean = (light * x).sum(axis=1) / light.sum(axis=1)
        variance.append((light * (x - mean[:, None]) ** 2).sum(axis=1) / light.sum(axis=1))
    np.testing.assert_allclose(variance[1] - variance[0], moved**2 / 12, rtol=0.05)
    told = {line["name"]: line["modelled"] for line in json.loads(moving.attrs["fidelity"])["effects"]}
    assert told["motion blur"] and not told["speckle"]
    chosen = generate(
        load_scene("spotscan-wall", BASE | {"rig.effects": {"exposure_poses": 4}, "rig.motion_m_per_s": [2.0, 0.0, 0.0]}),
        seed=1, fidelity="auto", rtol=0.01,
    )  # fmt: skip
    assert json.loads(chosen.attrs["fidelity"])["rung"] == "direct"


def test_blooming_keeps_all_charge_that_the_drain_does_not_take() -> None:
    detector = load_scene("spotscan-wall").rig.detector  # type: ignore[attr-defined]
    light = np.full((1, 31, 5), 0.1 * detector.full_well_e, np.float32)
    light[0, 15, 2] = 4.0 * detector.full_well_e
    spilled = bloomed(light, detector, Blooming(axis="columns", lost=0.0))
    assert spilled.sum() == pytest.approx(light.sum(), rel=1e-6) and spilled.max() <= detector.full_well_e * (1 + 1e-6)
    assert np.array_equal(spilled[0, :, [0, 1, 3, 4]], light[0, :, [0, 1, 3, 4]])
    # 1.5 wells to each side fill pixels that lack .9 of one: one full, and .6 in the next.
    np.testing.assert_allclose(spilled[0, 14:17, 2] / detector.full_well_e, 1.0, rtol=1e-6)
    np.testing.assert_allclose(spilled[0, [13, 17], 2] / detector.full_well_e, 0.7, rtol=1e-6)
    drained = bloomed(light, detector, Blooming(axis="rows", lost=1.0))
    assert drained.sum() == pytest.approx(light.sum() - 3.0 * detector.full_well_e, rel=1e-6)
    assert np.array_equal(np.delete(drained[0], 15, axis=0), np.delete(light[0], 15, axis=0))


@pytest.mark.parametrize(
    ("effects", "reason"),
    [
        ({"focus": {}}, "distance_m"),
        ({"focus": {"distance_m": 1.0, "sensor_tilt_deg": "scheimpflug"}}, "one of both"),
        ({"focus": {"distance_m": 0.02}}, "focal length"),
        ({"speckle_looks": 0.5}, "speckle_looks"),
    ],
)
def test_effects_that_cannot_be_are_refused(effects: dict[str, Any], reason: str) -> None:
    with pytest.raises(InputError) as caught:
        _capture(effects)
    assert reason in f"{caught.value.what} {caught.value.where} {caught.value.allowed}"
