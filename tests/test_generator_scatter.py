"""The scatter rung: its limits in closed form, its ramp against quadrature, and its division into signal and background."""

from __future__ import annotations

import json
import warnings
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import xarray as xr

from beambench.captures.validate import validate
from beambench.generator.gated.direct import render_direct
from beambench.generator.gated.gates import gate_tables
from beambench.generator.gated.scatter import render_scatter
from beambench.generator.gated.view import view_of
from beambench.generator.generate import GenerationWarning, generate
from beambench.generator.water.image import image_halo, pixel_shares
from beambench.generator.water.phase import phase_of
from beambench.generator.water.ramp import backscatter_electrons, nearest_path_m
from beambench.optics import ladar
from beambench.optics.constants import C_M_PER_S
from beambench.optics.correlation.response import lookup
from beambench.optics.water.halo import forward_share, halo_spread
from beambench.optics.water.phase_forms import FournierForand, HenyeyGreenstein, phase_density
from beambench.optics.water.single import coaxial_far_field, radiance_between
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene
from beambench.scenes.medium_index import group_index
from beambench.scenes.rigs.gated import gated_rig
from beambench.scenes.scene import Scene

INDEX = {"kind": "explicit", "phase": 1.34, "group": 1.36}
FF = {"kind": "fournier-forand", "index": 1.1, "slope": 3.58}


def wall(**changes: Any) -> Scene:
    """A wall at 1.2 m in scattering water, wide beam, 33 × 33 pixels; `__` in names stands for a dot."""
    base = {
        "rig.camera.rows": 33, "rig.camera.cols": 33, "medium.index": INDEX, "medium.absorption_per_m": 0.2,
        "medium.scattering_per_m": 1.0, "medium.phase_function": FF, "target": [
            {
                "name": "wall", "material": {"kind": "lambert", "albedo": 0.5},
                "shape": {
                    "kind": "rectangle", "center_m": [0.0, 0.0, 1.2], "width_m": 6.0, "height_m": 6.0,
                    "tilt_x_deg": 0.0, "tilt_y_deg": 0.0,
                },
            }
        ],
        "rig.delays": {"start_s": 7e-9, "step_s": 2e-10, "count": 32},
    }  # fmt: skip
    return load_scene("flat-wall", base | {k.replace("__", "."): v for k, v in changes.items()})


def made(scene: Scene, fidelity: Any = "scatter") -> xr.Dataset:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GenerationWarning)
        return generate(scene, seed=1, fidelity=fidelity, truth_electrons=True)


def ramp(scene: Scene, delay: Any, target: Any, forward: bool, offset: Any = None) -> Any:
    phase = phase_of(scene)
    assert phase is not None
    delay = np.atleast_1d(np.asarray(delay, dtype=np.float64))
    gate = np.zeros(len(delay), dtype=np.int32)
    return backscatter_electrons(
        scene,
        view_of(scene),
        phase,
        gate_tables(scene),
        gate,
        delay,
        np.ones(len(delay)),
        target,
        offset,
        forward=forward,
    )


def per_radiance(scene: Scene) -> float:
    rig = gated_rig(scene)
    return rig.pulses_per_slice * float(
        ladar.pixel_photoelectrons(
            pulse_energy_j=rig.laser.pulse_energy_j, intensity_per_sr=1.0, lamp_range_m=1.0, camera_range_m=1.0,
            attenuation_per_m=0.0, response_per_sr=1.0, pixel_area_m2=rig.camera.pixel_pitch_m**2,
            f_number=rig.camera.f_number, transmission=rig.camera.transmission,
            quantum_efficiency=rig.camera.quantum_efficiency, wavelength_m=rig.laser.wavelength_m,
        )
    )  # fmt: skip


def test_without_scattering_the_rungs_are_equal_to_the_bit() -> None:
    scene = load_scene("step", {"rig.camera.rows": 20, "rig.camera.cols": 24})
    one, two = made(scene, "direct"), made(scene, "scatter")
    for name in one:
        assert np.array_equal(one[name].values, two[name].values, equal_nan=one[name].dtype.kind == "f"), name


def test_faint_scattering_tends_to_the_direct_rung() -> None:
    faint = wall(medium__scattering_per_m=1e-6)
    direct, scatter = made(faint, "direct").truth_electrons.values, made(faint, "scatter").truth_electrons.values
    # 2b·r = 2.4e-6 of the light is scattered forward; the ramp's part is smaller
    assert np.abs(scatter - direct).max() < 1e-5 * direct.max()


def test_a_capture_is_valid_and_adds_up() -> None:
    scene = wall(rig__delays={"start_s": 7e-9, "step_s": 2e-10, "count": 32, "laser_off": 2})
    capture = made(scene)
    validate(capture)
    background = capture.truth_background.values
    assert background.shape == (34, 33, 33) and (background >= 0).all() and np.isfinite(background).all()
    # light off: ambient and dark only
    assert np.ptp(background[-2:]) == 0 and background[-1, 0, 0] < background[:-2].max()
    # electrons − background is the pixel's own return: amplitude × R, whose best is erf(√ln 2) at these delays
    signal = capture.truth_electrons.values - background
    peak = signal.max(axis=0) / capture.truth_amplitude.values
    assert peak.min() > 0.74 and peak.max() < 0.7612
    told = json.loads(capture.attrs["fidelity"])
    by_name = {e["name"]: e for e in told["effects"]}
    assert told["rung"] == "scatter"
    assert by_name["forward-scattered light"]["modelled"] and by_name["volume backscatter"]["modelled"]
    assert not by_name["multiple scattering"]["modelled"]
    assert by_name["multiple scattering"]["predicted_relative_size"] > 0
    again = made(scene)
    assert np.array_equal(again.counts.values, capture.counts.values)


def test_wide_beam_and_wide_wall_lose_only_what_is_absorbed_or_turned_back() -> None:
    """e^{2br(1 − B)} more light than the direct rung, where the beam is wide against the halo (g = .995)."""
    narrow = {"kind": "henyey-greenstein", "g": 0.995}
    scene = wall(medium__phase_function=narrow, rig__laser__illumination__half_angle_rad=0.5)
    direct, scatter = made(scene, "direct"), made(scene)
    r = float(scatter.truth_range[16, 16])
    # the gate opens at the wall's own time: water in front of it is not in the sum
    veil = ramp(scene, scatter.delay.values, scatter.truth_range.values, True)
    halo_and_signal = (scatter.truth_electrons.values - veil)[:, 16, 16].sum()
    own = direct.truth_electrons.values[:, 16, 16].sum()
    gain = halo_and_signal / own
    phase = HenyeyGreenstein(0.995)
    wide = np.exp(2 * r * forward_share(phase))
    # 4 %: light of the halo beyond the widened image (±.17 rad) and beyond the beam is missing
    missing = 1 - float(halo_spread(phase, r).enclosed_within(0.15) / halo_spread(phase, r).total)
    assert missing < 0.06
    assert gain == pytest.approx(wide, rel=0.06) and gain < wide * 1.005


def test_pencil_beam_lights_the_wall_by_the_point_spread() -> None:
    scene = wall(rig__laser__illumination={"profile": "gaussian", "half_angle_rad": 5e-4, "offset_rad": [0.0, 0.0]})
    rig = gated_rig(scene)
    found = render_scatter(scene, 1e-3)
    amplitude = np.asarray(found.direct.truth["truth_amplitude"])
    assert found.halo is not None
    r = np.asarray(found.direct.truth["truth_range"])
    phase = FournierForand(1.1, 3.58)
    col = 26  # ten pixels off the axis: 52 mrad, a hundred widths of the beam
    theta = np.arctan((col - 16) * rig.camera.pixel_pitch_m / rig.camera.focal_length_m)
    h = float(halo_spread(phase, 1.0 * r[16, col]).density_at(theta))
    expected = per_radiance(scene) * h * np.exp(-2 * 1.2 * r[16, col]) / r[16, col] ** 2 * 0.5 / np.pi * np.cos(theta)
    expected *= 1 + float(found.halo.own_share(r[16, col]))
    assert amplitude[16, col] == pytest.approx(expected, rel=0.02)


def test_the_ramp_in_the_coaxial_far_field() -> None:
    """No target: single scattering through a short gate is a thin slab, through a long one an exponential integral."""
    scene = wall()
    medium = {"phase": FournierForand(1.1, 3.58), "absorption_per_m": 0.2, "scattering_per_m": 1.0}
    peak = float(view_of(scene).lamp.profile(np.zeros(1))[0])
    nothing = np.full((33, 33), np.nan)
    speed = C_M_PER_S / group_index(scene.medium, 532e-9)
    delay = 40e-9  # 4.4 m
    table = gate_tables(scene)[0]
    u = np.linspace(table.start_s, table.start_s + table.step_s * (table.value.size - 1), 20001)
    r = 0.5 * speed * (u + delay)
    density = coaxial_far_field(r, r + 1e-6, intensity_per_sr=peak, **medium) / 1e-6  # thin slabs
    expected = per_radiance(scene) * np.trapezoid(density * lookup(table, u), r)
    found = ramp(scene, delay, nothing, False)[0]
    assert found[16, 16] == pytest.approx(expected, rel=1e-3)
    # A long gate, opened 20 ns after the pulse: all of the ray from 2.2 m, up to a target at 3.1 m and without one.
    long = wall(rig__gates=[{"kind": "rectangular", "width_s": 200e-9, "transmission": 1.0}])
    start = 0.5 * 20e-9 * speed
    for end in (3.1, np.inf):
        target = np.full((33, 33), end if np.isfinite(end) else np.nan)
        whole = coaxial_far_field(start, end, intensity_per_sr=peak, **medium)
        assert ramp(long, 20e-9, target, False)[0, 16, 16] == pytest.approx(per_radiance(long) * whole, rel=0.02)


def test_the_bistatic_ramp_against_quadrature_on_single_rays() -> None:
    lamp = (0.25, -0.1, 0.05)
    scene = wall(
        rig__laser__position_m=list(lamp), medium__phase_function={"kind": "henyey-greenstein", "g": 0.9},
        rig__laser__illumination={"profile": "gaussian", "half_angle_rad": 0.3, "offset_rad": [0.0, 0.0]},
    )  # fmt: skip
    rig = gated_rig(scene)
    nothing = np.full((33, 33), np.nan)
    delays = np.array([12e-9, 18e-9, 26e-9])
    found = ramp(scene, delays, nothing, False)
    speed = C_M_PER_S / group_index(scene.medium, 532e-9)
    table = gate_tables(scene)[0]
    from beambench.generator.rays.trace import pixel_directions

    def intensity(beam: Any) -> Any:
        theta = np.arctan2(np.hypot(beam[..., 0], beam[..., 1]), beam[..., 2])
        return np.asarray(view_of(scene).lamp.profile(theta))

    for row, col in ((16, 16), (5, 20), (28, 3)):
        d = pixel_directions(rig.camera, row, col)
        for k, delay in enumerate(delays):
            edges = np.linspace(table.start_s, table.start_s + table.step_s * (table.value.size - 1), 401)
            middle = 0.5 * (edges[1:] + edges[:-1])
            cells = [
                radiance_between(
                    (a + delay) * speed, (b + delay) * speed, d, lamp, intensity=intensity,
                    phase=HenyeyGreenstein(0.9), absorption_per_m=0.2, scattering_per_m=1.0, nodes=2,
                )
                for a, b in pairwise(edges)
            ]  # fmt: skip
            expected = per_radiance(scene) * float(np.asarray(cells) @ lookup(table, middle))
            # the flat-top beam's edge crosses some rays: a node's worth of the window
            assert found[k, row, col] == pytest.approx(expected, rel=0.01, abs=1e-3 * float(found[k].max()))


def test_the_ramp_ends_at_the_target_and_follows_the_gate_map() -> None:
    scene = wall()
    speed = C_M_PER_S / group_index(scene.medium, 532e-9)
    delays = np.arange(5e-9, 16e-9, 2.5e-10)
    far, near = np.full((33, 33), 1.5), np.full((33, 33), 1.5)
    near[:, :16] = 0.9
    open_ray, cut = ramp(scene, delays, far, True), ramp(scene, delays, near, True)
    assert np.array_equal(open_ray[:, :, 16:], cut[:, :, 16:])
    late = delays > 2 * 0.9 / speed + 2.2e-9  # five σ of the pulse
    assert cut[late, :, :16].max() < 1e-6 * open_ray.max() and open_ray[late, :, :16].max() > 1e-3 * open_ray.max()
    early = delays < 2 * 0.9 / speed - 3e-9
    assert early.any() and np.allclose(open_ray[early, :, :16], cut[early, :, :16], rtol=2e-3)
    # a gate that opens later by o in a pixel sees there what another sees at a delay later by o
    offset = np.zeros((33, 33))
    offset[10, 10] = 2.5e-10
    shifted = ramp(scene, delays, np.full((33, 33), np.nan), True, offset)
    plain = ramp(scene, delays, np.full((33, 33), np.nan), True)
    assert np.allclose(shifted[4:-5, 10, 10], plain[5:-4, 10, 10], rtol=2e-3)


def test_forward_scattering_raises_the_ramp_within_its_bounds() -> None:
    scene = wall()
    delays = np.array([14e-9, 22e-9])
    nothing = np.full((33, 33), np.nan)
    single, whole = ramp(scene, delays, nothing, False), ramp(scene, delays, nothing, True)
    speed = C_M_PER_S / group_index(scene.medium, 532e-9)
    for k, delay in enumerate(delays):
        most = np.exp(speed * (delay + 1.5e-9) * forward_share(FournierForand(1.1, 3.58)))
        ratio = whole[k, 16, 16] / single[k, 16, 16]
        assert 1.5 < ratio < most


def test_the_halo_arrives_with_the_light_that_it_comes_from() -> None:
    """Left half of the view holds a near plate: the wall's own time shows its halo over the plate, and the reverse."""
    plate = {
        "name": "plate", "material": {"kind": "lambert", "albedo": 0.5},
        "shape": {
            "kind": "rectangle", "center_m": [-1.0, 0.0, 0.8], "width_m": 2.0, "height_m": 4.0, "tilt_x_deg": 0.0,
            "tilt_y_deg": 0.0,
        },
    }  # fmt: skip
    base = wall()
    scene = wall(target=[*base.model_dump(mode="json")["target"], plate])
    capture = made(scene)
    n_g = 1.36
    for side, other in ((8, 24), (24, 8)):
        r = float(capture.truth_range[16, other])
        k = int(np.argmin(np.abs(capture.delay.values + 0.5e-9 - 2 * n_g * r / C_M_PER_S)))
        veil = ramp(scene, capture.delay.values, capture.truth_range.values, True)[k, 16, side]
        halo = float(capture.truth_background[k, 16, side]) - veil
        own = float(capture.truth_electrons[k, 16, side]) - float(capture.truth_background[k, 16, side])
        source = float(capture.truth_electrons[k, 16, other])
        assert halo > 0.005 * source and halo > 20 * own


def test_kernels_hold_all_light_of_the_halo() -> None:
    camera = gated_rig(wall()).camera
    spread = halo_spread(FournierForand(1.1, 3.58), 1.2)
    pixel = camera.pixel_pitch_m / camera.focal_length_m
    share = pixel_shares(spread, pixel, 40)
    total = share[0, 0] + 2 * (share[0, 1:].sum() + share[1:, 0].sum()) + 4 * share[1:, 1:].sum()
    # a square of ±40.5 pixels holds more than its inscribed circle and less than the one around it
    inner, outer = (float(spread.enclosed_within(np.arctan(40.5 * f * pixel))) for f in (1.0, np.sqrt(2)))
    assert inner * 0.998 < total < outer * 1.002
    halo = image_halo(camera, 16, FournierForand(1.1, 3.58), 1.0, (1.0, 1.6))
    weight = halo.weights(np.linspace(0.9, 1.8, 65 * 65).reshape(65, 65))
    assert np.allclose(weight.sum(axis=0), 1, atol=1e-6)
    image = np.zeros((65, 65), dtype=np.float32)
    image[32, 32] = 1.0
    ones = np.zeros_like(weight)
    ones[0] = 1
    seen = halo.spread(image, ones)
    expected = pixel_shares(halo_spread(FournierForand(1.1, 3.58), 1.0), pixel, 16)
    assert seen[16, 16] < 1e-6 and np.allclose(seen[16, 17:], expected[0, 1:17], rtol=1e-3, atol=1e-7)
    assert np.allclose(seen, seen.T, atol=1e-7) and np.allclose(seen, seen[::-1], atol=1e-7)


def test_a_scattering_medium_without_phase_function_is_refused() -> None:
    silent = load_scene("flat-wall", {"medium.scattering_per_m": 0.2})
    with pytest.raises(InputError, match="phase function"):
        generate(silent, seed=1, fidelity="scatter")
    assert nearest_path_m(view_of(silent)) > 0
    assert render_direct(silent, 1e-2).rays > 0


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"medium.absorption_per_m": 0.1}, "not both"),
        ({"medium.phase_function": {"kind": "henyey-greenstein", "g": 0.9}}, "its own phase function"),
        ({"medium.water_type.type": "mud"}, "has no water type"),
        ({"medium.water_type.source": "me"}, "medium.water_type.source"),
        ({"medium.water_type.wavelength_m": 6.5e-7}, "530 nm"),
        ({"medium.water_type.wavelength_m": 5.2e-7}, "not that of the laser"),
    ],
)
def test_water_types_fill_the_medium_and_refuse_two_answers(changes: dict[str, Any], told: str) -> None:
    scene = load_scene("harbour-wall")
    assert (scene.medium.absorption_per_m, scene.medium.scattering_per_m) == pytest.approx((0.366, 1.824), abs=1e-3)
    assert scene.medium.phase is not None
    assert Scene.model_validate_json(scene.model_dump_json()) == scene
    other = load_scene(scene, {"medium.water_type.type": "coastal"})
    assert other.medium.scattering_per_m == pytest.approx(0.219, abs=1e-3)
    with pytest.raises(InputError, match=told):
        load_scene(scene, changes)


def test_jerlov_types_need_a_phase_function_and_take_any() -> None:
    kind = {"source": "williamson2022", "type": "III", "wavelength_m": 532e-9}
    scene = load_scene("harbour-wall", {"medium.water_type": kind})
    assert scene.medium.scattering_per_m == pytest.approx(0.29) and scene.medium.phase is None
    with pytest.raises(InputError, match="phase function"):
        phase_of(scene)
    table = {"kind": "tabulated", "angle_rad": [0.01, 1.0, np.pi], "value": [100, 0.1, 0.05], "forward_slope": -1.2}
    told = load_scene(scene, {"medium.phase_function": table})
    phase = phase_of(told)
    assert phase is not None and float(phase_density(phase, 1.0)) > 0
    assert Scene.model_validate_json(told.model_dump_json()) == told
