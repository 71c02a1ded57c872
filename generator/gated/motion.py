"""Platform motion between slices: each slice sees the target from where the rig is then.

With velocity v the rig is at v (t_k − t̄) when slice k is taken, t̄ the middle of the capture's time: in the rig's frame the
target lies at −v (t_k − t̄). Every slice is traced anew, so parallax, hiding and 1/r⁴ are all there. Within a slice the
rig stands still: the exposure's own blur is v·T_exposure, one part in the number of slices of the whole displacement.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ...optics.correlation.response import Table
from ...scenes.errors import InputError
from ...scenes.rigs.gated import gated_rig
from ...scenes.scene import Scene
from ..rays.returns import render_stack
from .direct import render_direct

__all__ = ["moved", "moving_stack"]


def moved(scene: Scene, seconds: float) -> Scene:
    """The scene as the rig sees it `seconds` after the middle of the capture's time."""
    velocity = gated_rig(scene).motion_m_per_s or (0.0, 0.0, 0.0)
    target = []
    for item in scene.target:
        center = tuple(c - v * seconds for c, v in zip(item.shape.center_m, velocity, strict=True))
        target.append(item.model_copy(update={"shape": item.shape.model_copy(update={"center_m": center})}))
    return scene.model_copy(update={"target": tuple(target)})


def moving_stack(
    scene: Scene, time_s: NDArray[np.float64], gate: NDArray[np.int32], tables: Sequence[Table],
    delay_s: NDArray[np.float64], scale: NDArray[np.float64], offset_s: NDArray[np.float64] | None, rtol: float,
    out: NDArray[np.float32],
) -> None:  # fmt: skip
    """Write the direct light of a moving rig into `out` (slice, pixel).

    Main arguments:
        time_s, gate, delay_s, scale: per slice: when it is taken, its gate, true optical delay and relative energy.
        tables: R of each gate. offset_s: the gate's later opening per pixel. rtol: of the sub-pixel sampling.

    Raises:
        InputError: the rig moves so far that a target lies behind it.
    """
    middle = 0.5 * (float(time_s.min()) + float(time_s.max()))
    for k, time in enumerate(time_s):
        if scale[k] == 0.0:
            out[k] = 0.0
            continue
        now = moved(scene, float(time) - middle)
        if any(item.shape.center_m[2] <= 0.0 for item in now.target):
            raise InputError(
                "The rig moves past its target.", where=f"{scene.name}: rig.motion_m_per_s",
                value=gated_rig(scene).motion_m_per_s, allowed="less than the target's distance in the capture's time",
            )  # fmt: skip
        returns = render_direct(now, rtol, with_truth=False).returns
        one = slice(k, k + 1)
        render_stack(returns, tables[int(gate[k])], delay_s[one], scale[one], offset_s, out[one])
