"""What is expected of every frame, and its detector."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...scenes.medium_index import phase_index
from ...scenes.rigs.laser_line import LaserLineRig, laser_line_rig
from ...scenes.rigs.laser_line_effects import LineEffects
from ...scenes.rigs.laser_line_geometry import ambient_e_per_s
from ...scenes.scene import Scene
from ..detector import detect, fixed_pattern
from ..effect import no_light
from ..model import Expected
from ..request import Request
from ..water.phase import phase_of
from .attitude import inclination
from .detected import bloomed, speckled
from .even_light import even_light
from .exposure import frame_settings
from .full import SAMPLING, Rest, Tracing, rest_of
from .light import line_light, nodes_of
from .roughness import roughness_truth
from .scattered import Scattered, curtain, halo, widened
from .setting import Pose, Setting, exposure_poses, poses_of, setting_of
from .truth import LineTruth, line_truth

__all__ = ["FrameLight", "dark_e", "expect", "frame_light", "path_of", "read", "tracing_of"]

Float = NDArray[np.float64]
Stack = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class FrameLight:
    """One frame: the truth, the line's photoelectrons `line` (rows, cols), and what the water scatters, None where it scatters
    nothing or where its phase function is unknown. `rays`, `change`: as of `Lit`."""

    truth: LineTruth
    line: Float
    scattered: Scattered | None
    rays: int
    change: float


def frame_light(setting: Setting, pose: Pose, rtol: float, *, wide: bool, fine: bool | None = None) -> FrameLight:
    """The light of one frame. `wide`: whether the halo is to hold the light of the line beyond the image too; `fine`: whether
    the curtain is to be computed in every row, as `wide` by default."""
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
    veil = curtain(
        setting, pose, phase, every=1 if (wide if fine is None else fine) else max(setting.rig.camera.rows // 64, 1)
    )
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
    full, scatters = request.rung == "full", request.rung != "direct" and phase_of(scene) is not None
    poses, coords = poses_of(rig)
    coords |= inclination(rig, poses, request.seed, request.capture_key)
    ambient = ambient_e_per_s(rig, phase_index(scene.medium, rig.wavelength_m)) * rig.detector.exposure_s
    electrons = np.full((len(poses), rig.camera.rows, rig.camera.cols), ambient, dtype=np.float32)
    uneven = bool(rig.even_light_e_per_s)
    for number, pose in enumerate(poses if uneven else ()):
        same = number > 0 and _same(pose, poses[0])
        electrons[number] = electrons[0] if same else electrons[number] + even_light(setting, pose).astype(np.float32)
    ambient_light = electrons + np.float32(dark_e(rig))
    background = ambient_light.copy()
    sigma = np.zeros(electrons.shape, np.float32)
    frames: list[FrameLight] = []
    rests: list[Rest] = []
    lines: list[Float] = []
    aim = (SAMPLING if full else 1.0) * request.error
    for number, pose in enumerate(poses[: rig.frames.lit]):
        same = number > 0 and _same(pose, poses[0])
        light = frames[0] if same else frame_light(setting, pose, aim, wide=scatters and not full, fine=scatters)
        frames.append(light)
        lines.append(lines[0] if same else _exposed(setting, light, pose, float(coords["time"][number]), aim))
        electrons[number] += lines[-1].astype(np.float32)
        extra = np.zeros_like(light.line)
        if scatters and light.scattered is not None:
            extra = light.scattered.curtain if full else light.scattered.curtain + light.scattered.halo
        if full:
            rest = (
                rests[0] if same else frame_rest(setting, pose, light, aim, (request.seed, request.capture_key, number))
            )
            rests.append(rest)
            extra = extra + rest.light.reshape(extra.shape)
            sigma[number] = rest.sigma.reshape(extra.shape)
        electrons[number] += extra.astype(np.float32)
        background[number] += extra.astype(np.float32)
    truth = _truth([light.truth for light in frames], rig) | {
        "truth_background": background if scatters or full or uneven else background[:, 0, 0].astype(np.float64)
    }
    if full:
        truth["truth_standard_error"] = sigma
    truth |= roughness_truth(scene) | (
        _components(electrons + np.float32(dark_e(rig)), background, ambient_light) if request.truth_components else {}
    )
    if request.truth_electrons:
        truth["truth_electrons"] = electrons + np.float32(dark_e(rig))
    dark = not any(light.line.any() for light in frames)
    warnings: tuple[str, ...] = (no_light(scene, "frame", "the sheet or the view"),) if dark else ()
    rays = sum(light.rays for light in {id(light): light for light in frames}.values())
    traced: dict[str, Any] = {"last_doubling_moved": max(light.change for light in frames)}
    if full:
        sampling, unreached = _sampling(scene.name, rests, request.error)
        traced, warnings = traced | sampling, warnings + unreached
    return Expected(electrons, coords, truth, rays, frames[0], warnings, traced)


def _components(whole: Stack, background: Stack, ambient: Stack) -> dict[str, Stack]:
    """What the light is the sum of, where only the water adds to the line: each with dimensions (frame, row, col)."""
    return {"truth_direct": whole - background, "truth_scattered": background - ambient, "truth_ambient": ambient}


def _sampling(name: str, rests: list[Rest], rtol: float) -> tuple[dict[str, Any], tuple[str, ...]]:
    """What the capture keeps of the sampling, and the warning where the paths were used up."""
    error, reached = max(rest.epsilon for rest in rests), all(rest.reached for rest in rests)
    traced = {"samples_per_pixel": max(rest.samples for rest in rests), "standard_error": error, "reached": reached}
    used_up = f"{name}: the paths are used up: the standard error of the traced light is {error:.2g} of the image, more than rtol "
    return traced, () if reached else (f"{used_up}{rtol:g}.",)


def frame_rest(setting: Setting, pose: Pose, light: FrameLight, rtol: float, name: tuple[int, int, int]) -> Rest:
    """What the full rung adds to line and curtain of a frame, to a standard error of `rtol`; `name` as of `tracing_of`."""
    known = light.line
    if light.scattered is not None:
        known = known + light.scattered.curtain
    return rest_of(tracing_of(setting, pose, light, name), known.ravel(), rtol)


def tracing_of(
    setting: Setting, pose: Pose, light: FrameLight, name: tuple[int, int, int], rows: NDArray[np.intp] | None = None
) -> Tracing:
    """The paths of a frame, or of some of its rows in rising order.

    Main arguments:
        name: seed, capture key and number of the frame, which name the random numbers.
    """
    camera = setting.rig.camera
    rows = np.arange(camera.rows) if rows is None else rows
    row, col = (v.ravel() for v in np.meshgrid(rows, np.arange(camera.cols), indexing="ij"))
    reached = np.linalg.norm(light.truth.point - setting.sheet.source, axis=-1)
    far = float(np.nanmedian(reached)) if np.isfinite(reached).any() else 0.5 * path_of(setting, light.truth)

    def straight(b_per_m: float) -> Float:
        return _straight(setting, pose, light, b_per_m)[rows].ravel()

    return Tracing(setting, pose, row, col, far, *name, straight)


def _straight(setting: Setting, pose: Pose, light: FrameLight, b_per_m: float) -> Float:
    """Light (rows, cols) of line and curtain that goes on straight after scattering, with b `b_per_m`: e^{b(r₁ + r₂)} − 1."""
    phase = setting.scene.medium.phase
    if b_per_m == 0.0 or light.scattered is None or phase is None:
        return np.zeros_like(light.line)
    point = light.truth.point[:, 0].T
    way = setting.sheet.range(point) + np.linalg.norm(point - setting.camera.rays(0.0, 0.0)[0][:, None], axis=0)
    way = np.where(np.isfinite(way), way, path_of(setting, light.truth))
    medium = setting.scene.medium
    # The same water, as clear as it is to light that may turn by as little: b counts in the curtain's strength, not in its loss.
    clearer = medium.model_copy(update={"absorption_per_m": medium.absorption_per_m - b_per_m})
    scene = setting.scene.model_copy(update={"medium": clearer})
    veil = curtain(replace(setting, scene=scene), pose, phase) - light.scattered.curtain
    return np.asarray(light.line * np.expm1(b_per_m * way)[:, None] + veil)


def _exposed(setting: Setting, light: FrameLight, pose: Pose, time_s: float, rtol: float) -> Float:
    """The line of a frame, the mean over the poses within its exposure."""
    poses = exposure_poses(setting.rig, time_s)
    if len(poses) == 1 or all(_same(one, pose) for one in poses):
        return light.line
    return np.asarray(
        sum(line_light(setting, one, nodes_of(setting, one), rtol).electrons for one in poses) / len(poses)
    )


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
    """Counts of the detector, with speckle in the line's light where the rig has it."""
    rig = laser_line_rig(scene)
    pattern = fixed_pattern(rig.detector, rig.camera.rows, rig.camera.cols)
    own = frame_settings(rig, expected.coords)
    effects = rig.effects or LineEffects()
    electrons = expected.electrons
    if effects.speckle_looks is not None:
        dark = dark_e(rig) * np.reshape(own.get("exposure_factor", np.ones(1)), (-1, 1, 1))
        background = np.asarray(expected.truth["truth_background"], np.float32)
        beside = background.reshape(len(electrons), *background.shape[1:] or (1, 1)) - dark.astype(np.float32)
        electrons = speckled(electrons, beside, effects.speckle_looks, request.seed, request.capture_key)
    if effects.blooming is not None:
        electrons = bloomed(electrons, rig.detector, effects.blooming)
    return detect(electrons, rig.detector, pattern, request.seed, request.capture_key, **own)
