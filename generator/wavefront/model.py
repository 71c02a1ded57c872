"""The forward model of gated Shack-Hartmann sensors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from ...scenes.scene import Scene
from ..choice import Choice
from ..effect import Effect
from ..model import Expected, Model
from ..request import Request

if TYPE_CHECKING:
    from .expected import Sensed

__all__ = ["MODEL"]

# Each function loads what it computes with only then: a request is checked without it.


def _check(scene: Scene, rung: str) -> None:
    from .possible import check_rung

    check_rung(scene, rung)


def _choose(scene: Scene, request: Request) -> Choice:
    from .choose import choose

    return choose(scene, request)


def _expect(scene: Scene, request: Request) -> Expected[Sensed]:
    from .expected import expect

    return expect(scene, request)


def _read(scene: Scene, expected: Expected[Sensed], request: Request) -> Mapping[str, NDArray[Any]]:
    from .expected import read

    return read(scene, expected, request)


def _effects(scene: Scene, expected: Expected[Sensed], rung: str) -> list[Effect]:
    from .effects import catalogue

    return catalogue(scene, expected.light, rung)


MODEL: Model[Sensed] = Model(
    "wavefront",
    rungs=("geometric", "isolated", "coherent"),
    wet=("geometric", "isolated", "coherent", "auto"),
    expect=_expect,
    read=_read,
    effects=_effects,
    choose=_choose,
    check=_check,
    clock="delay",
)
