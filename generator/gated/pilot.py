"""The pilot: the scene at low resolution by every rung, the full one with as many paths as it takes to decide."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...scenes.rigs.gated import gated_rig
from ...scenes.rigs.parts import Camera
from ...scenes.scene import Scene
from ..noise import noise_variance
from ..paths.world import PathWorld
from .direct import render_direct
from .error import relative_noise, replicate_error, stack_error, task_error
from .full import Limits, Remainder, Slices, render_remainder
from .gates import gate_offset
from .scatter import render_scatter, scattered_electrons
from .stack import ambient_electrons, expected_electrons, slice_coordinates, slice_settings
from .view import view_of

__all__ = ["Pilot", "Traced", "cheap_stacks", "pilot_scene"]

Float = NDArray[np.float64]
Stack = NDArray[np.float32]

#: Pixels along the longer side of the pilot, and most paths of each, round by round.
_SIDE = 12
_SAMPLES = (1 << 10, 1 << 12, 1 << 14, 1 << 16)
#: Share of the full rung's paths that a further round of the pilot may take.
_MOST_SHARE = 0.3


def pilot_scene(scene: Scene, side: int = _SIDE) -> Scene:
    """The scene with at most `side` pixels along each axis, the same field of view, no random timing or energy, and still."""
    rig = gated_rig(scene)
    camera = rig.camera
    factor = max(math.ceil(max(camera.rows, camera.cols) / side), 1)
    small: Camera = camera.model_copy(
        update={
            "rows": math.ceil(camera.rows / factor),
            "cols": math.ceil(camera.cols / factor),
            "pixel_pitch_m": camera.pixel_pitch_m * factor,
        }
    )
    laser = rig.laser.model_copy(update={"energy_fluctuation": 0.0, "jitter_frame_s": 0.0})
    still: dict[str, Any] = {"camera": small, "laser": laser, "motion_m_per_s": None, "screen": None}
    return scene.model_copy(update={"rig": rig.model_copy(update=still)})


def cheap_stacks(scene: Scene, key: int = 0) -> dict[str, Stack]:
    """Signal (slices, rows, cols), without ambient light, of the rungs below the full one; the cheapest comes first."""
    coords = slice_coordinates(scene)

    def stack(direct: Any) -> Stack:
        light, ambient = expected_electrons(scene, direct, coords, 0, key)
        return light - ambient.astype(np.float32)[:, None, None]

    stacks = {"direct": stack(render_direct(scene, 1e-3))}
    if scene.medium.scattering_per_m > 0:
        scatter = render_scatter(scene, 1e-3)
        veil = scattered_electrons(scene, scatter, coords["gate"], *slice_settings(scene, coords, 0, key))
        stacks["scatter"] = stack(scatter.direct) + veil
    return stacks


@dataclass(frozen=True, eq=False)
class Traced:
    """What a round of paths gives. `errors`: (ε, low, high) of the rungs below the full one; `full`: standard error that
    the full rung is left with when its paths are used up; `paths` per pixel; `noise`: rms of the detector's noise over the
    signal's; `task`: task errors of the rungs."""

    errors: dict[str, tuple[float, float, float]]
    full: float
    paths: int
    noise: float
    task: dict[str, float]


def _with(finite: float, error: float, low: float, high: float) -> tuple[float, float, float]:
    """An error and its interval, and what finite lens and lamp change: another light, added in quadrature."""
    return math.hypot(error, finite), math.hypot(low, finite), math.hypot(high, finite)


class Pilot:
    """The pilot of a scene, of which lens and lamp are points; `finite`: relative change of the stack by their size.

    Raises:
        InputError: as the full rung does; a medium that scatters needs a phase function.
    """

    def __init__(self, scene: Scene, seed: int, key: int, finite: float = 0.0) -> None:
        self.scene, self.small = scene, pilot_scene(scene)
        self.seed, self.key = seed, key
        coords = slice_coordinates(self.small)
        delay, energy = slice_settings(self.small, coords, seed, key)
        self.slices = Slices(delay, energy, coords["gate"], gate_offset(self.small))
        self.coords = coords
        self.stacks = cheap_stacks(self.small, key)
        # Blurs of some pixels do not show on the pilot's wide ones: lens and lamp are points here, and their size is added.
        self.world = replace(PathWorld.of(self.small, view_of(self.small)), focus_distance=None, source_radius=0.0)
        self.finite = finite
        area = gated_rig(self.small).camera.pixel_pitch_m / gated_rig(scene).camera.pixel_pitch_m
        self._per_pixel = 1.0 / area**2

    @property
    def shape(self) -> tuple[int, ...]:
        """(rows, cols) of the pilot."""
        return self.stacks["direct"].shape[1:]

    def rounds(self, goal: float, limit: float, with_task: bool) -> Iterator[Traced]:
        """Estimates from more and more paths, until the standard error of the full stack is below `goal`, or a further round would
        cost a good part of what the full rung itself would for an error of `limit`."""
        camera = gated_rig(self.scene).camera
        pixels = camera.rows * camera.cols / (self.shape[0] * self.shape[1])
        for most in _SAMPLES:
            pair = [self._trace("all", goal, most // 2, replicate) for replicate in range(2)]
            traced = self._traced(pair, with_task)
            yield traced
            needed = Limits().most_samples * min((traced.full / limit) ** 2, 1.0) * pixels
            if all(run.reached for run in pair) or 4 * most > _MOST_SHARE * needed:
                return

    def interreflection(self, goal: float) -> float:
        """Light between surfaces, that meets no scattering, over all direct light."""
        traced = self._trace("interreflection", goal, _SAMPLES[0], 0)
        direct = self.stacks["direct"]
        return stack_error(direct, *(direct[None] + traced.halves))[0]

    def _trace(self, component: str, goal: float, most: int, replicate: int) -> Remainder:
        return render_remainder(
            self.small, self.stacks["direct"], self.slices, goal, self.seed + replicate, self.key,
            component=component, limits=Limits(most_samples=most), world=self.world,
        )  # fmt: skip

    def _traced(self, pair: list[Remainder], with_task: bool) -> Traced:
        direct = self.stacks["direct"]
        ones, twos = (direct[None] + np.stack([traced.halves[half] for traced in pair]) for half in range(2))
        mean = 0.25 * (ones + twos).sum(axis=0).astype(np.float64) * self._per_pixel
        task: dict[str, float] = {}
        if with_task:
            ambient = ambient_electrons(self.scene, self.coords)[:, None, None]
            variance = noise_variance(gated_rig(self.scene).detector, mean + ambient)
            scale = np.float32(self._per_pixel)
            both = (ones.mean(axis=0) * scale, twos.mean(axis=0) * scale)
            slope = self._slope() * scale
            task = {name: task_error(stack * scale, both, slope, variance) for name, stack in self.stacks.items()}
        # Two independent runs: their errors' root mean square, as a run of all paths that the rung may use would have it.
        epsilon = math.sqrt(sum(t.epsilon**2 * t.samples for t in pair) / len(pair))
        errors = {name: replicate_error(stack, ones, twos) for name, stack in self.stacks.items()}
        noise = relative_noise(self.scene, mean)
        # At worst all of the change looks like a later echo: the sum over slices of (change/noise)².
        worst = self.finite / noise * math.sqrt(len(mean))
        return Traced(
            {name: _with(self.finite, *error) for name, error in errors.items()},
            epsilon / math.sqrt(Limits().most_samples),
            sum(t.samples for t in pair),
            noise,
            {name: math.hypot(error, worst) for name, error in task.items()},
        )

    def _slope(self) -> Stack:
        """dS/dτ of the direct return by central differences over a tenth of a delay step [1/s]."""
        step = 0.1 * gated_rig(self.small).delays.step_s
        direct = render_direct(self.small, 3e-3)
        shifted = [
            expected_electrons(
                self.small, direct, self.coords | {"actual": self.coords["actual"] - sign * step}, 0, self.key
            )[0]
            for sign in (1.0, -1.0)
        ]
        return (shifted[0] - shifted[1]) / np.float32(2 * step)
