"""Automatic exposure and gain of laser-line cameras: what the control does, what captures hold, and what finders make of them."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from beambench.captures.hide import hide_truth
from beambench.estimators import run_estimator
from beambench.generator.generate import generate
from beambench.generator.laser_line.exposure import control
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene
from beambench.scenes.rigs.laser_line import laser_line_rig
from beambench.scenes.spec_files import LIBRARY, read_spec_file

#: 8 bits: 200 DN of 255, offset 8 DN, .005 DN per electron: 38,400 electrons of signal.
AUTO = {"target_dn": 200.0, "exposure_s": [1e-3, 2e-2], "gain": [1.0, 8.0], "speed": 1.0, "start": "settled"}
TARGET_E = 192.0 / 5e-3


def _rig(**changes: Any) -> Any:
    return laser_line_rig(load_scene("spotscan-wall", {"rig.auto_exposure": AUTO | changes}))


def test_without_it_nothing_changes() -> None:
    """Not a key in scene, declared rig and capture."""
    scene = load_scene("spotscan-wall", {"rig.camera.rows": 8})
    assert "auto_exposure" not in json.dumps(scene.model_dump(mode="json"))
    capture = generate(scene, seed=1, fidelity="direct", rtol=0.3)
    assert (
        "auto_exposure" not in capture.attrs["rig"]
        and "gain" not in capture.coords
        and "exposure" not in capture.coords
    )


def test_exposure_first_then_gain_within_their_limits() -> None:
    """5 ms of the detector: signals that need ½, 3, 10 and 1000 times the light. A clipped pixel is still brought down."""
    for needs, exposure, gain in (
        (0.5, 0.5, 1.0),
        (3.0, 3.0, 1.0),
        (10.0, 4.0, 2.5),
        (1000.0, 4.0, 8.0),
        (0.01, 0.2, 1.0),
    ):
        factor, factor_gain = control(_rig(), np.full(3, TARGET_E / needs))
        assert factor == pytest.approx(exposure, rel=1e-6) and factor_gain == pytest.approx(gain, rel=1e-6)


def test_the_control_follows_with_its_speed() -> None:
    """A target that darkens by 4 at once: with a speed of ½ the product of exposure and gain is short of it by 4^(½^k) after k
    frames. One that brightens by 16 clips the converter, which shows at most 247/192 of the aim: the way back is slow."""
    signal = np.array([1.0, *[0.25] * 8]) * TARGET_E
    factor, gain = control(_rig(speed=0.5), signal)
    short = 4.0 / (factor * gain)[1:]
    assert short == pytest.approx(4.0 ** (0.5 ** np.arange(8)), rel=1e-6)
    factor, gain = control(_rig(speed=1.0, exposure_s=[1e-5, 1.0]), np.array([1.0, *[16.0] * 15]) * TARGET_E)
    product = (factor * gain)[1:]
    step = 192.0 / 247.0
    assert product[:3] == pytest.approx(step ** np.arange(3), rel=1e-6)
    assert product[-1] == pytest.approx(1 / 16, rel=1e-6)
    assert (product * 16.0 > 247.0 / 192.0)[:10].sum() == 10  # overexposed for ten frames


def test_the_detector_starts_with_its_own_exposure() -> None:
    factor, gain = control(_rig(start="detector"), np.full(3, TARGET_E / 2.0))
    assert factor == pytest.approx([1.0, 2.0, 2.0]) and gain == pytest.approx(1.0)


def test_a_capture_holds_its_settings_and_finders_read_them() -> None:
    """A wall that is 20 times darker: exposure 4 times, gain above 1. The brightest pixel comes to 200 DN, expectation and counts
    agree, and the stated error is not too small: rounding counts as at the least gain."""
    changes = {"rig.auto_exposure": AUTO, "target.wall.material.albedo": 0.02, "rig.frames.laser_off": 1}
    scene = load_scene("spotscan-wall", changes)
    capture = generate(scene, seed=2, fidelity="direct", rtol=0.05, truth_electrons=True)
    factor, gain = capture["exposure"].values / 5e-3, capture["gain"].values
    assert factor == pytest.approx(4.0) and (gain > 1.5).all() and np.ptp(gain) < 1e-12 * gain[0]
    mean = 8.0 + capture["truth_electrons"].values * 5e-3 * gain[:, None, None]
    assert mean[:2].max() == pytest.approx(200.0, abs=0.5)
    apart = capture["counts"].values[:2] - mean[:2]
    noise = np.sqrt(capture["truth_electrons"].values[:2] + 3600.0) * 5e-3 * gain[0]
    # 98,304 pixels: the mean to 4 of its standard errors, and to the rounding's 1/√12 each.
    assert abs(apart.mean()) < 4.0 * np.sqrt((noise**2 + 1 / 12).mean() / apart.size)
    assert (apart**2).mean() == pytest.approx((noise**2 + 1 / 12).mean(), rel=0.02)
    found = run_estimator("line-ml", hide_truth(capture))
    ok = found["valid"].values[:2]
    z = ((found["column"] - capture["truth_column"]) / found["sigma"]).values[:2][ok]
    assert ok.mean() > 0.99 and 0.85 < np.sqrt((z**2).mean()) < 1.1
    with pytest.raises(InputError, match="not positive"):
        run_estimator("line-ml", hide_truth(capture).assign_coords(gain=("frame", [1.0, 0.0, 1.0])))


def test_a_dark_count_is_data_where_the_gain_makes_read_noise_reach_it() -> None:
    """Offset 8 DN, read noise .5 DN at the declared gain and 4 DN at eight times that: Q(2.1) of dark pixels have a count of 0."""
    base = {"rig.detector.read_noise_e": 100.0, "target.wall.material.albedo": 0.02}
    from beambench.estimators.laser_line.frames import Scale, read_frames
    from beambench.estimators.rig import read_rig

    auto = {"rig.auto_exposure": AUTO | {"exposure_s": [1e-3, 1e-3], "gain": [8.0, 8.0]}}
    for changes, dead in ((auto, -np.inf), ({}, 0.0)):
        capture = hide_truth(generate(load_scene("spotscan-wall", base | changes), seed=3, fidelity="direct", rtol=0.1))
        scale = Scale.of(read_rig(capture))
        gain = capture["gain"].values if changes else np.ones(capture.sizes["frame"])
        assert (scale.deads_dn(gain) == dead).all()
        if changes:
            zeros = (capture["counts"].values == 0).mean()
            assert zeros > 0.01 and np.isfinite(read_frames(capture, scale, "unused").counts).all()


def test_the_tolerance_noise_is_that_at_the_frames_own_exposure_and_gain() -> None:
    """An automatic camera held at half of the exposure and four times the gain, and a camera that has both from the start."""
    auto = {"rig.auto_exposure": AUTO | {"exposure_s": [2.5e-3, 2.5e-3], "gain": [4.0, 4.0]}}
    fixed = {"rig.detector.exposure_s": 2.5e-3, "rig.detector.gain_dn_per_e": 2e-2}
    limits = []
    for changes in (auto, fixed, {}):
        scene = load_scene("spotscan-wall", {"rig.camera.rows": 16, "target.wall.material.albedo": 0.005} | changes)
        told = json.loads(generate(scene, seed=1, fidelity="auto", rtol="noise").attrs["fidelity"])
        limits.append(told["rtol"])
    assert limits[0] == pytest.approx(limits[1], rel=1e-3)
    assert limits[2] < 0.8 * limits[1]


def test_a_full_well_is_seen_at_a_gain_below_one() -> None:
    """Light of twelve wells: the control takes the converter, not the well, below its top, at a gain of .34 and 178 DN of 255. Rows
    that are read as if their flat top were a line err by .1 px, thirty times what they state. The same line at a tenth of
    the light, with the same gain, is read."""
    low = {"target_dn": 178.5, "exposure_s": [5e-3, 5e-3], "gain": [0.05, 10.0]}
    for power, read in ((0.15, 0.0), (0.002, 0.9)):
        limits = low if power > 0.1 else low | {"gain": [0.341, 0.341]}
        changes = {"rig.auto_exposure": AUTO | limits, "rig.laser.power_w": power, "rig.camera.rows": 32}
        capture = generate(load_scene("spotscan-wall", changes), seed=2, fidelity="direct", rtol=0.1)
        assert capture["gain"].values == pytest.approx(0.341, rel=2e-3) and capture["counts"].values.max() < 182
        found = run_estimator("line-erf", hide_truth(capture))
        held = found["valid"].values
        miss = np.abs((found["column"] - capture["truth_column"]).values[held])
        assert held.mean() == 0.0 if read == 0.0 else held.mean() > read and miss.max() < 0.2, (held.mean(), miss.max())


def test_frames_of_other_exposures_are_subtracted_by_their_rates() -> None:
    """Even ambient light, the first frame with the detector's exposure, the others longer: what is left has a mean of zero."""
    changes = {
        "rig.auto_exposure": AUTO | {"start": "detector"}, "target.wall.material.albedo": 0.1, "rig.frames.laser_off": 2,
        "rig.ambient_e_per_s": 2e5,
    }  # fmt: skip
    capture = hide_truth(generate(load_scene("spotscan-wall", changes), seed=3, fidelity="direct", rtol=0.1))
    assert len(np.unique(capture["exposure"].values)) == 2
    from beambench.estimators.laser_line.frames import Scale, read_frames
    from beambench.estimators.rig import read_rig

    scale = Scale.of(read_rig(capture))
    read = read_frames(capture, scale, "subtracted")
    left = scale.electrons(read.counts).reshape(read.shape)[:2, :, :40]  # beside the line
    # 10,240 pixels a frame, noise of 100 electrons and of the mean of two others.
    assert np.abs(left.mean(axis=(1, 2))).max() < 6.0
    found = run_estimator("line-ml[off_frames=subtracted]", capture)
    assert found["valid"].values[:2].mean() > 0.95


def test_a_level_that_the_converter_lacks_is_refused() -> None:
    for level in (8.0, 255.0, 300.0):
        with pytest.raises(InputError, match="aims at a level"):
            load_scene("spotscan-wall", {"rig.auto_exposure": AUTO | {"target_dn": level}})
    with pytest.raises(InputError, match="least value first"):
        load_scene("spotscan-wall", {"rig.auto_exposure": AUTO | {"gain": [2.0, 1.0]}})


def test_a_line_filter_lets_the_line_be_found_beside_the_vehicles_lamps() -> None:
    """300 lx of a black body of 3200 K on the wall: without a filter every pixel is full, through 3 nm the line is found.
    The two rates are in the ratio of photons in the two bands, here by Planck's law written out. What the filter
    takes of the laser's own light is part of the camera's transmission."""
    lamp = {
        "kind": "spectrum", "temperature_k": 3200.0, "illuminance_lux": 300.0, "reflectance": 0.5, "water": "none",
        "quantum_efficiency": {"wavelength_m": [300e-9, 800e-9], "value": [0.3, 0.3]},
    }  # fmt: skip
    filters = {
        "open": {"shape": "rectangular", "centre_m": 550e-9, "fwhm_m": 480e-9, "peak": 1.0},
        "line": {"shape": "gaussian", "centre_m": 532e-9, "fwhm_m": 3e-9, "peak": 0.8},
    }
    rate, found = {}, {}
    for name, band in filters.items():
        data = read_spec_file(LIBRARY / "spotscan-wall.toml")
        del data["rig"]["ambient_e_per_s"]
        data["rig"] |= {"ambient": lamp | {"filter": band}}
        scene = load_scene(data)
        rate[name] = laser_line_rig(scene).ambient_e_per_s
        capture = generate(scene, seed=1, fidelity="direct", rtol=0.3)
        found[name] = float(run_estimator("line-ml", hide_truth(capture))["valid"].values.mean())
    wave = np.linspace(310e-9, 790e-9, 200_001)
    photons = wave**-4 / np.expm1(1.438777e-2 / (wave * 3200.0))
    passed = 0.8 * np.exp(-4.0 * np.log(2.0) * ((wave - 532e-9) / 3e-9) ** 2)
    ratio = np.trapezoid(photons * passed, wave) / np.trapezoid(photons, wave)
    assert rate["line"] / rate["open"] == pytest.approx(ratio, rel=2e-3)
    assert found["open"] == 0.0 and found["line"] > 0.99


TUBE = {"gain": 100.0, "excess_noise_factor": 1.5, "phosphor_sigma_px": 0.0}


@pytest.mark.parametrize(
    "change",
    [
        {"rig.effects": {"exposure_poses": 8}, "rig.auto_exposure": AUTO},
        {"rig.effects": {"blooming": {"axis": "rows", "lost": 0.0}}, "rig.detector.intensifier": TUBE},
        {"rig.auto_exposure": AUTO, "rig.detector.intensifier": TUBE},
    ],
)
def test_options_that_are_not_modelled_together_are_refused(change: dict[str, Any]) -> None:
    """Each alone is taken."""
    with pytest.raises(InputError, match="not modelled together"):
        load_scene("spotscan-wall", change)
    for name, value in change.items():
        load_scene("spotscan-wall", {name: value})
