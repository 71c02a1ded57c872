"""The choice between rungs: model no more than a scene needs.

Each rung's error for this scene and rig is predicted before rendering: zero in closed form where nothing can be left out,
else by a pilot, the full rung at low resolution with the same field of view. The error is that of the fidelity rule,
ε² = Σ(X − R₁)(X − R₂)/ΣR₁R₂, with two independent halves of the pilot as R₁ and R₂: the pilot's own noise drops out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..scenes.rig import Camera, Detector
from ..scenes.scene import Scene, gated_rig
from .effects import interreflection
from .full import Limits, Remainder, Slices, gate_offset, render_remainder
from .path_world import PathWorld

__all__ = ["Choice", "Rtol", "choose", "pilot_scene", "stack_error"]

Float = NDArray[np.float64]
Stack = NDArray[np.float32]
Rtol = float | Literal["noise"]

#: Pixels along the longer side of the pilot, and most paths of each.
_PILOT_SIDE = 12
_PILOT_SAMPLES = 4096
#: A rung passes with this margin, which covers what the pilot's low resolution hides; its noise is in the interval, whose
#: upper end must pass too.
_MARGIN = 0.8


@dataclass(frozen=True)
class Choice:
    """`rung`: the cheapest whose predicted error passes; `rtol`: the fraction that it is rendered to; `predicted`: error of
    every rung that was considered, relative to the stack; `limit`: what they were held against; `basis`: how they were
    found; `sizes`: predicted relative size of effects by their names in the catalogue."""

    rung: Literal["direct", "scatter", "full"]
    rtol: float
    predicted: dict[str, float]
    limit: float
    basis: str
    sizes: dict[str, float]

    def record(self) -> dict[str, Any]:
        """What the capture keeps of the choice."""
        return {"predicted_error": self.predicted, "limit": self.limit, "basis": self.basis}


def pilot_scene(scene: Scene, side: int = _PILOT_SIDE) -> Scene:
    """The scene with at most `side` pixels along each axis, the same field of view, and no random timing or energy."""
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
    return scene.model_copy(update={"rig": rig.model_copy(update={"camera": small, "laser": laser})})


def choose(scene: Scene, rtol: Rtol, seed: int, capture_key: int) -> Choice:
    """The cheapest rung whose predicted error is below `rtol`; where none is, the one with the smallest.

    Main arguments:
        scene: what is rendered; gated.
        rtol: a fraction of the stack (rms), or "noise": below one standard deviation of the detector's noise (rms).
        seed, capture_key: name the pilot's random numbers.

    Raises:
        InputError: as the full rung does; a medium that scatters needs a phase function.
    """
    scatters = scene.medium.scattering_per_m > 0
    size, basis = interreflection(scene)
    if not scatters and size == 0.0:
        limit = rtol if isinstance(rtol, float) else _noise_limit(scene, seed, capture_key)
        return Choice("direct", limit, {"direct": 0.0}, limit, basis, {"interreflection": 0.0})
    small = pilot_scene(scene)
    rungs = _cheap_stacks(small, scatters, seed, capture_key)
    direct = rungs["direct"]
    slices = _slices(small, seed, capture_key)
    world = PathWorld.of(small)
    limits = Limits(most_samples=_PILOT_SAMPLES)
    goal = 0.3 * (rtol if isinstance(rtol, float) else 0.01)

    def pilot(component: str) -> Remainder:
        return render_remainder(
            small, direct, slices, goal, seed, capture_key, component=component, limits=limits, world=world
        )

    traced = pilot("all")
    limit = rtol if isinstance(rtol, float) else _relative_noise(scene, small, direct + traced.light)
    references = direct[None] + traced.halves
    found = {name: stack_error(stack, *references) for name, stack in rungs.items()}
    predicted = {name: error for name, (error, _, _) in found.items()}
    sizes: dict[str, float] = {}
    if scatters:
        bounced = pilot("interreflection") if size != 0.0 else None
        sizes["interreflection"] = 0.0 if bounced is None else stack_error(direct, *(direct[None] + bounced.halves))[0]
    else:
        sizes["interreflection"] = predicted["direct"]
    passing = [name for name, (error, _, high) in found.items() if error <= _MARGIN * limit and high <= limit]
    # The full rung is traced until its error is what was asked for, or its paths are used up.
    predicted["full"] = max(limit, traced.epsilon * math.sqrt(traced.samples / Limits().most_samples))
    used = f"pilot of {direct.shape[1]}×{direct.shape[2]} pixels, {traced.samples} paths each"
    # Where the tracer cannot reach the limit either, the rung nearest to it is taken.
    rung: Any = passing[0] if passing else min(predicted, key=lambda name: predicted[name])
    return Choice(rung, limit, predicted, limit, used, sizes)


def _cheap_stacks(scene: Scene, scatters: bool, seed: int, key: int) -> dict[str, Stack]:
    """Signal (slices, rows, cols), without ambient light, of the rungs below the full one; the cheapest comes first."""
    from .direct import render_direct
    from .generate import expected_electrons, slice_coordinates, slice_settings
    from .scatter import render_scatter, scattered_electrons

    coords = slice_coordinates(scene)

    def stack(direct: Any) -> Stack:
        light, ambient = expected_electrons(scene, direct, coords, seed, key)
        return light - ambient.astype(np.float32)[:, None, None]

    found = {"direct": stack(render_direct(scene, 1e-3))}
    if scatters:
        scatter = render_scatter(scene, 1e-3)
        veil = scattered_electrons(scene, scatter, coords["gate"], *slice_settings(scene, coords, seed, key))
        found["scatter"] = stack(scatter.direct) + veil
    return found


def _slices(scene: Scene, seed: int, key: int) -> Slices:
    from .generate import slice_coordinates, slice_settings

    coords = slice_coordinates(scene)
    delay, energy = slice_settings(scene, coords, seed, key)
    return Slices(delay, energy, coords["gate"], gate_offset(scene))


def stack_error(x: Stack, one: Stack, two: Stack, seed: int = 0, draws: int = 400) -> tuple[float, float, float]:
    """ε of stack x (slices, rows, cols) against two independent references, ε² = Σ(x − R₁)(x − R₂)/ΣR₁R₂, and its 95 %
    interval by a bootstrap over pixels. What is negative by noise is zero."""
    a, b, c = (v.astype(np.float64).reshape(len(v), -1) for v in (x, one, two))
    above, below = np.sum((a - b) * (a - c), axis=0), np.sum(b * c, axis=0)
    if not below.sum() > 0:
        return 0.0, 0.0, 0.0
    pick = np.random.default_rng(seed).multinomial(above.size, np.full(above.size, 1 / above.size), size=draws)
    ratios = (pick @ above) / np.maximum(pick @ below, 1e-300)
    low, high = np.sqrt(np.maximum(np.percentile(ratios, [2.5, 97.5]), 0.0))
    return float(np.sqrt(max(float(above.sum() / below.sum()), 0.0))), float(low), float(high)


def _relative_noise(scene: Scene, small: Scene, signal: Stack) -> float:
    """rms of the detector's noise relative to the rms of the signal, at the scene's own pixels."""
    area = (gated_rig(small).camera.pixel_pitch_m / gated_rig(scene).camera.pixel_pitch_m) ** 2
    electrons = signal.astype(np.float64) / area
    mean_square = float(np.mean(electrons**2))
    variance = _variance(gated_rig(scene).detector, electrons)
    return float(np.clip(np.sqrt(np.mean(variance) / mean_square), 1e-4, 0.5)) if mean_square > 0 else 0.5


def _variance(detector: Detector, electrons: Float) -> Float:
    """Variance [electrons²] of a sample of this expectation: photons (with the tube's excess), dark, read, rounding."""
    tube = detector.intensifier
    excess, gain = (1.0, 1.0) if tube is None else (tube.excess_noise_factor, tube.gain)
    dark = detector.dark_current_e_per_s * detector.exposure_s
    after = dark + detector.read_noise_e**2 + 1.0 / (12.0 * detector.gain_dn_per_e**2)
    return np.asarray(excess * electrons + after / gain**2)


def _noise_limit(scene: Scene, seed: int, key: int) -> float:
    small = pilot_scene(scene)
    return _relative_noise(scene, small, _cheap_stacks(small, False, seed, key)["direct"])
