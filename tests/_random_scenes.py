"""Random valid scenes, drawn over all specs: shapes, materials, media, rigs, pulses, gates, detectors, three modalities."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene
from beambench.scenes.meshes import shape_mesh
from beambench.scenes.possible import check_solid
from beambench.scenes.scene import Scene

__all__ = ["draw_scene"]

R = np.random.Generator


def _between(rng: R, low: float, high: float) -> float:
    return float(rng.uniform(low, high))


def _log(rng: R, low: float, high: float) -> float:
    return float(math.exp(rng.uniform(math.log(low), math.log(high))))


def _one(rng: R, *choices: Any) -> Any:
    return choices[int(rng.integers(len(choices)))]


def _place(rng: R, far: float) -> list[float]:
    return [_between(rng, -0.5, 0.5), _between(rng, -0.5, 0.5), _between(rng, 0.4 * far, far)]


def _turn(rng: R) -> list[float]:
    return [_between(rng, -180.0, 180.0) for _ in range(3)]


def _tilt(rng: R) -> dict[str, float]:
    return {"tilt_x_deg": _between(rng, -80, 80), "tilt_y_deg": _between(rng, -80, 80)}


def _shape(rng: R, far: float, mesh: Path) -> dict[str, Any]:
    kind = _one(rng, "rectangle", "rectangle", "sphere", "box", "height-grid", "mesh")
    base = {"kind": kind, "center_m": _place(rng, far)}
    size = _log(rng, 0.05, 4.0)
    if kind == "rectangle":
        return base | {"width_m": size, "height_m": _log(rng, 0.05, 4.0)} | _tilt(rng)
    if kind == "sphere":
        return base | {"radius_m": size / 4}
    if kind == "box":
        return base | {"size_m": [_log(rng, 0.02, 1.0) for _ in range(3)], "rotation_deg": _turn(rng)}
    if kind == "height-grid":
        return base | {"file": "library:relief.npz", "width_m": size, "relief_m": 0.1 * size} | _tilt(rng)
    return base | {"file": str(mesh), "size_m": size / 2, "rotation_deg": _turn(rng)}


def _material(rng: R) -> dict[str, Any]:
    part = _between(rng, 0.0, 1.0)
    return dict(_one(
        rng,
        {"kind": "lambert", "albedo": part},
        {"kind": "phong", "diffuse_albedo": 0.6 * part, "specular_albedo": 0.4 * part, "exponent": _log(rng, 1, 300)},
        {"kind": "cook-torrance", "diffuse_albedo": 0.5 * part, "f0": 0.1 * part, "roughness": _log(rng, 0.02, 1.0),
         "distribution": _one(rng, "beckmann", "ggx")},
        {"kind": "chua", "k_s": 0.1 * part, "k_d": 0.2, "slope": _log(rng, 0.05, 1.0), "diffusivity": _between(rng, 0, 3),
         "convention": _one(rng, "as-printed-radiance", "brdf", "reciprocal")},
    ))  # fmt: skip


def _phase(rng: R) -> dict[str, Any]:
    angle = [0.01, 0.1, 0.5, 1.5, math.pi]
    return dict(_one(
        rng,
        {"kind": "henyey-greenstein", "g": _between(rng, -0.5, 0.97)},
        {"kind": "fournier-forand", "index": _between(rng, 1.02, 1.2), "slope": _between(rng, 3.1, 4.5)},
        {"kind": "molecular", "depolarisation": 0.09},
        {"kind": "tabulated", "angle_rad": angle, "value": [_log(rng, 0.1, 10) / a for a in angle], "forward_slope": -1.0},
    ))  # fmt: skip


def _medium(rng: R) -> tuple[dict[str, Any], float]:
    """The medium, and the laser's wavelength."""
    wave = _between(rng, 450e-9, 650e-9)
    index = _one(
        rng, {"kind": "explicit", "phase": 1.33, "group": _between(rng, 1.0, 1.5)},
        {"kind": "water", "temperature_c": _between(rng, 0, 30), "salinity_psu": _between(rng, 0, 35)},
        {"kind": "air", "temperature_c": _between(rng, -20, 40), "pressure_pa": 1e5},
    )  # fmt: skip
    kind = int(rng.integers(4))
    medium: dict[str, Any] = {"name": "drawn", "index": index}
    if kind == 0:
        return medium | {"absorption_per_m": 0.0, "scattering_per_m": 0.0}, wave
    if kind == 1:
        water = _one(rng, ("petzold1972", "harbour"), ("petzold1972", "clear"), ("pure", "sea"))
        told = {"source": water[0], "type": water[1], "wavelength_m": 530e-9}
        return medium | {"water_type": told}, 530e-9
    if kind == 2:
        told = {"source": "solonenko2015", "type": _one(rng, "II", "III", "5C"), "wavelength_m": 532e-9}
        return medium | {"water_type": told, "phase_function": _phase(rng)}, 532e-9
    told = {"absorption_per_m": _log(rng, 1e-3, 1.0), "scattering_per_m": _log(rng, 1e-3, 2.0)}
    return medium | told | {"phase_function": _phase(rng)}, wave


def _pulse(rng: R) -> dict[str, Any]:
    w = _log(rng, 2e-10, 8e-9)
    usual = {"kind": "gaussian", "fwhm_s": w}
    return dict(_one(
        rng, usual, usual, usual, usual, {"kind": "rectangular", "width_s": w},
        {"kind": "trapezoidal", "rise_s": 0.3 * w, "top_s": 0.4 * w, "fall_s": 0.5 * w},
        {"kind": "exponential", "fwhm_s": w, "tail_s": 0.5 * w},
        {"kind": "sampled", "step_s": w / 4, "value": [0.0, 1.0, _between(rng, 0.5, 2), 0.5, 0.2, 0.0]},
    ))  # fmt: skip


def _gate(rng: R) -> dict[str, Any]:
    w, t = _log(rng, 3e-10, 2e-8), _between(rng, 0.1, 1.0)
    usual = {"kind": "rectangular", "width_s": w, "transmission": t}
    return dict(_one(
        rng, usual, usual, usual, usual,
        {"kind": "trapezoidal", "width_s": w, "rise_s": 0.3 * w, "fall_s": 0.4 * w, "transmission": t},
        {"kind": "gaussian", "fwhm_s": w, "transmission": t},
        {"kind": "exponential", "width_s": w, "tail_s": 0.3 * w, "transmission": t},
        {"kind": "sampled", "start_s": -0.5 * w, "step_s": w / 3, "value": [0.0, 0.6 * t, t, 0.0]},
    ))  # fmt: skip


def _illumination(rng: R, narrowest_rad: float = 5e-4) -> dict[str, Any]:
    offset = _one(rng, [0.0, 0.0], [_between(rng, -0.2, 0.2), _between(rng, -0.2, 0.2)])
    base = {
        "profile": _one(rng, "gaussian", "flat-top", "measured"),
        "half_angle_rad": _log(rng, narrowest_rad, 0.9),
        "offset_rad": offset,
    }
    return base | ({"radial_value": [1.0, 0.8, 0.9, 0.1]} if base["profile"] == "measured" else {})


def _ambient(rng: R) -> dict[str, Any]:
    if rng.uniform() < 0.7:
        return {"ambient_e_per_s": _log(rng, 1.0, 1e9)}
    band = {"shape": _one(rng, "gaussian", "rectangular"), "centre_m": 540e-9, "fwhm_m": 1e-8, "peak": 0.7}
    return {"ambient": {
        "kind": "spectrum", "illuminant": _one(rng, "A", "D65", "LED-B3"), "illuminance_lux": _log(rng, 0.1, 1e4),
        "reflectance": 0.4, "filter": band, "quantum_efficiency": "of the detector",
        "water": _one(rng, "none", {"source": "solonenko2015", "type": "II", "down_m": 3.0, "view_m": 1.0}),
    }}  # fmt: skip


def _readout(rng: R) -> dict[str, Any]:
    return {"read_noise_e": _between(rng, 0, 20), "gain_dn_per_e": _log(rng, 0.01, 4), "offset_dn": _between(rng, 0, 60),
            "full_well_e": _log(rng, 1e3, 1e6), "adc_bits": int(rng.integers(6, 17))}  # fmt: skip


def _gated(rng: R, wave: float, far: float) -> dict[str, Any]:
    tube = {
        "gain": _log(rng, 1, 500),
        "excess_noise_factor": _between(rng, 1, 4),
        "phosphor_sigma_px": _between(rng, 0, 1.5),
    }
    laser = {
        "wavelength_m": wave, "pulse_energy_j": _log(rng, 1e-12, 1e-3), "pulse": _pulse(rng),
        "illumination": _illumination(rng, 0.05),
        "position_m": _one(rng, [0.0, 0.0, 0.0], [_between(rng, -0.5, 0.5), 0.2, _between(rng, 0, 0.2)]),
        "energy_fluctuation": _one(rng, 0.0, 0.1),
        "jitter_shot_s": _one(rng, 0.0, 0.0, 0.0, 1e-10), "jitter_frame_s": _one(rng, 0.0, 1e-10),
    }  # fmt: skip
    return {
        "kind": "gated", "laser": laser, "gates": [_gate(rng) for _ in range(int(rng.integers(1, 3)))],
        "camera": {"rows": int(rng.integers(1, 9)), "cols": int(rng.integers(1, 9)), "pixel_pitch_m": _log(rng, 5e-6, 5e-5),
                   "focal_length_m": _log(rng, 1e-4, 2e-2), "f_number": _between(rng, 1, 8), "transmission": 0.8,
                   "quantum_efficiency": _between(rng, 0.05, 0.9), "vignetting": _one(rng, "none", "cos4")},
        "delays": {"start_s": 2 * 0.9 * far / 3e8, "step_s": 2 * far / 3e8 / 12, "count": int(rng.integers(3, 9)),
                   "repeats": int(rng.integers(1, 3)), "laser_off": int(rng.integers(0, 3))},
        "pulses_per_slice": int(rng.integers(1, 500)), "t0_s": _one(rng, 0.0, 1e-9),
        "gate_map": _one(rng, None, {"iris_s": _between(rng, -1e-9, 1e-9), "skew_s": [1e-10, -2e-10]}),
        "detector": _readout(rng) | {"dark_current_e_per_s": _log(rng, 0.1, 1e5), "exposure_s": 1e-2,
                                     "prnu": _one(rng, 0.0, 0.02), "dsnu_e": _one(rng, 0.0, 3.0), "fixed_pattern_seed": 3,
                                     "intensifier": _one(rng, None, tube)},
    }  # fmt: skip


def _ranger(rng: R, wave: float, far: float, kind: str) -> dict[str, Any]:
    base: dict[str, Any] = {
        "kind": kind, "t0_s": _one(rng, 0.0, 1e-9),
        "receiver": {"aperture_diameter_m": _log(rng, 2e-3, 0.1), "focal_length_m": _log(rng, 1e-2, 0.2), "transmission": 0.7},
    }  # fmt: skip
    scan = _one(rng, 0.0, _between(rng, 0.01, 0.5))
    diameter = _log(rng, 5e-5, 5e-3)
    if kind == "amcw":
        frequencies = sorted({_log(rng, 1e6, 5e8) for _ in range(int(rng.integers(1, 4)))})
        return base | {
            "laser": {"wavelength_m": wave, "power_w": _log(rng, 1e-5, 1.0), "modulation_depth": _between(rng, 0.1, 1),
                      "illumination": _illumination(rng), "power_fluctuation": _one(rng, 0.0, 0.1)},
            "detector": _readout(rng) | {"active_diameter_m": diameter, "quantum_efficiency": 0.4, "dark_e_per_s": 1e4,
                                         "demodulation_contrast": _between(rng, 0.1, 1)},
            "modulation": {"frequencies_hz": frequencies, "phase_steps": int(rng.integers(3, 9)), "integration_s": 5e-6},
            "shots": int(rng.integers(1, 20)), "scan_half_angle_rad": scan, "range_window_m": [0.1, 3 * far],
        }  # fmt: skip
    tube = {"gain": 50.0, "excess_noise_factor": 3.0}
    analog = {"kind": "analog"} | _readout(rng) | {"avalanche": _one(rng, None, tube)}
    photon = {"kind": "single-photon", "dead_time_s": _one(rng, 0.0, 5e-9)}
    return base | {
        "laser": {"wavelength_m": wave, "pulse_energy_j": _log(rng, 1e-14, 1e-6), "pulse": _pulse(rng),
                  "illumination": _illumination(rng), "energy_fluctuation": _one(rng, 0.0, 0.1),
                  "jitter_pulse_s": _one(rng, 0.0, 1e-10), "jitter_shot_s": _one(rng, 0.0, 1e-10)},
        "detector": {"active_diameter_m": diameter, "quantum_efficiency": 0.4, "dark_e_per_s": _log(rng, 1, 1e6),
                     "response": {"shape": _one(rng, "gaussian", "single-pole"), "rise_time_s": _log(rng, 1e-10, 2e-9)},
                     "readout": _one(rng, analog, photon)},
        "record": {"start_s": _one(rng, 0.0, 1e-8), "step_s": _log(rng, 1e-10, 1e-9), "samples": int(rng.integers(4, 100)),
                   "shots": int(rng.integers(1, 20)), "scan_half_angle_rad": scan},
        "pulses_per_shot": int(rng.integers(1, 300)), "counter_hz": _one(rng, None, 1e9),
    }  # fmt: skip


def draw_scene(number: int, mesh: Path, texture: Path) -> tuple[Scene, str, int]:
    """(scene, rung, how many draws were impossible before it) of a number: the same every time."""
    rng = np.random.default_rng([20261122, number])
    for refused in range(60):
        far = _log(rng, 0.8, 8.0)
        medium, wave = _medium(rng)
        kind = _one(rng, "gated", "gated", "waveform", "amcw")
        rig = (_gated(rng, wave, far) if kind == "gated" else _ranger(rng, wave, far, kind)) | _ambient(rng)
        target: list[dict[str, Any]] = []
        if rng.uniform() < 0.8:  # most scenes have a wall to look at
            wide = {
                "width_m": 3 * far,
                "height_m": 3 * far,
                "tilt_x_deg": _between(rng, -60, 60),
                "tilt_y_deg": _between(rng, -60, 60),
            }
            wall = {"kind": "rectangle", "center_m": [0.0, 0.0, far]} | wide
            target.append({"name": "wall", "shape": wall, "material": _material(rng)})
        for item in range(int(rng.integers(1, 4))):
            thing: dict[str, Any] = {"name": f"o{item}", "shape": _shape(rng, far, mesh), "material": _material(rng)}
            if rng.uniform() < 0.2 and thing["shape"]["kind"] in ("rectangle", "sphere", "height-grid"):
                thing["texture"] = {"file": str(texture), "encoding": "linear"}
            target.append(thing)
        data = {
            "schema_version": 1,
            "name": f"drawn-{number}",
            "title": "Drawn",
            "target": target,
            "medium": medium,
            "rig": rig,
        }
        rung = _one(rng, "direct", "scatter")
        try:
            scene = load_scene(data)
            for thing in scene.target:
                if thing.shape.kind == "mesh":
                    check_solid(scene, thing, *shape_mesh(thing.shape, "drawn"))
            return scene, rung, refused
        except InputError as error:
            told = str(error)
            # Only what is impossible together may be refused: every value by itself was drawn from what is allowed.
            assert "inside a target" in told or "behind" in told or "longer than the time" in told, told
    raise AssertionError(f"no possible scene for {number}")
