"""Automatic exposure and gain of a laser-line camera. No physical value has a default."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from ..base import Fraction, Spec
from ..errors import InputError
from .parts import Detector

__all__ = ["AutoExposure", "check_exposure"]

_Seconds = Annotated[float, Field(gt=0, le=1e3)]
_Factor = Annotated[float, Field(gt=0, le=1e4)]


class AutoExposure(Spec):
    """Exposure and gain that follow the brightest pixel (Kusters 1992, sec. 3.4: "automatic gain and iris controls").

    Each frame with the laser sets those of the next one, so that its brightest pixel comes to `target_dn`: the product of exposure
    and gain is multiplied by the ratio of signals to the power `speed` (1: in one step; a clipped pixel tells only that it is
    too bright). Exposure takes what `exposure_s` (least, most) allows, gain the rest, within `gain` (least, most), a factor of
    the detector's `gain_dn_per_e`. An iris that opens counts as a longer exposure: depth of field is not modelled.

    The first frame is taken with the detector's own exposure and a gain of 1 (`start` "detector"), or with what the control
    comes to before a target that stands still ("settled"). Frames without laser keep the last setting.
    """

    target_dn: Annotated[float, Field(gt=0, le=65535)]
    exposure_s: tuple[_Seconds, _Seconds]
    gain: tuple[_Factor, _Factor]
    speed: Annotated[Fraction, Field(gt=0)]
    start: Literal["detector", "settled"]

    @model_validator(mode="after")
    def _ends_ascend(self) -> AutoExposure:
        for name in ("exposure_s", "gain"):
            least, most = getattr(self, name)
            if least > most:
                raise ValueError(f"{name} gives the least value first")
        return self


def check_exposure(auto: AutoExposure | None, detector: Detector, where: str) -> None:
    """Refuse a level that the converter does not have. Raises InputError."""
    top = 2**detector.adc_bits - 1
    if auto is not None and not detector.offset_dn < auto.target_dn < top:
        raise InputError(
            "Automatic exposure aims at a level that the converter does not have.", where=f"{where}: rig.auto_exposure.target_dn",
            value=auto.target_dn, allowed=f"above the offset, {detector.offset_dn:g}, and below the top, {top}",
            next_step="change target_dn",
        )  # fmt: skip
