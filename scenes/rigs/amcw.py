"""The amplitude-modulated rig (Kusters 1992, Figure 2.3): a modulated laser, one detector, samples of the correlation
with the reference at several phases and frequencies. No physical value has a default.

Laser and receiver are coaxial, at the camera frame's origin, and look along z; a scan turns both.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from ..ambient import AmbientSpectrum, ambient_rate, without_computed
from ..base import Fraction, Spec, Vec3
from ..errors import InputError
from ..medium_index import medium_data
from ..quantities import (
    Counts,
    Distance,
    Electrons,
    Frequency,
    Gain,
    LongTime,
    MomentTime,
    Power,
    Rate,
    SmallLength,
    Well,
)
from .declaring import as_declared
from .kind import RigKind, RigScene, RigSpec, RigView, rig_of
from .parts import Illumination, Receiver, collected_m2_sr, illumination_data

__all__ = ["KIND", "AmcwDetector", "AmcwRig", "ModulatedLaser", "Modulation", "amcw_rig"]


class ModulatedLaser(Spec):
    """A laser of mean `power_w` whose power goes as 1 + m cos(2πft), m = `modulation_depth`; no harmonics.

    `power_fluctuation`: relative rms of the mean power, drawn per shot.
    """

    wavelength_m: Annotated[float, Field(gt=1e-7, lt=2e-5)]
    power_w: Power
    modulation_depth: Annotated[float, Field(gt=0, le=1)]
    illumination: Illumination
    power_fluctuation: Fraction


class AmcwDetector(Spec):
    """A demodulating detector: its transmission goes as ½(1 + d cos(2πft − φ)), d = `demodulation_contrast`; then
    Gaussian `read_noise_e` per sample, gain, offset, rounding, clipped at `full_well_e` and 2^bits − 1."""

    active_diameter_m: SmallLength
    quantum_efficiency: Fraction
    demodulation_contrast: Annotated[float, Field(gt=0, le=1)]
    dark_e_per_s: Rate
    read_noise_e: Electrons
    gain_dn_per_e: Gain
    offset_dn: Counts
    full_well_e: Well
    adc_bits: Annotated[int, Field(ge=1, le=16)]


class Modulation(Spec):
    """Modulation frequencies, each sampled at `phase_steps` reference phases 2πk/steps for `integration_s` a sample."""

    frequencies_hz: Annotated[tuple[Frequency, ...], Field(min_length=1, max_length=64)]
    phase_steps: Annotated[int, Field(ge=3, le=64)]
    integration_s: LongTime

    @model_validator(mode="after")
    def _frequencies_differ(self) -> Modulation:
        if len(set(self.frequencies_hz)) != len(self.frequencies_hz):
            raise ValueError("modulation frequencies must differ")
        return self


class AmcwRig(RigSpec):
    """An amplitude-modulated ranger. `range_window_m`: where targets may be, as the user of the instrument knows it;
    ambiguities are resolved within it. `scan_half_angle_rad`: shots at even angles from −a to +a in the x-z plane."""

    kind: Literal["amcw"] = "amcw"
    laser: ModulatedLaser
    receiver: Receiver
    detector: AmcwDetector
    modulation: Modulation
    shots: Annotated[int, Field(ge=1, le=65536)]
    scan_half_angle_rad: Annotated[float, Field(ge=0, lt=1.5)]
    range_window_m: tuple[Annotated[float, Field(ge=0, le=1e9)], Distance]
    ambient_e_per_s: Rate = 0.0
    ambient: AmbientSpectrum | None = None
    t0_s: MomentTime

    @model_validator(mode="after")
    def _window_opens(self) -> AmcwRig:
        if self.range_window_m[1] <= self.range_window_m[0]:
            raise ValueError("range_window_m needs its end beyond its start")
        return self

    @model_serializer(mode="wrap")
    def _without_absent_options(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return without_computed(handler(self))

    @model_validator(mode="after")
    def _ambient_is_given_once(self) -> AmcwRig:
        collected = collected_m2_sr(self.receiver, self.detector.active_diameter_m)
        self.__dict__["ambient_e_per_s"] = ambient_rate(self, collected, self.detector.quantum_efficiency)
        return self

    @property
    def wavelength_m(self) -> float:
        """Vacuum wavelength of the laser, m."""
        return self.laser.wavelength_m


def amcw_rig(scene: RigScene) -> AmcwRig:
    """The scene's rig, which must be an AMCW rig. Raises InputError for a scene of another modality."""
    return rig_of(scene, AmcwRig)


def _declare(scene: RigScene) -> dict[str, Any]:
    """Plain data of an AMCW rig as declared (attribute `rig` of a capture). Raises InputError as `declared_rig`."""
    rig, medium = as_declared(scene, AmcwRig)
    laser = rig.laser
    return {
        "schema": 1,
        "kind": rig.kind,
        "laser": {
            "wavelength_m": laser.wavelength_m,
            "power_w": laser.power_w,
            "modulation_depth": laser.modulation_depth,
            **illumination_data(laser.illumination),
            "power_fluctuation": laser.power_fluctuation,
        },
        "receiver": rig.receiver.model_dump(mode="json"),
        "modulation": rig.modulation.model_dump(mode="json"),
        "medium": medium_data(medium, laser.wavelength_m),
        "detector": rig.detector.model_dump(mode="json"),
        "shots": rig.shots,
        "scan_half_angle_rad": rig.scan_half_angle_rad,
        "range_window_m": list(rig.range_window_m),
        "ambient_e_per_s": rig.ambient_e_per_s,
        "t0_s": rig.t0_s,
    }


def _check(scene: RigScene) -> None:
    """Refuse samples that are integrated for less than a period of the modulation."""
    modulation = amcw_rig(scene).modulation
    slowest = min(modulation.frequencies_hz)
    if slowest * modulation.integration_s < 1.0:
        raise InputError(
            "A sample is integrated for less than one period of the modulation.",
            where=f"{scene.name}: rig.modulation.integration_s",
            value=modulation.integration_s,
            allowed=f"at least {1.0 / slowest:g} s, a period of {slowest:g} Hz",
        )


def _sizes(rig: AmcwRig) -> tuple[int, int, int]:
    return len(rig.modulation.frequencies_hz) * rig.modulation.phase_steps, 1, rig.shots


def _places(rig: AmcwRig) -> dict[str, Vec3]:
    return {"camera": (0.0, 0.0, 0.0)}


def _view(rig: AmcwRig) -> RigView:
    return RigView(None, rig.laser.illumination, rig.shots, rig.scan_half_angle_rad)


def _resize(side: int) -> dict[str, Any]:
    return {"rig.shots": side * side}


KIND = RigKind(
    "amcw",
    AmcwRig,
    declare=_declare,
    check=_check,
    sizes=_sizes,
    places=_places,
    view=_view,
    resize=_resize,
    roles={
        "ambient": "rig.ambient_e_per_s",
        "fluctuation": "rig.laser.power_fluctuation",
        "gain": "rig.detector.gain_dn_per_e",
        "light": "rig.laser.power_w",
        "read-noise": "rig.detector.read_noise_e",
    },
)
