"""What is expected of every frame, and its detector."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...scenes.medium_index import phase_index
from ...scenes.rigs.laser_line import LaserLineRig, laser_line_rig
from ...scenes.rigs.laser_line_geometry import ambient_e_per_s
from ...scenes.scene import Scene
from ..detector import detect, fixed_pattern
from ..effect import no_light
from ..model import Expected
from ..request import Request
from ..water.phase import phase_of
from .light import line_light, nodes_of
from .roughness import roughness_truth
from .scattered import Scattered, curtain, halo, widened
from .setting import Pose, Setting, poses_of, setting_of
from .truth import LineTruth, line_truth

__all__ = ["FrameLight", "dark_e", "expect", "frame_light", "path_of", "read"]

Float = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FrameLight:
    """One frame: the truth, the line's photoelectrons `line` (rows, cols), and what the water scatters, None where it scatters
    nothing or where its phase function is unknown. `rays`, `change`: as of `Lit`."""

    truth: LineTruth
    line: Float
    scattered: Scattered | None
    rays: int
    change: float


def frame_light(setting: Setting, pose: Pose, rtol: float, *, wide: bool) -> FrameLight:
    """The light of one frame. `wide`: whether the halo is to hold the light of the line beyond the image too."""
    nodes = nodes_of(setting, pose)
    lit = line_light(setting, pose, nodes, rtol)
    truth = line_truth(setting, pose, nodes)
    phase = setting.scene.medium.phase if setting.scene.medium.scattering_per_m > 0 else None
    if phase is None:
        return FrameLight(truth, lit.electrons, None, lit.rays, lit.change)
    image, margin = lit.electrons, 0
    if wide:
        around, margin = widened(setting)
        image = line_light(around, pose, nodes_of(around, pose), rtol).electrons
    # For the sizes of effects alone, some rows are enough: the curtain is smooth.
    veil = curtain(setting, pose, phase, every=1 if wide else max(setting.rig.camera.rows // 64, 1))
    scattered = Scattered(veil, halo(setting, image, margin, path_of(setting, truth), phase))
    return FrameLight(truth, lit.electrons, scattered, lit.rays + image.size + 4 * veil.size, lit.change)


def path_of(setting: Setting, truth: LineTruth) -> float:
    """Median way [m] of the line's light through the water, out and back; that of the target's middle without a line."""
    point = truth.point.reshape(-1, 3).T
    depth = 0.0 if setting.camera.port is None else setting.camera.port.depth_m
    back = np.linalg.norm(point, axis=0) - depth
    way = setting.sheet.range(point) + back
    if np.isfinite(way).any():
        return float(np.nanmedian(way))
    return 2.0 * max(float(np.median([abs(item.shape.center_m[2]) for item in setting.scene.target])), 1e-3)


def expect(scene: Scene, request: Request) -> Expected[FrameLight]:
    """Expected photoelectrons of every pixel and frame, ambient light included and dark current not, with the truth.

    Raises InputError for an impossible scene, or where the rung `scatter` lacks the medium's phase function.
    """
    setting = setting_of(scene, request.tracer)
    rig = setting.rig
    scatters = request.rung == "scatter" and phase_of(scene) is not None
    poses, coords = poses_of(rig)
    ambient = ambient_e_per_s(rig, phase_index(scene.medium, rig.wavelength_m)) * rig.detector.exposure_s
    electrons = np.full((len(poses), rig.camera.rows, rig.camera.cols), ambient, dtype=np.float32)
    background = electrons + np.float32(dark_e(rig))
    frames: list[FrameLight] = []
    for number, pose in enumerate(poses[: rig.frames.lit]):
        same = number > 0 and _same(pose, poses[0])
        light = frames[0] if same else frame_light(setting, pose, request.error, wide=scatters)
        frames.append(light)
        electrons[number] += light.line.astype(np.float32)
        if scatters and light.scattered is not None:
            extra = (light.scattered.curtain + light.scattered.halo).astype(np.float32)
            electrons[number] += extra
            background[number] += extra
    truth = _truth([light.truth for light in frames], rig) | {
        "truth_background": background if scatters else background[:, 0, 0].astype(np.float64)
    }
    truth |= roughness_truth(scene)
    if request.truth_electrons:
        truth["truth_electrons"] = electrons + np.float32(dark_e(rig))
    dark = not any(light.line.any() for light in frames)
    warnings = (no_light(scene, "frame", "the sheet or the view"),) if dark else ()
    rays = sum(light.rays for light in {id(light): light for light in frames}.values())
    traced = {"last_doubling_moved": max(light.change for light in frames)}
    return Expected(electrons, coords, truth, rays, frames[0], warnings, traced)


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
    return made


def read(scene: Scene, expected: Expected[FrameLight], request: Request) -> NDArray[np.uint16]:
    """Counts of the detector."""
    rig = laser_line_rig(scene)
    pattern = fixed_pattern(rig.detector, rig.camera.rows, rig.camera.cols)
    return detect(expected.electrons, rig.detector, pattern, request.seed, request.capture_key)
