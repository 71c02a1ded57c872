"""Parts of the wavefront rig: laser, bench, lenslets, pupil, camera, frames. No physical value has a default."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from ..base import Fraction, Spec
from ..quantities import Energy, LensLength, MomentTime, OptionalLength, OptionalTime, SmallLength
from ..waveforms import Pulse

__all__ = [
    "LENSLET_PRESETS", "ArrayCamera", "Bench", "BeamLaser", "Imager", "Lenslets", "Pupil", "Series",
]  # fmt: skip

#: Lenslet arrays of published instruments. "guo-2018": Guo et al. 2017 (section 6.3), published in 2018.
LENSLET_PRESETS: dict[str, dict[str, float]] = {"guo-2018": {"pitch_m": 150e-6, "focal_length_m": 6.7e-3}}

_Offset = Annotated[float, Field(ge=-1, le=1)]
_Site = Annotated[int, Field(ge=0, le=1023)]
#: Options of lenslets that are left out of the data where they are absent.
_OPTIONAL = ("grid", "missing_share", "missing_seed")


def _as_tuples(value: Any) -> Any:
    """Lists as tuples: what a validator hands on is no JSON any more."""
    return tuple(_as_tuples(item) for item in value) if isinstance(value, list) else value


class BeamLaser(Spec):
    """A pulsed laser behind a collimator. `jitter_frame_s`: rms delay of whole frames, drawn per frame."""

    wavelength_m: Annotated[float, Field(gt=1e-7, lt=2e-5)]
    pulse_energy_j: Energy
    pulse: Pulse
    energy_fluctuation: Fraction
    jitter_frame_s: OptionalTime


class Bench(Spec):
    """What stands between laser, water and lenslets (Guo et al. 2017, Figure 10).

    `laser_arm_m`, `camera_arm_m`: ways through air from the laser to the last beam splitter, L1, and from there to the
    lenslets, L2; an echo of range r returns after 2 n_g r/c + (L1 + L2)/c. `splitter_transmission`: of all passes of both
    splitters together. `beam_diameter_m`: of the collimated, evenly bright beam at the array, behind a collimator of
    `collimator_focal_length_m`. `magnification`: lengths on the array over lengths in the water.
    """

    laser_arm_m: OptionalLength
    camera_arm_m: OptionalLength
    splitter_transmission: Fraction
    collimator_focal_length_m: LensLength
    beam_diameter_m: LensLength
    magnification: Annotated[float, Field(ge=1e-3, le=1e3)]


class Lenslets(Spec):
    """A grid of `across` × `across` lenslets.

    `grid`: "square", also where absent, or "hexagonal": hexagons with two edges parallel to y, rows √¾ of the pitch apart, every
    second one half a pitch to the right of the middle row. `preset`: a name of `LENSLET_PRESETS` in place of pitch and
    focal length; "" is none, for a rig file over a scene that names one. `fill`: side of a lenslet's clear square, or width
    between the clear hexagon's flats, over the pitch.
    `rotation_deg`: from x toward y, about the array's centre; `offset_m`: (x, y) of the array's centre from the camera's axis.
    `missing`: (row, col) of lenslets that let no light through. `missing_share`: of all lenslets, which by the draw
    `missing_seed` (0 if absent) let none through either; those of a smaller share are among those of a larger one.
    """

    preset: str | None = None
    across: Annotated[int, Field(ge=1, le=128)]
    pitch_m: SmallLength
    focal_length_m: LensLength
    fill: Annotated[float, Field(ge=0.1, le=1)]
    transmission: Fraction
    rotation_deg: Annotated[float, Field(ge=-180, le=180)]
    offset_m: tuple[_Offset, _Offset]
    missing: tuple[tuple[_Site, _Site], ...] = ()
    grid: Literal["square", "hexagonal"] | None = None
    missing_share: Annotated[float, Field(ge=0, lt=1)] | None = None
    missing_seed: Annotated[int, Field(ge=0, lt=2**32)] | None = None

    @property
    def hexagonal(self) -> bool:
        """Whether the lenslets are hexagons."""
        return self.grid == "hexagonal"

    def lit(self) -> NDArray[np.bool_]:
        """Which lenslets (row, col) let light through."""
        light = np.ones((self.across, self.across), bool)
        for down, along in self.missing:
            if down < self.across and along < self.across:
                light[down, along] = False
        if self.missing_share:
            order = np.random.default_rng(self.missing_seed or 0).permutation(light.size)
            light.ravel()[order[: round(self.missing_share * light.size)]] = False
        return light

    @model_serializer(mode="wrap")
    def _without_absent_options(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        data: dict[str, Any] = handler(self)
        return {name: value for name, value in data.items() if value is not None or name not in _OPTIONAL}

    @model_validator(mode="before")
    @classmethod
    def _take_the_preset(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            return data
        if data.get("preset") in (None, ""):
            return {name: _as_tuples(value) for name, value in (data | {"preset": None}).items()}
        held = LENSLET_PRESETS.get(str(data["preset"]))
        if held is None:
            raise ValueError(f"preset should be one of {', '.join(LENSLET_PRESETS)}")
        both = sorted(name for name in held if name in data and data[name] != held[name])
        if both:
            raise ValueError(
                f"the preset {data['preset']} holds {', '.join(both)} already: leave it out, or the preset"
            )
        return {name: _as_tuples(value) for name, value in {**data, **held}.items()}


class Pupil(Spec):
    """Where the wavefront is measured: a disc or square of `diameter_m` at the array's centre.

    A lenslet is used where at least `least_fill` of its square lies in the pupil. `samples`: samples across a lenslet of the
    grid on which the field, and phases, are given. `modes`: greatest Noll index of the Zernike coefficients of the truth.
    """

    shape: Literal["disc", "square"]
    diameter_m: LensLength
    least_fill: Annotated[float, Field(ge=0.01, le=1)]
    samples: Annotated[int, Field(ge=2, le=64)]
    modes: Annotated[int, Field(ge=3, le=300)]


class ArrayCamera(Spec):
    """The pixels behind the lenslets, at their focal length."""

    rows: Annotated[int, Field(ge=4, le=16384)]
    cols: Annotated[int, Field(ge=4, le=16384)]
    pixel_pitch_m: SmallLength
    quantum_efficiency: Fraction


class Series(Spec):
    """`count` frames, one every `interval_s` from time 0; the gate of frame k opens at start_s + step_s·k.

    `gates`: number of gates that take turns, so that it opens at start_s + step_s·(k mod gates); absent: as many as frames.
    `pulses`: laser pulses of a frame. `reference_exposures`: exposures of the reference, the mean of spot fields of a flat
    wavefront.
    """

    start_s: MomentTime
    step_s: MomentTime
    count: Annotated[int, Field(ge=1, le=65536)]
    interval_s: Annotated[float, Field(ge=1e-9, le=1e6)]
    pulses: Annotated[int, Field(ge=1, le=10**9)]
    reference_exposures: Annotated[int, Field(ge=1, le=10**4)]
    gates: Annotated[int, Field(ge=1, le=65536)] | None = None

    @model_serializer(mode="wrap")
    def _without_absent_gates(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        data: dict[str, Any] = handler(self)
        if data.get("gates") is None:
            data.pop("gates", None)
        return data

    def delays_s(self) -> NDArray[np.float64]:
        """When the gate of each frame opens [s], without the declared zero of time."""
        number = np.arange(self.count)
        return np.asarray(self.start_s + self.step_s * (number % self.gates if self.gates else number))


class Imager(Spec):
    """A camera of `side` × `side` pixels that sees a chart through the same pupil and phase as the lenslets.

    The chart lies on a black ground and is so far from the turbulence that all of it is blurred alike; a pixel covers λ/2D, D the
    side of the pupil's grid. A white pixel gives `photoelectrons`; the rms read noise is `read_noise_e`.
    """

    side: Annotated[int, Field(ge=16, le=512)]
    photoelectrons: Annotated[float, Field(ge=1, le=1e9)]
    read_noise_e: Annotated[float, Field(ge=0, le=1e6)]
