"""The forward model of laser-line scenes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from ...scenes.scene import Scene
from ..choice import Choice
from ..effect import Effect
from ..model import Expected, Model
from ..request import Request

if TYPE_CHECKING:
    from .expected import FrameLight

__all__ = ["MODEL"]

# Each function loads light transport, and so only when light is traced: a request is checked without it.


def _choose(scene: Scene, request: Request) -> Choice:
    from .choose import choose

    return choose(scene, request.rtol, request.seed, request.capture_key)


def _expect(scene: Scene, request: Request) -> Expected[FrameLight]:
    from .expected import expect
    from .exposure import exposed

    return exposed(scene, expect(scene, request))


def _read(scene: Scene, expected: Expected[FrameLight], request: Request) -> NDArray[Any]:
    from .expected import read

    return read(scene, expected, request)


def _effects(scene: Scene, expected: Expected[FrameLight], rung: str) -> list[Effect]:
    from .effects import catalogue

    return catalogue(scene, expected.light, rung)


MODEL: Model[FrameLight] = Model(
    "laser_line",
    rungs=("direct", "scatter", "full"),
    expect=_expect,
    read=_read,
    effects=_effects,
    choose=_choose,
    apart=("direct", "scatter"),
    wet=("scatter", "full", "auto"),
    clock="time",
)
