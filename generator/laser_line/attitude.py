"""Readings of the inclinometers: the attitude of every frame, with noise and bias."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...optics.gravity import attitude, level_matrix
from ...scenes.rigs.laser_line import LaserLineRig
from ..random import Stage, generator
from .setting import Pose

__all__ = ["inclination"]


def inclination(rig: LaserLineRig, poses: list[Pose], seed: int, key: int) -> dict[str, Any]:
    """The coordinates `pitch` and `roll` [rad] (frame) as read; nothing for a rig without inclinometers.

    A rig that turns by T from time 0 sees gravity along Tᵀ R₀ᵀ e_y, R₀ the level matrix of its first attitude.
    """
    meter = rig.inclinometers
    if meter is None:
        return {}
    first = level_matrix(np.deg2rad(meter.pitch_deg), np.deg2rad(meter.roll_deg))
    pitch, roll = attitude(np.stack([pose.turn.T @ first.T @ [0.0, 1.0, 0.0] for pose in poses]))
    noise = generator(seed, key, Stage.INCLINATION).standard_normal((2, len(poses)))
    bias, sigma = np.deg2rad(meter.bias_deg), np.deg2rad(meter.sigma_deg)
    return {"pitch": pitch + bias[0] + sigma * noise[0], "roll": roll + bias[1] + sigma * noise[1]}
