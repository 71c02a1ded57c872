"""Two surfaces in every pixel: a screen of unresolved holes before the target.

The share f of each pixel's cone meets the screen, at z = d, with Lambert albedo ρ; the rest goes on. Laser and camera share
one axis, so that light that went out through a hole comes back through it: the target keeps 1 − f of its light, not
(1 − f)². What is nearer than the screen hides it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...scenes.errors import InputError
from ...scenes.materials import Lambert
from ...scenes.rigs.gated import gated_rig
from ...scenes.scene import Scene, TargetObject
from ...scenes.shapes import Rectangle
from ..rays.returns import Returns
from .direct import DirectScene, render_direct

__all__ = ["behind_screen"]


def behind_screen(scene: Scene, direct: DirectScene, rtol: float) -> tuple[DirectScene, DirectScene]:
    """(target, screen): the direct light of the target as the screen lets it through, and that of the screen itself.

    The truth stays the target's; the screen's light carries another range, and belongs to `truth_background`.

    Raises:
        InputError: no screen, or a laser apart from the camera, whose light would not come back through the same holes.
    """
    rig = gated_rig(scene)
    screen = rig.screen
    if screen is None or any(rig.laser.position_m):
        raise InputError(
            "A screen needs laser and camera on one axis.", where=f"{scene.name}: rig.laser.position_m",
            value=rig.laser.position_m, allowed="[0, 0, 0]",
        )  # fmt: skip
    plane = TargetObject(
        name="screen",
        shape=Rectangle(
            center_m=(0.0, 0.0, screen.distance_m), width_m=20.0 * screen.distance_m,
            height_m=20.0 * screen.distance_m, tilt_x_deg=0.0, tilt_y_deg=0.0,
        ),
        material=Lambert(albedo=screen.albedo),
    )  # fmt: skip
    alone = render_direct(scene.model_copy(update={"target": (plane,)}), rtol)
    depth = np.asarray(direct.truth["truth_depth"])
    behind = ~(depth < screen.distance_m)  # where nothing is hit the screen is seen too
    let_through = np.where(behind, 1.0 - screen.coverage, 1.0)
    target = DirectScene(
        _scaled(direct.returns, let_through.ravel()),
        direct.truth | {"truth_amplitude": direct.truth["truth_amplitude"] * let_through},
        direct.rays,
    )
    veil = np.where(behind, screen.coverage, 0.0)
    return target, replace(alone, returns=_scaled(alone.returns, veil.ravel()))


def _scaled(returns: Returns, factor: np.ndarray) -> Returns:
    """The returns of each pixel times its `factor` (pixel)."""
    return replace(returns, amplitude=returns.amplitude * np.repeat(factor, np.diff(returns.start)))
