"""Phase screens of layers: one per frame, or one that flows past."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ...optics.turbulence.embedding import ScreenPlan
from ...optics.turbulence.screens import kolmogorov_plan, von_karman_plan
from ...scenes.errors import InputError

__all__ = ["MOST_FLOW", "flowing", "screen"]

Float = NDArray[np.float64]

#: Longest side of a screen [samples] that a flow may need: its plan takes 1 GB.
MOST_FLOW = 4096


def screen(side: int, step_m: float, r0_m: float, outer_m: float | None, rng: np.random.Generator) -> Float:
    """A screen [rad] (side, side) with samples `step_m` apart: Kolmogorov, or von Kármán of an outer scale [m]."""
    return _plan((side, side), step_m, r0_m, outer_m).draw(rng)


def flowing(
    side: int, step_m: float, r0_m: float, outer_m: float | None, moved_m: Float, frame: int, rng: np.random.Generator
) -> Float:
    """The part (side, side) of a screen that flows past, at moved_m[frame] (frame, axis) [m]; one draw for the whole series.

    Raises InputError for a way too long to be held.
    """
    least = moved_m.min(axis=0)
    extra = np.ceil((moved_m.max(axis=0) - least) / step_m).astype(int)
    if side + int(extra.max()) > MOST_FLOW:
        raise InputError(
            "The water flows too far during the capture for one screen.", where="rig.turbulence",
            value=f"{side + int(extra.max())} samples", allowed=f"{MOST_FLOW} or fewer",
            next_step="fewer frames, a shorter interval, a slower flow, or no velocity: each frame is then a draw of its own",
        )  # fmt: skip
    plan = _plan((side + int(extra[1]), side + int(extra[0])), step_m, r0_m, outer_m)
    # φ(x − vt): the part that is seen moves against the flow.
    at = moved_m.max(axis=0) - moved_m[frame]
    part = plan.field(plan.noise(rng), (float(at[0]), float(at[1])))[:side, :side]
    return np.asarray(part - part.mean())


@lru_cache(maxsize=8)
def _plan(shape: tuple[int, int], step_m: float, r0_m: float, outer_m: float | None) -> ScreenPlan:
    if outer_m is None:
        return kolmogorov_plan(r0_m, shape, step_m)
    return von_karman_plan(r0_m, outer_m, shape, step_m)
