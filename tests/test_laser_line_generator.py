"""The direct rung of laser lines: absolute light, truth by independent geometry, occlusion, refusals."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
import xarray as xr
from scipy.optimize import brentq

from beambench.estimators import get_estimator, stage_result
from beambench.estimators.rig import read_rig
from beambench.generator.generate import GenerationWarning, generate
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene

#: A camera in air without a port, whose lens falls off as cos⁴, square to a wall at 1 m.
AIR: dict[str, Any] = {
    "medium": {
        "name": "air", "index": {"kind": "explicit", "phase": 1.0, "group": 1.0}, "absorption_per_m": 0.3,
        "scattering_per_m": 0.0,
    },
    "rig.port": {"kind": "none"}, "rig.camera.vignetting": "cos4", "rig.frames.lit": 1,
    "target.0.shape.tilt_x_deg": 0.0, "target.0.shape.tilt_y_deg": 0.0,
}  # fmt: skip


@pytest.fixture(scope="module")
def wall() -> xr.Dataset:
    return generate(load_scene("spotscan-wall"), seed=1, truth_electrons=True, rtol=1e-4)


def _triangulated(capture: xr.Dataset, column: np.ndarray, name: str = "triangulate-refractive") -> np.ndarray:
    lines = stage_result("line", column=column, sigma=np.full(column.shape, 1e-3), valid=np.isfinite(column))
    return np.asarray(get_estimator(name).function(lines, read_rig(capture))["point"].values)


def test_photoelectrons_of_a_row_are_those_of_the_energy_it_receives() -> None:
    """P t Δφ/2h reaches the strip of wall that a row sees; a Lambertian sends ρ/π cosθ of it per sr to the lens's area.

    The row's strip between the edges of its pixels is found on the wall by similar triangles.
    """
    scene = load_scene("spotscan-wall", AIR | {"rig.lens_sigma_px": 0.0})
    capture = generate(scene, seed=1, truth_electrons=True, rtol=1e-4)
    rig = scene.rig
    laser, camera = rig.laser, rig.camera  # type: ignore[attr-defined]
    turn = np.deg2rad(-10.0)
    axis, source = np.array([np.sin(turn), 0.0, np.cos(turn)]), np.asarray(laser.position_m)
    normal = np.array([np.cos(turn), 0.0, -np.sin(turn)])
    x = source[0] - (1.0 - source[2]) * normal[2] / normal[0]  # where the sheet meets the wall z = 1
    scale = camera.pixel_pitch_m / camera.focal_length_m
    row = np.arange(256) - 127.5
    edge = np.stack([row - 0.5, row + 0.5]) * scale
    angle = np.arctan2(edge, (np.array([x, 0.0, 1.0]) - source) @ axis)
    y = row * scale
    r1 = np.sqrt((x - source[0]) ** 2 + y**2 + (1.0 - source[2]) ** 2)
    r2 = np.sqrt(x * x + y * y + 1.0)
    energy = laser.power_w * rig.detector.exposure_s * (angle[1] - angle[0]) / (2 * laser.fan_half_angle_rad)  # type: ignore[attr-defined]
    lens = np.pi / 4 * (camera.focal_length_m / camera.f_number) ** 2 / r2  # seen under cosθ = 1/r2
    seen = energy * 0.5 / np.pi * (1.0 / r2) * lens / r2**2 * np.exp(-0.3 * (r1 + r2)) * camera.transmission
    expected = seen * camera.quantum_efficiency * laser.wavelength_m / (6.62607015e-34 * 299792458.0)
    dark = rig.detector.dark_current_e_per_s * rig.detector.exposure_s  # type: ignore[attr-defined]
    light = capture["truth_electrons"].values[0].astype(float).sum(axis=1) - 192 * dark
    # Radiance is that of the line's middle, and the wall falls off by 2e-4 across half a column; float32 sums of 192 pixels.
    assert np.abs(light / expected - 1).max() < 3e-4
    assert np.abs(capture["truth_amplitude"].values[0, :, 0] / expected - 1).max() < 1e-4


def test_columns_hold_the_sheets_profile(wall: xr.Dataset) -> None:
    """A row is its line's amplitude times the pixel-integrated Gaussian of its width, at its column."""
    from scipy.special import ndtr

    edge = np.arange(193) - 0.5
    c, a, s = (wall[f"truth_{name}"].values[0, :, 0] for name in ("column", "amplitude", "width"))
    model = a[:, None] * np.diff(ndtr((edge - c[:, None]) / s[:, None]), axis=1) + 5.0
    light = wall["truth_electrons"].values[0]
    # The line's slant, .09 columns per row, spreads it by .09/√12 within a row: 1.4e-3 of the variance.
    assert np.abs(light - model).max() < 3e-3 * light.max()


def test_the_true_column_is_that_of_an_independent_projection(wall: xr.Dataset) -> None:
    """Wall and sheet meet in a line; the point of it that a row sees, through air, glass and water by Snell's law alone."""
    rig = json.loads(wall.attrs["rig"])
    n = (rig["port"]["inside_index"], rig["port"]["glass_index"], rig["medium"]["phase_index"])
    focal = 25.0e-3 / 57.8125e-6
    turn = np.deg2rad(-10.0)
    sheet, source = np.array([np.cos(turn), 0.0, -np.sin(turn)]), np.array(rig["laser"]["position_m"])
    a = np.deg2rad(15.0)  # (0, 0, −1) turned about x, then about y
    leaning = np.array([0.0, np.sin(a), -np.cos(a)])
    facing = np.array([np.sin(turn) * leaning[2], leaning[1], np.cos(turn) * leaning[2]])
    along = np.cross(sheet, facing)
    along = along / along[1]  # per metre of y
    begin = np.linalg.solve(np.stack([sheet, facing, np.eye(3)[1]]), [sheet @ source, facing @ [0, 0, 1.0], 0.0])

    def slope_of(point: np.ndarray) -> np.ndarray:
        radius = np.hypot(point[0], point[1])

        def miss(sine: float) -> float:
            q = n[0] * sine
            tangents = [q / np.sqrt(i * i - q * q) for i in n]
            return float(0.03 * tangents[0] + 0.01 * tangents[1] + (point[2] - 0.04) * tangents[2] - radius)

        sine = brentq(miss, 0.0, 0.9, xtol=1e-15)
        return np.asarray(point[:2] / radius * sine / np.sqrt(1 - sine * sine))

    for row in (0, 60, 127, 200, 255):
        at = brentq(lambda t, r=row: float(slope_of(begin + t * along)[1] * focal - (r - 127.5)), -0.6, 0.6, xtol=1e-15)
        point = begin + at * along
        # Single-precision hits: 1e-7 of the range, 6e-5 of the 1.74 mm that a column spans.
        assert wall["truth_column"].values[0, row, 0] == pytest.approx(95.5 + focal * slope_of(point)[0], abs=1e-4)
        assert wall["truth_point"].values[0, row, 0] == pytest.approx(point, abs=2e-6)


def test_the_true_column_triangulates_to_the_true_point(wall: xr.Dataset) -> None:
    column, point = wall["truth_column"].values, wall["truth_point"].values
    assert np.abs(_triangulated(wall, column) - point).max() < 1e-12
    # A port of 40 mm that is taken for none at all, and refraction that is left out.
    assert 1e-3 < np.abs(_triangulated(wall, column, "triangulate-pinhole-port") - point).max() < 4e-3
    assert np.abs(_triangulated(wall, column, "triangulate-air") - point).max() > 0.05


@pytest.mark.parametrize(("range_m", "published"), [(1.0, 5.95e-3), (2.0, 23.1e-3)])
def test_the_predicted_greatest_error_of_a_whole_pixel(range_m: float, published: float) -> None:
    """Kusters 1992, Eq. 3.33-3.36 without aberration, n = 1.33, b = 150 mm: from a pixel's middle to its far edge."""
    scene = load_scene(
        "spotscan-wall",
        {
            "medium.index": {"kind": "explicit", "phase": 1.33, "group": 1.33}, "rig.camera.rows": 1, "rig.frames.lit": 1,
            "rig.port": {
                "kind": "flat", "stand_off_m": 0.0, "thickness_m": 0.0, "glass_index": 1.5, "inside_index": 1.0,
            },
        },
    )  # fmt: skip
    capture = generate(scene, seed=1)
    source = np.array(json.loads(capture.attrs["rig"])["laser"]["position_m"])

    def range_at(column: float) -> float:
        return float(np.linalg.norm(_triangulated(capture, np.full((1, 1, 1), column))[0, 0, 0] - source))

    column = brentq(lambda c: range_at(c) - range_m, 5.0, 150.0)
    worst = max(abs(range_at(column + step) - range_m) for step in (-0.5, 0.5))
    # The printed method is within 2.6 % of R²w/(2nfb), and ours of the printed one within a few parts in a thousand.
    assert worst == pytest.approx(published, rel=0.01)
    assert worst == pytest.approx(range_m**2 * 57.8125e-6 / (2 * 1.33 * 25e-3 * 0.15), rel=0.04)


def test_what_hides_the_laser_or_the_camera_leaves_no_line() -> None:
    """A post in the laser's way shadows the wall; a row of it that shows both has two returns, the brighter first."""
    post = {
        "name": "post", "material": {"kind": "lambert", "albedo": 0.9},
        "shape": {
            "kind": "rectangle", "center_m": [0.03, 0.0, 0.7], "width_m": 0.08, "height_m": 0.1, "tilt_x_deg": 0.0,
            "tilt_y_deg": 0.0,
        },
    }  # fmt: skip
    plain = load_scene("spotscan-wall", AIR)
    scene = load_scene(
        plain.model_copy(
            update={"target": (*plain.target, *load_scene(plain.model_dump(mode="json") | {"target": [post]}).target)}
        )
    )
    capture = generate(scene, seed=1, truth_electrons=True)
    depth = capture["truth_point"].values[0, :, 0, 2]
    middle, outside = depth[115:140], depth[[0, 20, 235, 255]]
    assert middle == pytest.approx(0.7, abs=1e-6) and outside == pytest.approx(1.0, abs=1e-6)
    light = capture["truth_electrons"].values[0] - 5.0
    seen = np.abs(np.arange(192) - capture["truth_column"].values[0, :, :1]) < 6
    assert light[~seen].max() < 1e-2 * light.max()


def test_equal_seeds_give_equal_bits_and_frames_without_laser_are_dark() -> None:
    scene = load_scene("spotscan-wall", {"rig.frames.laser_off": 1, "rig.ambient_e_per_s": 1e5})
    one, two, other = (generate(scene, seed=seed, capture_key=7) for seed in (3, 3, 4))
    assert np.array_equal(one["counts"], two["counts"]) and not np.array_equal(one["counts"], other["counts"])
    assert one["laser_on"].values.tolist() == [True, True, False]
    assert np.isnan(one["truth_column"].values[2]).all() and np.isfinite(one["truth_column"].values[:2]).all()
    # Offset 8 DN and (500 + 5) · .005: 10.5 DN, and 192 · 256 pixels of .43 DN.
    assert one["counts"].values[2].mean() == pytest.approx(10.525, abs=4 * 0.43 / np.sqrt(256 * 192))
    assert one["truth_background"].values == pytest.approx(505.0)


def test_a_moving_rig_has_poses_and_other_lines() -> None:
    scene = load_scene("spotscan-wall", {"rig.motion_m_per_s": [0.0, 0.0, 0.5], "rig.turn_rad_per_s": [0.0, 0.05, 0.0]})
    capture = generate(scene, seed=1)
    assert capture["pose"].values[1] == pytest.approx([0, 0, 0.1, 0, 0.01, 0])
    nearer = np.linalg.norm(capture["truth_point"].values, axis=-1)
    assert (nearer[0] - nearer[1]).mean() == pytest.approx(0.1, abs=0.01)
    effects = {line["name"]: line for line in json.loads(capture.attrs["fidelity"])["effects"]}
    assert effects["motion blur"]["predicted_relative_size"] > 0 and not effects["motion blur"]["modelled"]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"rig.laser.position_m": [0.0, 0.1, 0.0], "rig.laser.rotation_deg": [0.0, 0.0, 0.0]}, "entrance pupil"),
        ({"rig.port.inside_index": 3.9, "rig.camera.focal_length_m": 5e-3}, "No ray leaves"),
        ({"rig.camera.focus_distance_m": 1.0}, "focus of a laser-line camera"),
        ({"rig.laser.position_m": [0.15, 0.0, -0.1]}, "behind the"),
        ({"rig.laser.position_m": [0.15, 0.0, 1.5]}, "behind the target"),
    ],
)
def test_an_impossible_rig_is_refused(change: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        generate(load_scene("spotscan-wall", change), seed=1)


def test_scattered_light_is_never_left_out_in_silence() -> None:
    """`direct` says what the water sends back; `auto` takes a rung that models it."""
    murky = load_scene("spotscan-wall", {"medium": {
        "name": "harbour", "index": {"kind": "water", "temperature_c": 18.0, "salinity_psu": 33.0},
        "water_type": {"source": "petzold1972", "type": "harbour", "wavelength_m": 532e-9},
    }})  # fmt: skip
    with pytest.warns(GenerationWarning, match="halo is left out"):
        capture = generate(murky, seed=1)
    effects = {line["name"]: line for line in json.loads(capture.attrs["fidelity"])["effects"]}
    assert effects["curtain of scattered light"]["predicted_relative_size"] > 1e-3
    chosen = generate(murky, seed=1, fidelity="auto", rtol=0.1)
    assert json.loads(chosen.attrs["fidelity"])["rung"] in ("scatter", "full")
    clear = generate(load_scene("spotscan-wall"), seed=1, fidelity="auto", rtol=1e-2)
    assert json.loads(clear.attrs["fidelity"])["rung"] == "direct"
