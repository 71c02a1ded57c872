"""The rig as declared: all that a laboratory would know of its instrument, with pulse and gates as samples only.

Estimators see this and nothing else of the instrument, so that no closed form of the generator reaches them.
"""

from __future__ import annotations

from typing import Any, Literal, TypeVar

import numpy as np

from ...optics.correlation import waveforms
from ...optics.water import refraction
from ..base import Spec
from ..errors import InputError
from ..load import validate_spec
from ..medium import AirIndex, ExplicitIndex, Medium, WaterIndex
from ..overrides import apply_overrides
from ..sampling import gated_sample_step
from ..scene import Scene
from ..waveforms import Gate, Pulse
from .amcw import AmcwRig
from .gated import GatedRig
from .waveform import WaveformRig

__all__ = [
    "as_declared", "declared_rig", "group_index", "medium_data", "optics_gate", "optics_pulse", "phase_index", "rounded",
]  # fmt: skip

SpecT = TypeVar("SpecT", bound=Spec)


def phase_index(medium: Medium, wavelength_m: float) -> float:
    """Phase refractive index of the medium at the vacuum wavelength."""
    return _index(medium, wavelength_m, "phase")


def group_index(medium: Medium, wavelength_m: float) -> float:
    """Group refractive index of the medium at the vacuum wavelength: pulses travel at c/n_g."""
    return _index(medium, wavelength_m, "group")


def _index(medium: Medium, wavelength_m: float, which: Literal["phase", "group"]) -> float:
    index = medium.index
    try:
        if isinstance(index, ExplicitIndex):
            return index.phase if which == "phase" else index.group
        if isinstance(index, WaterIndex):
            water = refraction.water_phase_index if which == "phase" else refraction.water_group_index
            return float(water(wavelength_m, index.temperature_c, index.salinity_psu))
        assert isinstance(index, AirIndex)
        air = refraction.air_phase_index if which == "phase" else refraction.air_group_index
        return float(air(wavelength_m, index.temperature_c, index.pressure_pa))
    except ValueError as error:
        raise InputError(
            "The medium's index has no formula there.",
            where="medium.index",
            value=wavelength_m,
            allowed=str(error),
            next_step='give it as numbers: index = { kind = "explicit", phase = ..., group = ... }',
        ) from error


def optics_pulse(pulse: Pulse) -> waveforms.Pulse:
    """The pulse of `optics` that a spec describes (same name, same fields)."""
    return waveforms.pulse_from_spec(pulse)


def optics_gate(gate: Gate) -> waveforms.Gate:
    """The gate of `optics` that a spec describes (same name, same fields)."""
    return waveforms.gate_from_spec(gate)


def declared_rig(scene: Scene) -> dict[str, Any]:
    """Plain data of the instrument as declared (attribute `rig` of a capture).

    `scene.declared` is applied over rig and medium first, and validated like any spec.

    Raises:
        InputError: a declared path or value that is not allowed.
    """
    if isinstance(scene.rig, WaveformRig):
        from .declare_waveform import declared_waveform

        return declared_waveform(scene)
    if isinstance(scene.rig, AmcwRig):
        from .declare_amcw import declared_amcw

        return declared_amcw(scene)
    rig, medium = as_declared(scene, GatedRig)
    camera, laser = rig.camera, rig.laser
    step = gated_sample_step(rig, f"{scene.name}: declared")
    pulse_start, pulse_value = waveforms.sample_pulse(optics_pulse(laser.pulse), step)
    gates = [waveforms.sample_gate(optics_gate(gate), step) for gate in rig.gates]
    return {
        "schema": 1,
        "kind": rig.kind,
        "camera": camera.model_dump(mode="json")
        | {"principal_row_px": (camera.rows - 1) / 2, "principal_col_px": (camera.cols - 1) / 2},
        "laser": {
            "wavelength_m": laser.wavelength_m,
            "pulse_energy_j": laser.pulse_energy_j,
            "position_m": list(laser.position_m),
            "profile": laser.illumination.profile,
            "half_angle_rad": laser.illumination.half_angle_rad,
            "offset_rad": list(laser.illumination.offset_rad),
            "energy_fluctuation": laser.energy_fluctuation,
            "jitter_shot_s": laser.jitter_shot_s,
            "jitter_frame_s": laser.jitter_frame_s,
        },
        "pulse": {"start_s": float(pulse_start), "step_s": step, "value": rounded(pulse_value)},
        "gates": [{"start_s": float(s), "step_s": step, "value": rounded(v)} for s, v in gates],
        "gate_offset_s": None if rig.gate_map is None else rig.gate_map.model_dump(mode="json"),
        "medium": medium_data(medium, laser.wavelength_m),
        "detector": rig.detector.model_dump(mode="json", exclude={"fixed_pattern_seed"}),
        "ambient_e_per_s": rig.ambient_e_per_s,
        "pulses_per_slice": rig.pulses_per_slice,
        "t0_s": rig.t0_s,
    }


def as_declared(scene: Scene, kind: type[SpecT]) -> tuple[SpecT, Medium]:
    """Rig (a spec of class `kind`) and medium with `scene.declared` applied. Raises InputError as `declared_rig`."""
    data = scene.rig.model_dump(mode="json") | {"medium": scene.medium.model_dump(mode="json")}
    if scene.declared:
        data = apply_overrides(data, scene.declared)
    where = f"{scene.name}: declared"
    medium = validate_spec(Medium, data.pop("medium"), where)
    return validate_spec(kind, data, where), medium


def medium_data(medium: Medium, wavelength_m: float) -> dict[str, Any]:
    """The medium as declared: indices as numbers at the laser's wavelength, attenuation in 1/m."""
    return {
        "name": medium.name,
        "phase_index": phase_index(medium, wavelength_m),
        "group_index": group_index(medium, wavelength_m),
        "absorption_per_m": medium.absorption_per_m,
        "scattering_per_m": medium.scattering_per_m,
    }


def rounded(values: Any) -> list[float]:
    """Nine significant digits: far below any calibration, and half the size in JSON."""
    return [float(f"{v:.9g}") for v in np.asarray(values)]
