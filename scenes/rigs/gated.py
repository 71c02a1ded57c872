"""The gated rig: camera, laser, gates, delays and detector. No physical value has a default."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from ...optics.correlation import waveforms
from ..ambient import AmbientSpectrum, ambient_rate, without_computed
from ..base import Fraction, Spec, Vec3
from ..errors import InputError
from ..medium_index import medium_data
from ..quantities import (
    Distance,
    Energy,
    MomentTime,
    OptionalLength,
    OptionalTime,
    Place,
    Rate,
    Velocity,
)
from ..sampling import MOST_SAMPLES, optics_gate, optics_pulse, rounded, sample_step_s
from ..waveforms import Gate, Pulse
from .declaring import as_declared
from .delays import Delays, ListedDelays, SliceDelays
from .kind import RigKind, RigScene, RigSpec, RigView, rig_of
from .parts import Camera, Detector, Illumination, pixel_collected_m2_sr
from .roles import Steps

__all__ = ["KIND", "Delays", "GateMap", "GatedRig", "Laser", "ListedDelays", "Screen", "gated_rig"]

#: Samples per characteristic width of the pulse or gate edge in the declared rig.
_SAMPLES_PER_WIDTH = 48
_PS = 1e-12


class Laser(Spec):
    """A pulsed laser. `jitter_shot_s` is the rms delay of single *pulses*: it broadens the response, and the mean of the M
    pulses of a slice scatters by 1/√M of it (a rig that records waveforms calls this `jitter_pulse_s`; its `jitter_shot_s` is
    that of records). `jitter_frame_s` is that of whole slices. Both are drawn per slice.

    `source_radius_m` (0: a point): radius of an evenly bright disc across the beam, of which every point sends out the same
    profile; the `full` rung models it.
    """

    wavelength_m: Annotated[float, Field(gt=1e-7, lt=2e-5)]
    pulse_energy_j: Energy
    pulse: Pulse
    illumination: Illumination
    position_m: Place
    energy_fluctuation: Fraction
    jitter_shot_s: OptionalTime
    jitter_frame_s: OptionalTime
    source_radius_m: OptionalLength = 0.0

    @model_serializer(mode="wrap")
    def _without_absent_source(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        data: dict[str, Any] = handler(self)
        if data.get("source_radius_m") == 0.0:
            data.pop("source_radius_m", None)
        return data


class GateMap(Spec):
    """Per-pixel gate timing of an intensifier: opening later by `iris_s`·ρ² (ρ: radius/corner radius) plus a skew
    of `skew_s` per half width along (x, y)."""

    iris_s: MomentTime
    skew_s: tuple[MomentTime, MomentTime]


class Screen(Spec):
    """A second surface in every pixel: a plane across the view at z = `distance_m` with holes too small to be resolved (a
    net, bubbles, a dirty port). The share `coverage` of each pixel sees Lambert matter of `albedo`, the rest sees past it."""

    distance_m: Distance
    coverage: Annotated[float, Field(ge=0, lt=1)]
    albedo: Fraction


#: Absent options are left out of the data, so that rigs without them keep their data and hash.
_OPTIONAL = ("motion_m_per_s", "screen")


class GatedRig(RigSpec):
    """A range-gated camera with its pulsed laser.

    `motion_m_per_s`: the platform's velocity; the scene is as written at the middle of the capture's time, and each slice
    is taken at once. `screen`: unresolved matter before the target, which the declared rig does not hold. Ambient light is
    given as `ambient_e_per_s` (photoelectrons per pixel and second of open gate), or by its spectrum, `ambient`.
    """

    kind: Literal["gated"] = "gated"
    camera: Camera
    laser: Laser
    gates: Annotated[tuple[Gate, ...], Field(min_length=1)]
    gate_map: GateMap | None = None
    delays: SliceDelays
    pulses_per_slice: Annotated[int, Field(ge=1, le=10**12)]
    detector: Detector
    ambient_e_per_s: Rate = 0.0
    ambient: AmbientSpectrum | None = None
    t0_s: MomentTime
    motion_m_per_s: Velocity | None = None
    screen: Screen | None = None

    @model_serializer(mode="wrap")
    def _without_absent_options(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return without_computed(handler(self), _OPTIONAL)

    @model_validator(mode="after")
    def _ambient_is_given_once(self) -> GatedRig:
        collected = pixel_collected_m2_sr(self.camera)
        self.__dict__["ambient_e_per_s"] = ambient_rate(self, collected, self.camera.quantum_efficiency)
        return self

    @property
    def wavelength_m(self) -> float:
        """Vacuum wavelength of the laser, m."""
        return self.laser.wavelength_m


def gated_rig(scene: RigScene) -> GatedRig:
    """The scene's rig, which must be gated. Raises InputError for a scene of another modality."""
    return rig_of(scene, GatedRig)


def _declare(scene: RigScene) -> dict[str, Any]:
    rig, medium = as_declared(scene, GatedRig)
    camera, laser = rig.camera, rig.laser
    step = _sample_step(rig, f"{scene.name}: declared")
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


def _check(scene: RigScene) -> None:
    """Refuse gates that are open for too long, and pulses and gates that no declared rig can hold as samples."""
    rig = gated_rig(scene)
    _check_gates(scene, rig)
    _check_period(scene, rig)
    _sample_step(rig, scene.name)


def _check_gates(scene: RigScene, rig: GatedRig) -> None:
    period = rig.detector.exposure_s / rig.pulses_per_slice
    for number, gate in enumerate(rig.gates):
        low, high = waveforms.gate_support(waveforms.gate_from_spec(gate))
        area = waveforms.gate_area(waveforms.gate_from_spec(gate))
        if area > period:
            raise InputError(
                "A gate is open for longer than the time between two pulses.",
                where=f"{scene.name}: rig.gates.{number}",
                value=f"open for {area:.4g} s ({high - low:.4g} s with its tails)",
                allowed=f"below exposure_s/pulses_per_slice = {period:.4g} s",
                next_step="shorten the gate, or lower rig.pulses_per_slice, or raise rig.detector.exposure_s",
            )


def _check_period(scene: RigScene, rig: GatedRig) -> None:
    """Refuse delays beyond the next pulse: the gate would see the echo of a later pulse too, and none is modelled."""
    period = rig.detector.exposure_s / rig.pulses_per_slice
    latest = rig.delays.latest_s
    if latest >= period:
        raise InputError(
            "A gate opens after the next pulse has left: it sees the echoes of several pulses (range ambiguity), and one is "
            "modelled.",
            where=f"{scene.name}: rig.pulses_per_slice",
            value=f"delays up to {latest:.4g} s, pulses {period:.4g} s apart",
            allowed=f"delays below exposure_s/pulses_per_slice = {period:.4g} s",
            next_step="lower rig.pulses_per_slice, or raise rig.detector.exposure_s",
        )


def _sample_step(rig: GatedRig, where: str) -> float:
    """One even step [s] for pulse and gates as declared: fine against the pulse and against every gate's width.

    Raises:
        InputError: a pulse too short for steps of 1 ps, or one so short against pulse or gate that over 2²⁰ samples of
            these would be needed. `where`: of the scene, for the message.
    """
    pulse = waveforms.pulse_from_spec(rig.laser.pulse)
    gates = [waveforms.gate_from_spec(gate) for gate in rig.gates]
    spans = [_span(*waveforms.pulse_support(pulse)), *(_span(*waveforms.gate_support(gate)) for gate in gates)]
    widths = [2.0 * float(np.sqrt(waveforms.pulse_variance(pulse))), *(span / 2 for span in spans[1:])]
    # A gate far longer than the pulse does not coarsen it.
    step = sample_step_s(min(widths) / _SAMPLES_PER_WIDTH, pulse, max(spans), _PS)
    names = ["rig.laser.pulse", *(f"rig.gates.{number}" for number in range(len(gates)))]
    for name, span in zip(names, spans, strict=True):
        if not step < 0.5 * span:
            raise InputError(
                "The pulse or a gate is too short to be declared as samples at least 1 ps apart.",
                where=f"{where}: {name}",
                value=f"{span:.3g} s long with its tails",
                allowed=f"longer than {2 * step:.3g} s",
                next_step="lengthen it: a response is as long as the longer of pulse and gate",
            )
        if span > step * MOST_SAMPLES:
            raise InputError(
                "The pulse or a gate takes too many samples to be declared at the common step.",
                where=f"{where}: {name}",
                value=f"{span:.3g} s long with its tails, in steps of {step:.3g} s",
                allowed=f"at most {MOST_SAMPLES} samples: here {MOST_SAMPLES * step:.3g} s",
                next_step="shorten it, or lengthen the shortest of the pulse and the gates, which sets the step",
            )
    return step


def _span(low: float, high: float) -> float:
    return float(high - low)


def _sizes(rig: GatedRig) -> tuple[int, int, int]:
    slices = len(rig.gates) * rig.delays.count * rig.delays.repeats + rig.delays.laser_off
    return slices, rig.camera.rows, rig.camera.cols


def _places(rig: GatedRig) -> dict[str, Vec3]:
    return {"camera": (0.0, 0.0, 0.0), "laser": rig.laser.position_m}


def _view(rig: GatedRig) -> RigView:
    return RigView(rig.camera, rig.laser.illumination)


def _resize(side: int) -> dict[str, Any]:
    return {"rig.camera.rows": side, "rig.camera.cols": side}


KIND = RigKind(
    "gated",
    GatedRig,
    declare=_declare,
    check=_check,
    sizes=_sizes,
    places=_places,
    view=_view,
    resize=_resize,
    whole=("rig.gate_map",),
    roles={
        "ambient": "rig.ambient_e_per_s",
        "fluctuation": "rig.laser.energy_fluctuation",
        "full-well": "rig.detector.full_well_e",
        "gain": "rig.detector.gain_dn_per_e",
        "gates": "rig.gates",
        "jitter": "rig.laser.jitter_frame_s",
        "light": "rig.laser.pulse_energy_j",
        "motion": "rig.motion_m_per_s",
        "phosphor": "rig.detector.intensifier.phosphor_sigma_px",
        "pulse": "rig.laser.pulse",
        "pulse-width": "rig.laser.pulse.fwhm_s",
        "read-noise": "rig.detector.read_noise_e",
        "sampling": Steps("rig.delays.step_s", "rig.delays.count", least=1),
        "screen": "rig.screen",
        "shot-jitter": "rig.laser.jitter_shot_s",
        "start": "rig.delays.start_s",
    },
)
