"""What is expected of every frame, and its detector."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...scenes.rigs.laser_line import LaserLineRig, laser_line_rig
from ...scenes.scene import Scene
from ..detector import detect, fixed_pattern
from ..effect import no_light
from ..model import Expected
from ..request import Request
from .light import line_light, nodes_of
from .setting import Pose, poses_of, setting_of
from .truth import LineTruth, line_truth

__all__ = ["FrameLight", "dark_e", "expect", "read"]

Float = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FrameLight:
    """What the catalogue of effects is judged by: the truth of the first frame, and its brightest pixel [photoelectrons]."""

    truth: LineTruth
    peak: float


def expect(scene: Scene, request: Request) -> Expected[FrameLight]:
    """Expected photoelectrons of every pixel and frame, ambient light included and dark current not, with the truth.

    Raises InputError for an impossible scene.
    """
    setting = setting_of(scene, request.tracer)
    rig = setting.rig
    poses, coords = poses_of(rig)
    ambient = rig.ambient_e_per_s * rig.detector.exposure_s
    electrons = np.full((len(poses), rig.camera.rows, rig.camera.cols), ambient, dtype=np.float32)
    truths: list[LineTruth] = []
    rays, change, peak = 0, 0.0, 0.0
    for number, pose in enumerate(poses[: rig.frames.lit]):
        if number and _same(pose, poses[0]):
            electrons[number] = electrons[0]
            truths.append(truths[0])
            continue
        nodes = nodes_of(setting, pose)
        lit = line_light(setting, pose, nodes, request.error)
        electrons[number] += lit.electrons.astype(np.float32)
        truths.append(line_truth(setting, pose, nodes))
        rays, change = rays + lit.rays, max(change, lit.change)
        peak = max(peak, float(lit.electrons.max(initial=0.0)))
    light = FrameLight(truths[0], peak)
    warnings = () if peak > 0 else (no_light(scene, "frame", "the sheet or the view"),)
    truth = _truth(truths, rig)
    if request.truth_electrons:
        truth["truth_electrons"] = electrons + np.float32(dark_e(rig))
    return Expected(electrons, coords, truth, rays, light, warnings, {"last_doubling_moved": change})


def dark_e(rig: LaserLineRig) -> float:
    """Dark electrons of a pixel in one exposure."""
    return rig.detector.dark_current_e_per_s * rig.detector.exposure_s


def _same(one: Pose, other: Pose) -> bool:
    return np.array_equal(one.place, other.place) and np.array_equal(one.turn, other.turn)


def _truth(truths: list[LineTruth], rig: LaserLineRig) -> dict[str, Any]:
    """The truth of all frames; those without laser, and rows with fewer returns than the most, hold NaN."""
    frames, rows = rig.frames.lit + rig.frames.laser_off, rig.camera.rows
    returns = max(one.column.shape[1] for one in truths)
    names = {"column": (), "point": (3,), "amplitude": (), "width": ()}
    made = {f"truth_{name}": np.full((frames, rows, returns, *more), np.nan) for name, more in names.items()}
    for number, one in enumerate(truths):
        for name in names:
            held = getattr(one, name)
            made[f"truth_{name}"][number, :, : held.shape[1]] = held
    level = rig.ambient_e_per_s * rig.detector.exposure_s + dark_e(rig)
    return made | {"truth_background": np.full(frames, level)}


def read(scene: Scene, expected: Expected[FrameLight], request: Request) -> NDArray[np.uint16]:
    """Counts of the detector."""
    rig = laser_line_rig(scene)
    pattern = fixed_pattern(rig.detector, rig.camera.rows, rig.camera.cols)
    return detect(expected.electrons, rig.detector, pattern, request.seed, request.capture_key)
