"""Inclinometers of a laser-line rig: two angles of the camera against gravity, with errors. No physical value has a default."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from ..base import Spec

__all__ = ["Inclinometers"]

_Angle = Annotated[float, Field(ge=-180, le=180)]
_Error = Annotated[float, Field(ge=0, le=45)]


class Inclinometers(Spec):
    """Pitch and roll of the camera, measured once per frame (the instrument of Kusters 1992 holds two in its housing).

    `pitch_deg`, `roll_deg`: attitude at time 0. Gravity is +y of the level frame, and level = Rx(pitch) Rz(roll) camera, so
    that in the camera's frame it is (sin roll cos pitch, cos roll cos pitch, −sin pitch). `sigma_deg`: Gaussian noise of each
    reading. `bias_deg`: constant errors of pitch and roll, which no estimator is told.
    """

    pitch_deg: _Angle
    roll_deg: _Angle
    sigma_deg: _Error
    bias_deg: tuple[_Angle, _Angle]
