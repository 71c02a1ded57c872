"""Targets made larger about the camera: all ranges longer by the same share, and the image as it was."""

from __future__ import annotations

import math
from typing import Any

from .errors import InputError
from .load import load_scene
from .scene import Scene

__all__ = ["grown_scene"]


def grown_scene(scene: Scene, share: float) -> Scene:
    """The scene with every point x of its targets at (1 + share) x, camera frame; rig and medium stay.

    Raises InputError for a share that is not above −1.
    """
    if not (math.isfinite(share) and share > -1.0):
        raise InputError("Targets cannot be so much smaller.", where="share", value=share, allowed="above -1, finite")
    changes: dict[str, Any] = {}
    for number, item in enumerate(scene.target):
        for name, value in item.shape.model_dump(mode="json").items():
            if name.endswith("_m"):  # lengths and places
                several = isinstance(value, list)
                larger = [(1.0 + share) * one for one in value] if several else (1.0 + share) * value
                changes[f"target.{number}.shape.{name}"] = larger
    return load_scene(scene, changes)
