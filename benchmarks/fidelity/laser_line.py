"""The rungs of laser-line scenes on a random family, and the rung that `auto` chooses.

The quantity is expected photoelectrons per pixel of the first frame, without ambient light. ε² = Σ(X − R₁)(X − R₂)/ΣR₁R₂ with two
seeds of our own `full` rung as R₁ and R₂: verdicts are "self-consistent" and "self-inconsistent", and cannot see a systematic error
of `full`, which `tests/test_laser_line_full.py` judges by photons of other code and a quadrature.

The task error is the displacement [px] of the line's column that the rung's error causes in a least-squares fit of the line's
profile, Σ∂L ΔS/Σ(∂L)² along a row: its root mean square over the rows that hold a line.

Most scenes are aimed at a border between rungs: the light that a rung leaves out is set to one of the limits, times a log-uniform
factor in 1/3 … 3, through the water's scattering or the albedo of a corner.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ...generator.choice import RUNG_SHARE, Rtol
from ...generator.laser_line.choose import choose
from ...generator.laser_line.expected import FrameLight, frame_light, tracing_of
from ...generator.laser_line.full import MOST_SAMPLES, SAMPLING, rest_of
from ...generator.laser_line.setting import poses_of, setting_of
from ...scenes.load import load_scene
from ...scenes.scene import Scene
from .bench import Bench
from .measure import verdict

__all__ = [
    "BENCH",
    "RTOLS",
    "SHAPES",
    "WATERS",
    "draw_line_scene",
    "line_family",
    "measure_line_scene",
    "replicated_error",
]

Image = NDArray[np.float64]
T = TypeVar("T")

RTOLS: tuple[Rtol, ...] = (0.1, 0.03, 0.01)
#: a and b [1/m] at 514 nm (Petzold 1972; air has none); in "faint" water b is aimed at a limit.
WATERS: dict[str, tuple[float, float]] = {
    "air": (0.0, 0.0), "faint": (0.046, 0.0), "clear": (0.114, 0.037), "coastal": (0.179, 0.219),
}  # fmt: skip
SHAPES = ("flat", "ball", "corner")
#: Medium and shape, in turn.
_STRATA = (
    ("air", "corner"), ("faint", "flat"), ("clear", "flat"), ("air", "corner"), ("coastal", "flat"), ("faint", "ball"),
    ("clear", "corner"), ("air", "flat"), ("coastal", "corner"), ("faint", "flat"),
)  # fmt: skip
#: Rough shares of the image: of the halo in the whole per scattering length, of the second bounce in a corner per albedo.
_HALO, _BOUNCE = 0.3, 0.02
_RUNGS = ("direct", "scatter", "full")
#: Error of the references' traced light, and most paths of each pixel.
_REFERENCE, _PATHS = 2e-3, 512


def line_family(seed: int, count: int, folder: Path) -> list[Scene]:
    """`count` scenes: the strata in turn, all else drawn. `folder` is not used: no scene has a mesh."""
    return [draw_line_scene(seed, number, *_STRATA[number % len(_STRATA)]) for number in range(count)]


def draw_line_scene(seed: int, number: int, water: str, shape: str) -> Scene:
    """One scene of 8 × 40 pixels; the draw depends only on `seed` and `number`."""
    draw = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))
    far = float(draw.uniform(0.7, 1.6))
    aim = float(draw.choice([0.1, 0.03, 0.01])) * float(np.exp(draw.uniform(-np.log(3.0), np.log(3.0))))
    albedo = (
        float(np.clip(aim / _BOUNCE, 0.05, 0.95))
        if shape == "corner" and water == "air"
        else float(draw.uniform(0.1, 0.9))
    )
    absorption, scattering = WATERS[water]
    scattering *= float(draw.uniform(0.4, 1.2))
    if water == "faint":
        scattering = aim / _HALO / (2.0 * far)
    index = 1.0 if water == "air" else 1.34
    medium: dict[str, Any] = {
        "name": water, "index": {"kind": "explicit", "phase": index, "group": index}, "absorption_per_m": absorption,
        "scattering_per_m": scattering,
    }  # fmt: skip
    if scattering:
        medium["phase_function"] = {"kind": "fournier-forand", "index": 1.1, "slope": 3.58}
    turn = float(draw.uniform(-12.0, -6.0))
    baseline = float(-np.tan(np.deg2rad(turn)) * far * draw.uniform(0.85, 1.15))
    return load_scene(
        "spotscan-wall",
        {
            "name": f"{water}-{shape}-{number}", "target": _target(shape, far, albedo, draw), "medium": medium,
            "rig.camera.rows": 8, "rig.camera.cols": 40, "rig.camera.pixel_pitch_m": 5 * 57.8125e-6, "rig.frames.lit": 1,
            "rig.laser.position_m": [baseline, 0.0, 0.02], "rig.laser.rotation_deg": [0.0, turn, 0.0],
            "rig.laser.waist_m": float(10 ** draw.uniform(-3.5, -2.7)), "rig.lens_sigma_px": float(draw.uniform(0.2, 0.8)),
            "rig.port": {
                "kind": "flat", "stand_off_m": float(draw.uniform(0.0, 0.04)), "thickness_m": 0.01, "glass_index": 1.5,
                "inside_index": 1.0,
            },
        },
    )  # fmt: skip


def _target(shape: str, far: float, albedo: float, draw: np.random.Generator) -> list[dict[str, Any]]:
    material = {"kind": "lambert", "albedo": albedo}

    def wall(name: str, x: float, z: float, width: float, tilt: float) -> dict[str, Any]:
        place = {"center_m": [x, 0.0, z], "width_m": width, "height_m": 2.0, "tilt_x_deg": 0.0, "tilt_y_deg": tilt}
        return {"name": name, "shape": {"kind": "rectangle", **place}, "material": material}

    if shape == "flat":
        return [wall("wall", 0.0, far, 3.0, float(draw.uniform(-30.0, 30.0)))]
    if shape == "ball":
        ball = {"kind": "sphere", "center_m": [0.0, 0.0, far + 0.3], "radius_m": 0.3}
        return [{"name": "ball", "shape": ball, "material": material}]
    half = float(draw.uniform(40.0, 60.0))
    width, a = 0.4 * far, np.deg2rad(half)
    x, z = 0.5 * width * float(np.sin(a)), far - 0.5 * width * float(np.cos(a))
    return [wall("left", -x, z, width, half - 90.0), wall("right", x, z, width, 90.0 - half)]


class _Rungs:
    """Images of one scene by each rung."""

    def __init__(self, scene: Scene) -> None:
        self.setting = setting_of(scene)
        self.pose = poses_of(self.setting.rig)[0][0]

    def light(self, rtol: float, *, wide: bool = False, fine: bool = True) -> FrameLight:
        """The frame's line and closed-form scattered light."""
        return frame_light(self.setting, self.pose, rtol, wide=wide, fine=fine)

    def at(self, rung: str, limit: float, seed: int) -> Image:
        """A rung as `auto` would render it for an error limit."""
        share = RUNG_SHARE[rung] * limit
        if rung != "full":
            light = self.light(share, wide=rung == "scatter", fine=rung == "scatter")
            parts = light.scattered if rung == "scatter" else None
            return light.line if parts is None else light.line + parts.curtain + parts.halo
        light = self.light(SAMPLING * share)
        return np.asarray(self.known(light) + self.rest(light, SAMPLING * share, seed, MOST_SAMPLES)[0], np.float64)

    def known(self, light: FrameLight) -> Image:
        """Line and curtain."""
        return light.line if light.scattered is None else light.line + light.scattered.curtain

    def rest(self, light: FrameLight, rtol: float, seed: int, most: int) -> Image:
        """(mean and two halves) (3, rows, cols) of the traced light."""
        found = rest_of(tracing_of(self.setting, self.pose, light, (seed, 0, 0)), self.known(light).ravel(), rtol, most)
        return np.concatenate([found.light[None], found.halves]).reshape(3, *light.line.shape)


def replicated_error(x: Image, ones: Image, twos: Image) -> tuple[float, float, float]:
    """ε of an image (rows, cols), and its 95 % interval by the references' noise. `ones`, `twos` (2, rows, cols): two independent
    replicates each of R₁ and R₂, which are their means. As `generator.gated.error.replicate_error`, for images."""
    one, two = ones.mean(axis=0), twos.mean(axis=0)
    below = float((one * two).sum())
    if not below > 0:
        return 0.0, 0.0, 0.0
    square = float(((x - one) * (x - two)).sum()) / below
    apart = (x - ones) * (x - twos)
    spread = 1.96 * 0.5 * float(np.sqrt(((apart[0] - apart[1]) ** 2).sum())) / below
    error, low, high = np.sqrt(np.maximum([square, square - spread, square + spread], 0.0))
    return float(error), float(low), float(high)


def _task(x: Image, one: Image, two: Image, line: Image) -> float:
    """Displacement [px] of the column, rms over the rows with a line; one factor against each reference."""
    slope = -np.gradient(line, axis=1)
    power = (slope**2).sum(axis=1)
    seen = power > 1e-6 * power.max(initial=0.0)
    if not seen.any():
        return 0.0
    moved = [((x - r) * slope).sum(axis=1)[seen] / power[seen] for r in (one, two)]
    return float(np.sqrt(max(float((moved[0] * moved[1]).mean()), 0.0)))


def measure_line_scene(
    scene: Scene, seed: int, rtols: tuple[Rtol, ...] = RTOLS
) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Rows of fidelity.csv of one scene, one for each rung and limit, and a record of its references."""
    rungs = _Rungs(scene)
    light = rungs.light(_REFERENCE)
    pairs = [
        rungs.known(light) + rungs.rest(light, _REFERENCE, seed + offset, _PATHS)[1:] for offset in (250_000, 500_000)
    ]
    one, two = (pair.mean(axis=0) for pair in pairs)
    offered = [rung for rung in _RUNGS if rung != "scatter" or scene.medium.scattering_per_m > 0]
    rows: list[dict[str, Any]] = []
    for rtol in rtols:
        choice, asking = _timed(partial(choose, scene, rtol, seed, 0))
        for rung in offered:
            image, seconds = _timed(partial(rungs.at, rung, choice.sampled, seed))
            error, low, high = replicated_error(image, pairs[0], pairs[1])
            rows.append(
                {
                    "modality": scene.modality, "scene": scene.name, "rung": rung, "cpu_s": seconds, "rel_error": error,
                    "lo": low, "hi": high, "task_error": _task(image, one, two, light.line),
                    "predicted_error": choice.predicted.get(rung, float("nan")), "chosen": rung == choice.rung,
                    "verdict": verdict(low, high, choice.limit, "own"), "rtol": rtol, "limit": choice.limit,
                    "choice_cpu_s": asking, "reference": "own", "bias_seen": float("nan"),
                }
            )  # fmt: skip
    return rows, {"scene": scene.name, "references": "own"}


def _timed(make: Callable[[], T]) -> tuple[T, float]:
    begin = time.process_time()
    made = make()
    return made, time.process_time() - begin


BENCH = Bench(line_family, measure_line_scene)
