"""One scene rendered by every rung: cost, error and task error against two references, and the rung that `auto` chooses.

The quantity is expected photoelectrons per pixel and gate, without ambient light. ε² = Σ(X − R₁)(X − R₂)/ΣR₁R₂ is unbiased
by the noise of the references, which determines its interval. Two kinds of references:

- "independent": R₁ and R₂ are two stacks of mitransient's volumetric path tracer, which shares no light-transport code with
  ours, where it can render the scene (flat-top beams) and its standard error is below `PEER_ENOUGH`. Every rung, `full` too, is
  judged by them, with the verdicts "pass" and "fail"; the bias of `full` that they would have seen is stated (`bias.py`).
- "own": two seeds of our `full` rung. They cannot see a systematic error of `full`, so that the verdicts are "self-consistent"
  and "self-inconsistent".

Each rung is rendered to the accuracy that `auto` would request.

The task error is the bias in time of flight that the rung's error causes in a maximum-likelihood estimate,
J⁻¹Σ∂S·ΔS/V, in units of the bound J^(−1/2): its root mean square over the pixels that see the target.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ...generator.choice import RUNG_SHARE, Rtol
from ...generator.gated.choose import choose
from ...generator.gated.direct import DirectScene, render_direct
from ...generator.gated.error import replicate_error, stack_error, task_error
from ...generator.gated.full import SAMPLING, Limits, Slices, render_remainder
from ...generator.gated.gates import gate_offset
from ...generator.gated.scatter import render_scatter, scattered_electrons
from ...generator.gated.stack import expected_electrons, slice_coordinates, slice_settings
from ...generator.gated.view import view_of
from ...generator.paths.world import PathWorld
from ...scenes.rigs.gated import gated_rig
from ...scenes.scene import Scene
from .bias import Bias, scale_bias

__all__ = ["PEER_ENOUGH", "RTOLS", "RUNGS", "References", "SceneRungs", "measure_scene", "verdict"]

Float = NDArray[np.float64]
Stack = NDArray[np.float32]
T = TypeVar("T")

#: From the cheapest to the most expensive.
RUNGS = ("direct", "scatter", "full")
RTOLS: tuple[Rtol, ...] = (0.1, 0.03, 0.01, "noise")
_REFERENCE_RTOL = 4e-3
_REFERENCE = Limits(most_samples=1 << 16)
#: Samples per pixel of mitransient: first attempt, and maximum.
_PEER_SAMPLES = (1 << 12, 1 << 15)
#: Standard error of mitransient's stack, relative to the whole, above which it is not used as a reference.
PEER_ENOUGH = 0.03


class SceneRungs:
    """Stacks of one scene by each rung."""

    def __init__(self, scene: Scene) -> None:
        self.scene, self.coords = scene, slice_coordinates(scene)
        delay, energy = slice_settings(scene, self.coords, 0, 0)
        self.settings = (delay, energy)
        self.slices = Slices(delay, energy, self.coords["gate"], gate_offset(scene))
        self.world = PathWorld.of(scene, view_of(scene))
        _, self.ambient = expected_electrons(scene, render_direct(scene, 0.1), self.coords, 0, 0)

    def _stack(self, direct: DirectScene) -> Stack:
        light, ambient = expected_electrons(self.scene, direct, self.coords, 0, 0)
        return light - ambient.astype(np.float32)[:, None, None]

    def direct(self, rtol: float) -> Stack:
        """The direct rung, sampled to `rtol`."""
        return self._stack(render_direct(self.scene, rtol))

    def scatter(self, rtol: float) -> Stack:
        """The scatter rung, sampled to `rtol`."""
        found = render_scatter(self.scene, rtol)
        return self._stack(found.direct) + scattered_electrons(self.scene, found, self.coords["gate"], *self.settings)

    def full(self, rtol: float, seed: int, limits: Limits | None = None) -> Stack:
        """The full rung, rays and paths each to their share of `rtol`, divided as in `generate`."""
        direct = self.direct(SAMPLING * rtol)
        found = render_remainder(
            self.scene, direct, self.slices, SAMPLING * rtol, seed, 0, limits=limits or Limits(), world=self.world
        )
        return direct + found.light

    def at(self, rung: str, limit: float, seed: int) -> Stack:
        """A rung as `auto` would render it for the error limit `limit`."""
        share = RUNG_SHARE[rung] * limit
        return self.full(share, seed) if rung == "full" else getattr(self, rung)(share)

    def slope(self) -> Stack:
        """dS/dτ of the direct return [1/s] by central differences over a tenth of a delay step."""
        step = 0.1 * gated_rig(self.scene).delays.step_s
        direct = render_direct(self.scene, 3e-3)
        stacks = []
        for sign in (1.0, -1.0):
            coords = self.coords | {"actual": self.coords["actual"] - sign * step}
            stacks.append(expected_electrons(self.scene, direct, coords, 0, 0)[0])
        return (stacks[0] - stacks[1]) / np.float32(2 * step)

    def background_e(self) -> Float:
        """Electrons of ambient light and dark current per slice, which add to the variance."""
        detector = gated_rig(self.scene).detector
        return np.asarray(self.ambient + detector.dark_current_e_per_s * detector.exposure_s)

    def replicates(self, seed: int) -> Stack:
        """Two independent stacks (2, slices, rows, cols) of the full rung, as references."""
        direct = self.direct(0.5 * _REFERENCE_RTOL)
        found = render_remainder(
            self.scene, direct, self.slices, _REFERENCE_RTOL, seed, 0, limits=_REFERENCE, world=self.world
        )
        return direct[None] + found.halves

    def peer_replicates(self, seed: int) -> Stack | None:
        """The same by mitransient; None where it cannot render the scene."""
        from ..peers.mitransient_volume import mitransient_reference

        if gated_rig(self.scene).laser.illumination.profile != "flat-top":
            return None

        def pair(samples: int, first: int) -> Stack:
            return np.stack([mitransient_reference(self.scene, self.slices, first + k, samples // 2) for k in range(2)])

        few, most = _PEER_SAMPLES
        found = pair(few, seed)
        enough = few * 1.5 * (_noise(found, found.mean(axis=0)) / PEER_ENOUGH) ** 2
        return pair(int(enough), seed + 2) if few < enough <= most else found

    def references(self, seed: int) -> References:
        """Two replicates each of two seeds of `full`, and two stacks by mitransient where these are precise enough."""
        twos = self.replicates(seed + 500_000)
        peer = self.peer_replicates(seed + 1)
        noise = float("nan") if peer is None else _noise(peer, twos.mean(axis=0))
        independent = peer if peer is not None and noise <= PEER_ENOUGH else None
        return References(self.replicates(seed + 250_000), twos, independent, noise)


def _noise(pair: Stack, whole: Stack) -> float:
    """Standard error of the mean of two stacks, relative to the whole stack."""
    between = float(np.mean(np.square(pair[0] - pair[1], dtype=np.float64)))
    return float(np.sqrt(between / 4 / np.mean(np.square(whole, dtype=np.float64))))


@dataclass(frozen=True, eq=False)
class References:
    """`ones`, `twos` (2, slices, rows, cols): replicates of two seeds of `full`; `peers`: two independent stacks of other code,
    None where there are none that are precise enough; `noise`: their standard error, NaN where they could not be rendered."""

    ones: Stack
    twos: Stack
    peers: Stack | None
    noise: float

    @property
    def kind(self) -> str:
        """ "independent" or "own"."""
        return "own" if self.peers is None else "independent"

    def error(self, stack: Stack) -> tuple[float, float, float]:
        """ε of a stack and its 95 % interval, against the independent references where there are any."""
        if self.peers is not None:
            return stack_error(stack, self.peers[0], self.peers[1])
        return replicate_error(stack, self.ones, self.twos)

    def bias_of_full(self) -> Bias:
        """How much too bright `full` is, against the independent references; NaN without."""
        if self.peers is None:
            return Bias(float("nan"), float("nan"))
        return scale_bias(np.concatenate([self.ones, self.twos]).mean(axis=0), self.peers[0], self.peers[1])


def measure_scene(
    scene: Scene, seed: int, rtols: tuple[Rtol, ...] = RTOLS
) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Rows of fidelity.csv of one scene, one for each rung and limit, and a record of its references."""
    rungs = SceneRungs(scene)
    found = rungs.references(seed)
    one, two = found.ones.mean(axis=0), found.twos.mean(axis=0)
    slope, background = rungs.slope(), rungs.background_e()
    variance = two + (background + gated_rig(scene).detector.read_noise_e ** 2).astype(np.float32)[:, None, None]
    offered = [r for r in RUNGS if r != "scatter" or scene.medium.scattering_per_m > 0]
    bias = found.bias_of_full()
    rows: list[dict[str, Any]] = []
    choose(scene, 0.1, seed, 0)  # compile and load before timing
    for rung in offered:
        rungs.at(rung, 0.1, seed)
    for rtol in rtols:
        choice, asking = _timed(partial(choose, scene, rtol, seed, 0))
        limit, sampled = choice.limit, choice.sampled
        for rung in offered:
            stack, seconds = _timed(partial(rungs.at, rung, sampled, seed))
            error, low, high = found.error(stack)
            rows.append(
                {
                    "modality": scene.modality, "scene": scene.name, "rung": rung, "cpu_s": seconds, "rel_error": error,
                    "lo": low, "hi": high, "task_error": task_error(stack, (one, two), slope, variance),
                    "predicted_error": choice.predicted.get(rung, float("nan")),
                    "chosen": rung == choice.rung, "verdict": verdict(low, high, limit, found.kind), "rtol": rtol,
                    "limit": limit, "choice_cpu_s": asking, "reference": found.kind, "bias_seen": bias.seen,
                }
            )  # fmt: skip
    record: dict[str, Any] = {"scene": scene.name, "references": found.kind}
    if found.noise == found.noise:
        record["peer_standard_error"] = found.noise
    if found.peers is not None:
        error, low, high = stack_error(two, found.peers[0], found.peers[1])
        record |= {"full_against_peer": error, "full_against_peer_interval": [low, high]}
        record |= {"bias_of_full": bias.value, "bias_interval": list(bias.interval)}
        record["bias_seen"] = bias.seen if bias.seen == bias.seen else None
    return rows, record


def verdict(low: float, high: float, limit: float, kind: str) -> str:
    """Verdict on a rung whose error lies in low … high at a limit, by references of a kind: "pass", "fail" or "undecided" by
    independent ones; "self-consistent", "self-inconsistent" or "undecided" by our own."""
    words = ("pass", "fail") if kind == "independent" else ("self-consistent", "self-inconsistent")
    return words[0] if high <= limit else words[1] if low > limit else "undecided"


def _timed(make: Callable[[], T]) -> tuple[T, float]:
    begin = time.process_time()
    stack = make()
    return stack, time.process_time() - begin
