"""The choice of the rung by the predicted error of spots."""

from __future__ import annotations

from ...scenes.errors import InputError
from ...scenes.scene import Scene
from ..choice import Choice
from ..request import Request

__all__ = ["choose"]


def choose(scene: Scene, request: Request) -> Choice:
    """Raises InputError: no prediction of a rung's error is built."""
    raise InputError(
        "No rung of this modality is chosen by itself.", where=f"{scene.name}: fidelity", value="auto",
        allowed='"geometric", "isolated", "coherent"',
    )  # fmt: skip
