"""The forward model of amplitude-modulated scenes."""

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
    from .amcw_sizes import amcw_instrument
    from .choose import choose_ranger

    return choose_ranger(scene, request.rtol, amcw_instrument(scene))


def _expect(scene: Scene, request: Request) -> Expected[Footprint]:
    from .amcw_samples import expect

    return expect(scene, request)


def _read(scene: Scene, expected: Expected[Footprint], request: Request) -> NDArray[np.uint16]:
    from .amcw_samples import read

    return read(scene, expected, request)


def _effects(scene: Scene, expected: Expected[Footprint], rung: str) -> list[Effect]:
    from .amcw_effects import amcw_effects

    return amcw_effects(scene, expected, rung)


MODEL: Model[Footprint] = Model(
    "amcw",
    rungs=("direct", "scatter"),
    expect=_expect,
    read=_read,
    effects=_effects,
    choose=_choose,
    wet=("scatter", "auto"),
)
