"""The forward model of waveform scenes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ...scenes.scene import Scene
from ..choice import Choice
from ..effect import Effect
from ..model import Expected, Model
from ..request import Request

if TYPE_CHECKING:
    from .footprint import Footprint

__all__ = ["MODEL"]

# Each function loads light transport, and so only when light is traced: a request is checked without it.


def _choose(scene: Scene, request: Request) -> Choice:
    from .choose import choose_ranger
    from .waveform_sizes import waveform_instrument

    return choose_ranger(scene, request.rtol, waveform_instrument(scene))


def _expect(scene: Scene, request: Request) -> Expected[Footprint]:
    from .waveform_signal import expect

    return expect(scene, request)


def _read(scene: Scene, expected: Expected[Footprint], request: Request) -> NDArray[np.uint16]:
    from .waveform_signal import read

    return read(scene, expected, request)


def _effects(scene: Scene, expected: Expected[Footprint], rung: str) -> list[Effect]:
    from .waveform_effects import waveform_effects

    return waveform_effects(scene, expected, rung)


MODEL: Model[Footprint] = Model(
    "waveform",
    rungs=("direct", "scatter"),
    expect=_expect,
    read=_read,
    effects=_effects,
    choose=_choose,
    clock="time",
    wet=("scatter", "auto"),
)
