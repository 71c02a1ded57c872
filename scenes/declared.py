"""The rig as declared: all that a laboratory would know of its instrument, with pulse and gates as samples only.

Estimators see this and nothing else of the instrument, so that no closed form of the generator reaches them.
"""

from __future__ import annotations

from typing import Any

from .rigs import rig_kind
from .scene import Scene

__all__ = ["declared_rig"]


def declared_rig(scene: Scene) -> dict[str, Any]:
    """Plain data of the instrument as declared (attribute `rig` of a capture).

    `scene.declared` is applied over rig and medium first, and validated like any spec.

    Raises:
        InputError: a declared path or value that is not allowed.
    """
    return rig_kind(scene.modality).declare(scene)
