"""The forward model of gated scenes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ...scenes.errors import InputError
from ...scenes.rigs.gated import gated_rig
from ...scenes.scene import Scene
from ..choice import Choice
from ..effect import Effect
from ..model import Expected, Model
from ..request import Request

if TYPE_CHECKING:
    from .direct import DirectScene

__all__ = ["MODEL"]


def _check(scene: Scene, rung: str) -> None:
    """A moving rig and a screen before the target are modelled by the direct rung, one at a time."""
    rig = gated_rig(scene)
    given = [name for name in ("motion_m_per_s", "screen") if getattr(rig, name) is not None]
    if given and rung not in ("direct", "auto"):
        raise InputError(
            "This is modelled by the direct rung only.", where=f"{scene.name}: rig.{given[0]}", value=rung,
            allowed='fidelity="direct"',
        )  # fmt: skip
    if len(given) > 1:
        raise InputError("A rig moves or has a screen, not both.", where=f"{scene.name}: rig", value=given)


# What follows loads light transport, and so only when light is traced: a request is checked without it.


def _choose(scene: Scene, request: Request) -> Choice:
    from .choose import choose

    return choose(scene, request.rtol, request.seed, request.capture_key)


def _expect(scene: Scene, request: Request) -> Expected[DirectScene]:
    from .expected import expect

    return expect(scene, request)


def _read(scene: Scene, expected: Expected[DirectScene], request: Request) -> NDArray[np.uint16]:
    from ..detector import detect, fixed_pattern

    rig = gated_rig(scene)
    pattern = fixed_pattern(rig.detector, rig.camera.rows, rig.camera.cols)
    return detect(expected.electrons, rig.detector, pattern, request.seed, request.capture_key)


def _effects(scene: Scene, expected: Expected[DirectScene], rung: str) -> list[Effect]:
    from .effects import catalogue

    return catalogue(scene, expected.light, rung)


MODEL: Model[DirectScene] = Model(
    "gated",
    rungs=("direct", "scatter", "full"),
    expect=_expect,
    read=_read,
    effects=_effects,
    choose=_choose,
    check=_check,
    apart=("direct", "scatter", "full"),
    wet=("scatter", "full"),
    instances=True,
    clock="delay",
)
