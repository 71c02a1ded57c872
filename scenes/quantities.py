"""Bounded quantities of rigs: wide enough for any instrument that could be built, narrow enough that no computation leaves
the numbers that a computer holds.

| quantity | from … to | why |
|---|---|---|
| `PulseTime`, `OptionalTime` | 1 fs (or 0) … 1 ms | from the shortest laser pulses to a flash lamp's |
| `OpenTime`, `StepTime` | 1 fs … 1 s | gates and steps; light travels 3·10⁸ m in a second |
| `MomentTime` | ±1 s | delays and zeros of time |
| `LongTime` | 1 fs … 10⁶ s | exposures |
| `SmallLength` | 1 nm … 1 m | pixels and photodetectors |
| `LensLength` | 1 µm … 10 km | focal lengths and apertures |
| `Distance` | 1 µm … 10⁹ m | from the lens to what it sees |
| `FNumber` | 0.1 … 10⁶ | ½ is the least in air; a pinhole's is thousands |
| `Energy`, `Power` | 10⁻³⁰ … 10⁶ J, 10⁻³⁰ … 10⁹ W | far below one photon, to the largest lasers |
| `Gain` | 10⁻¹² … 10⁹ | of detectors, tubes and converters |
| `Electrons`, `Rate` | 0 … 10¹², 0 … 10²⁴ 1/s | noise, dark and ambient light |
| `Frequency` | 1 mHz … 10¹⁵ Hz | modulation and counters |
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from ..optics.constants import C_M_PER_S

__all__ = [
    "Counts", "Distance", "Electrons", "Energy", "ExcessNoise", "FNumber", "Frequency", "Gain", "LensLength", "LongTime",
    "MomentTime", "OffsetAngle", "OpenTime", "OptionalLength", "OptionalTime", "Place", "Power", "PulseTime", "Rate",
    "SmallLength", "StepTime", "Velocity", "Weight", "Well",
]  # fmt: skip

PulseTime = Annotated[float, Field(ge=1e-15, le=1e-3)]
OptionalTime = Annotated[float, Field(ge=0, le=1e-3)]
OpenTime = Annotated[float, Field(ge=1e-15, le=1)]
StepTime = Annotated[float, Field(ge=1e-15, le=1)]
MomentTime = Annotated[float, Field(ge=-1, le=1)]
LongTime = Annotated[float, Field(ge=1e-15, le=1e6)]

SmallLength = Annotated[float, Field(ge=1e-9, le=1)]
LensLength = Annotated[float, Field(ge=1e-6, le=1e4)]
OptionalLength = Annotated[float, Field(ge=0, le=1e4)]
Distance = Annotated[float, Field(ge=1e-6, le=1e9)]
FNumber = Annotated[float, Field(ge=0.1, le=1e6)]

Energy = Annotated[float, Field(ge=1e-30, le=1e6)]
Power = Annotated[float, Field(ge=1e-30, le=1e9)]
Frequency = Annotated[float, Field(ge=1e-3, le=1e15)]

Gain = Annotated[float, Field(ge=1e-12, le=1e9)]
#: Excess noise factor F² of an amplification; 1 adds none.
ExcessNoise = Annotated[float, Field(ge=1, le=1e6)]
Electrons = Annotated[float, Field(ge=0, le=1e12)]
Rate = Annotated[float, Field(ge=0, le=1e24)]
Well = Annotated[float, Field(ge=1e-6, le=1e12)]
#: Digital numbers: an offset above the converter's top shows nothing but its top.
Counts = Annotated[float, Field(ge=0, le=1e6)]
#: A relative value of a measured profile.
Weight = Annotated[float, Field(ge=0, le=1e30)]

OffsetAngle = Annotated[float, Field(ge=-1.5, le=1.5)]
_Coordinate = Annotated[float, Field(ge=-1e6, le=1e6)]
#: x, y, z in metres, camera frame: x right, y down, z forward; up to 1000 km.
Place = tuple[_Coordinate, _Coordinate, _Coordinate]
_Speed = Annotated[float, Field(ge=-C_M_PER_S, le=C_M_PER_S)]
#: x, y, z in m/s, below the speed of light.
Velocity = tuple[_Speed, _Speed, _Speed]
