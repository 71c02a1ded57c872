"""The `full` rung: the exact direct rung, single scattering by quadrature, and a path-traced rest, so that the rungs nest.

The path-traced rest is gathered once as a histogram over time, from which the slices of any pulse, gate and delay follow. A bin
keeps three moments of its light (sum, mean time, spread), so it is rendered by the same two-point rule as the returns of
the direct rung: bins of a quarter of R's σ then err by less than 1e-5, where plain bins would add δt²/12 of variance.

Two independent halves of the samples give the error of the stack; sampling goes on until that meets the request.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...optics.constants import C_M_PER_S
from ...optics.correlation.response import Table
from ...scenes.errors import InputError
from ...scenes.scene import Scene
from ..paths.finite import FiniteLight, FiniteSums, trace_finite
from ..paths.loop import COMPONENTS, Lanes, Moments, Window, trace_lanes
from ..paths.single import single_electrons
from ..paths.world import PathWorld
from ..random import BLOCK_ROWS, Stage, sequence
from ..rays.returns import Returns, render_stack
from ..water.ramp import nearest_path_m
from .finite_truth import finite_truth
from .gates import gate_offset, gate_tables
from .view import view_of

__all__ = [
    "SAMPLING",
    "Limits",
    "add_remainder",
    "Remainder",
    "Slices",
    "path_window",
    "render_remainder",
    "returns_of_moments",
]

Float = NDArray[np.float64]

#: Width of a bin in σ of R.
_BIN_SIGMAS = 0.25
#: Lanes that keep two cores busy: small images get several lanes a pixel.
_LANES = 8192
#: Rays and paths share the rung's relative error: each may have this part of it.
SAMPLING = 0.7
_FIRST_SAMPLES = 8


@dataclass(frozen=True)
class Slices:
    """What each slice sees: optical delay [s], scale (pulse energy; 0 with the laser off), index of the gate; and
    the gate's extra delay in each pixel (rows·cols) [s], or None."""

    delay_s: Float
    scale: Float
    gate: NDArray[np.int32]
    offset_s: Float | None


@dataclass(frozen=True)
class Limits:
    """`most_samples` per pixel; `memory_bytes` of the histograms held at once (an image is cut into tiles of rows)."""

    most_samples: int = 1 << 17
    memory_bytes: int = 1 << 28


@dataclass(frozen=True)
class Remainder:
    """What the direct rung leaves out. `light` (slices, rows, cols) photoelectrons; `amplitude` (rows, cols): photoelectrons at an
    open gate of the paths' light inside the window of times; `sigma` (rows, cols): standard error of all that is traced, of the
    differences too (the water's shadow, finite lens and lamp); `halves` (2, slices, rows, cols): two independent estimates
    whose mean is `light`; `epsilon`: standard error of the stack relative to the whole stack, sqrt(Σ variance / Σ (direct +
    remainder)²); `samples` per pixel; `parts`: on request, the stacks "interreflection", "single", "multiple" and "direct"
    (what finite lens and lamp change), whose sum is `light`; `finite`: what they change of the pixels' own light. Where
    lens or lamp are finite there is always "direct" and `finite`, otherwise `finite` is None."""

    light: NDArray[np.float32]
    amplitude: Float
    sigma: Float
    halves: NDArray[np.float32]
    epsilon: float
    samples: int
    reached: bool
    parts: dict[str, NDArray[np.float32]] = field(default_factory=dict)
    finite: FiniteLight | None = None


def path_window(scene: Scene, tables: list[Table], slices: Slices, per_metre_s: float) -> Window:
    """Optical paths that any slice can see, in bins of a quarter of the narrowest R's σ."""
    sigma = min(_table_sigma(table) for table in tables)
    lit = slices.scale > 0
    delay = slices.delay_s[lit] if lit.any() else slices.delay_s
    gate = slices.gate[lit] if lit.any() else slices.gate
    low = np.array([t.start_s for t in tables])
    high = low + np.array([t.step_s * (len(t.value) - 1) for t in tables])
    offset = np.zeros(1) if slices.offset_s is None else slices.offset_s
    # Nearer than this, lamp and aperture are no points; the quadrature of single scattering ends there too.
    nearest = nearest_path_m(view_of(scene)) * per_metre_s if scene.medium.scattering_per_m else 0.0
    first = max(float((delay + low[gate]).min() + offset.min()), nearest)
    last = max(float((delay + high[gate]).max() + offset.max()), first)
    width = _BIN_SIGMAS * sigma
    bins = max(int(np.ceil((last - first) / width)), 1)
    return Window(first / per_metre_s, width / per_metre_s, bins)


def _table_sigma(table: Table) -> float:
    u = table.start_s + table.step_s * np.arange(len(table.value))
    total = table.value.sum()
    mean = float(u @ table.value / total)
    return float(np.sqrt((u - mean) ** 2 @ table.value / total))


def returns_of_moments(bins: NDArray[np.float32], window: Window, electrons: float, per_metre_s: float) -> Returns:
    """Returns of pixels from the moments (3, pixels, bins) of their bins; every bin with light becomes one."""
    pixel, which = np.nonzero(bins[0] > 0)
    light, first, second = (b[pixel, which].astype(np.float64) for b in bins)
    mean = np.clip(first / light, -0.5, 0.5)
    spread = np.sqrt(np.clip(second / light - mean**2, 0.0, 0.25))
    start = np.zeros(bins.shape[1] + 1, dtype=np.int64)
    np.cumsum(np.bincount(pixel, minlength=bins.shape[1]), out=start[1:])
    tau = (window.start_m + (which + 0.5 + mean) * window.width_m) * per_metre_s
    return Returns(start, light * electrons, tau, spread * window.width_m * per_metre_s)


def render_remainder(
    scene: Scene,
    direct: NDArray[np.float32],
    slices: Slices,
    rtol: float,
    seed: int,
    capture_key: int,
    *,
    component: str = "all",
    limits: Limits = Limits(),
    world: PathWorld | None = None,
    parts: bool = False,
    grown: float = 0.0,
) -> Remainder:
    """What the direct rung leaves out, traced until the standard error of the stack is below `rtol` of the stack.

    Main arguments:
        direct: photoelectrons (slices, rows, cols) of the direct rung: the error is relative to the whole.
        slices: delays, scales and gates; rtol: relative standard error aimed at.
        seed, capture_key: name the random numbers.
    Other arguments:
        component: "all"; or for tests one of "interreflection", "multiple" (light with scattering, other than single) and "single",
            which is then path-traced too, while "all" takes it from its quadrature.
        limits: samples and memory; where the samples do not suffice, `reached` is False and `epsilon` is the error that is left.
        world: reuse an earlier one (same scene).
        parts: also keep the stacks of "all" apart.
        grown: the share by which targets are larger about the camera, to first order, in what is traced (`paths.growth`); what
            quadrature gives, and what finite lens and lamp change, stays as it is.

    Raises:
        InputError: as `PathWorld.of`, or an unknown component.
    """
    if component not in COMPONENTS:
        raise InputError("There is no such light.", where="component", value=component, allowed=", ".join(COMPONENTS))
    world = world or PathWorld.of(scene, view_of(scene))
    run = _Run(scene, world, slices, seed, capture_key, component, limits, parts, grown)
    known = np.zeros_like(direct)
    if component == "all":
        known = single_electrons(
            scene, view_of(scene), gate_tables(scene), slices.gate, slices.delay_s, slices.scale, slices.offset_s
        )
        direct = direct + known
    wanted = _FIRST_SAMPLES
    while True:
        run.add(wanted)
        whole = run.square(direct)
        epsilon = float(np.sqrt(run.variance() / whole)) if whole > 0 else 0.0
        if epsilon <= rtol or run.samples >= limits.most_samples:
            break
        needed = run.samples * min(max(1.1 * (epsilon / rtol) ** 2, 1.5), 16.0)
        wanted = max(int(np.ceil((min(needed, limits.most_samples) - run.samples) / run.lanes_per_pixel)), 1)
    light, amplitude, sigma = run.result()
    halves = (run.half / np.float32(run.samples / 2)).reshape(2, *light.shape) + known
    stacks = {name: part.reshape(light.shape) / np.float32(run.samples) for name, part in run.part.items()}
    if parts:
        stacks["single"] += known
    finite = run.finite_light()
    if finite is not None:
        sigma = np.hypot(sigma, finite.sigma)
    return Remainder(light + known, amplitude, sigma, halves, epsilon, run.samples, epsilon <= rtol, stacks, finite)


def add_remainder(
    scene: Scene, light: NDArray[np.float32], ambient: Float, gate: NDArray[np.int32], delay_s: Float, scale: Float,
    rtol: float, seed: int, capture_key: int, own: dict[str, Any], parts: bool = False,
) -> tuple[NDArray[np.float32], dict[str, Any], dict[str, NDArray[Any]]]:  # fmt: skip
    """Add the remainder to `light` (slices, rows, cols), which holds the direct rung and the `ambient` light (slices).

    Returns the background (slices, rows, cols), to which the remainder belongs because its times carry other ranges
    than the pixel's own, except for what finite lens and lamp change: that is the pixel's own light, as is the direct rung's,
    whose truth is `own`; what the capture records of it: samples, standard errors, whether rtol was reached; and truth:
    the standard error of each pixel, what becomes of `own`, and with `parts` the stacks that `light` is the sum of.
    """
    level = ambient.astype(np.float32)[:, None, None]
    slices = Slices(delay_s, scale, gate, gate_offset(scene))
    direct = light - level
    rest = render_remainder(scene, direct, slices, rtol, seed, capture_key, parts=parts)
    background = level + rest.light
    light += rest.light
    if rest.finite is not None:
        background = np.maximum(background - rest.parts["direct"], level)
    # Where a finite lens darkens a pixel to nothing, the difference leaves its noise.
    np.maximum(light, level if rest.finite is None else background, out=light)
    record = {
        "samples_per_pixel": rest.samples,
        "standard_error": rest.epsilon,
        "reached": rest.reached,
        "remainder_electrons": float(rest.amplitude.mean()),
        "remainder_standard_error_electrons": {
            "median": float(np.median(rest.sigma)), "largest": float(rest.sigma.max()),
        },
    }  # fmt: skip
    truth: dict[str, NDArray[Any]] = {"truth_standard_error": rest.sigma}
    if rest.finite is not None:
        truth |= finite_truth(scene, own, rest.finite)
    if parts:
        stacks = rest.parts | {"direct": rest.parts["direct"] + direct}
        if rest.finite is not None:
            stacks["direct"] = light - background
        truth |= {f"truth_{name}": part for name, part in stacks.items()}
    return background, record, truth


class _Run:
    """Sums over rounds, tiles and lanes."""

    def __init__(
        self, scene: Scene, world: PathWorld, slices: Slices, seed: int, key: int, component: str, limits: Limits,
        split: bool = False, grown: float = 0.0,
    ) -> None:  # fmt: skip
        self.world, self.slices, self.component, self.grown = world, slices, component, grown
        self.seed, self.key, self.limits = seed, key, limits
        self.tables = gate_tables(scene)
        self.per_metre_s = world.group_index / C_M_PER_S
        self.window = path_window(scene, self.tables, slices, self.per_metre_s)
        rows, cols = world.rows, world.cols
        self.replicas = int(np.clip(_LANES // (2 * rows * cols), 1, 64))
        self.lanes_per_pixel = 2 * self.replicas
        self.half = np.zeros((2, len(slices.delay_s), rows * cols), dtype=np.float32)
        self.shares = ("interreflection", "multiple") if split else ()
        self.part = {name: np.zeros_like(self.half[0]) for name in self.shares}
        finite = world.finite and component == "all"
        kept = ("direct", "single") if split else ("direct",) if finite else ()
        self.part |= {name: np.zeros_like(self.half[0]) for name in kept}
        self.total, self.squares = np.zeros((2, rows * cols))
        self.shadow = np.zeros((2, rows * cols))
        self.finite = FiniteSums(rows * cols) if finite else None
        self.steepest = max(float(np.abs(t.slope).max() / t.value.max()) for t in self.tables)
        self.steepest *= self.window.width_m * self.per_metre_s
        self.samples = 0
        self.round = 0

    def add(self, samples: int) -> None:
        """One round: `samples` in every lane of every pixel."""
        cols = self.world.cols
        row_bytes = self.lanes_per_pixel * cols * self.window.bins * 3 * 4 * (4 if self.shares else 2)
        tall = max(int(self.limits.memory_bytes // max(row_bytes, 1)) // BLOCK_ROWS, 1) * BLOCK_ROWS
        for top in range(0, self.world.rows, tall):
            rows = range(top, min(top + tall, self.world.rows))
            lanes, pixels = self._lanes(rows), slice(top * cols, rows.stop * cols)
            moments = trace_lanes(
                self.world, lanes, samples, self.window, self.component, bool(self.shares), self.grown
            )
            self._gather(moments, pixels)
            if self.component != "all":
                continue
            if self.world.phase is not None and not self.world.coaxial:
                shadow = trace_lanes(self.world, lanes, samples, self.window, "shadow", grown=self.grown)
                self._gather_signed(shadow, -1.0, "single", pixels)
                for total, lane in zip(self.shadow, (shadow.total, shadow.square), strict=True):
                    total[pixels] += lane.reshape(self.lanes_per_pixel, -1).sum(axis=0, dtype=np.float64)
            if self.finite is not None:
                finite, point, change = trace_finite(self.world, lanes, samples, self.window, self.steepest)
                self._gather_signed(finite, 1.0, "direct", pixels)
                self._gather_signed(point, -1.0, "direct", pixels)
                self.finite.add(change, pixels)
        self.samples += samples * self.lanes_per_pixel
        self.round += 1

    def _lanes(self, rows: range) -> Lanes:
        """Lanes (half, replica, pixel) of some rows; their seeds depend on block, round and place in the block alone."""
        import drjit as dr

        from ..rays.backend import mitsuba

        mi = mitsuba()
        cols, per = self.world.cols, self.lanes_per_pixel
        state: list[NDArray[np.uint64]] = []
        stream: list[NDArray[np.uint64]] = []
        for top in range(rows.start, rows.stop, BLOCK_ROWS):
            tall = min(top + BLOCK_ROWS, rows.stop) - top
            key = (self.key, int(Stage.PATHS), top // BLOCK_ROWS, self.round, COMPONENTS.index(self.component))
            words = sequence(self.seed, key).generate_state(2)
            index = np.arange(per, dtype=np.uint32)[:, None] + per * np.arange(tall * cols, dtype=np.uint32)
            lane = mi.UInt32(index.ravel())
            for word, store in zip(words, (state, stream), strict=True):
                hashed: Any = mi.sample_tea_64(lane, dr.opaque(mi.UInt32, int(word)))
                store.append(np.asarray(hashed.numpy()).reshape(per, tall * cols))
        row = np.tile(np.repeat(np.arange(rows.start, rows.stop, dtype=np.uint32), cols), per)
        col = np.tile(np.arange(cols, dtype=np.uint32), per * len(rows))
        return Lanes(row, col, *(np.concatenate(s, axis=1).ravel() for s in (state, stream)))

    def _gather(self, moments: Moments, pixels: slice) -> None:
        count = pixels.stop - pixels.start
        bins = moments.bins.reshape(3, 2, self.replicas, count, -1, self.window.bins).sum(axis=2)
        for half in range(2):
            self._render(bins[:, half].sum(axis=2), self.half[half], pixels)
        for kind, name in enumerate(self.shares):
            self._render(bins[:, :, :, kind].sum(axis=1), self.part[name], pixels)
        shape = (self.lanes_per_pixel, count)
        self.total[pixels] += moments.total.reshape(shape).sum(axis=0, dtype=np.float64)
        self.squares[pixels] += moments.square.reshape(shape).sum(axis=0, dtype=np.float64)

    def _gather_signed(self, moments: Moments, sign: float, name: str, pixels: slice) -> None:
        """Add light to both halves and to the share of this name, or take it away."""
        bins = moments.bins.reshape(3, 2, self.replicas, pixels.stop - pixels.start, -1).sum(axis=2)
        for half in range(2):
            self._render(bins[:, half], self.half[half], pixels, sign)
            if name in self.part:
                self._render(bins[:, half], self.part[name], pixels, sign)

    def _render(self, bins: NDArray[np.float32], stack: NDArray[np.float32], pixels: slice, sign: float = 1.0) -> None:
        """Add the slices of moments (3, pixels, bins) to a stack (slices, all pixels)."""
        offset = None if self.slices.offset_s is None else self.slices.offset_s[pixels]
        returns = returns_of_moments(bins, self.window, self.world.electrons, self.per_metre_s)
        if not len(returns.tau):
            return
        for number, table in enumerate(self.tables):
            own = np.flatnonzero(self.slices.gate == number)
            part = np.empty((len(own), pixels.stop - pixels.start), dtype=np.float32)
            render_stack(returns, table, self.slices.delay_s[own], self.slices.scale[own], offset, part)
            stack[own, pixels] += np.float32(sign) * part

    def variance(self) -> float:
        """Σ over samples of the stack of the variance of the mean of both halves: E(A − B)²/4."""
        difference = self.half[0] - self.half[1]
        return float(np.sum(np.square(difference, dtype=np.float64))) / (self.samples / 2) ** 2 / 4.0

    def square(self, direct: NDArray[np.float32]) -> float:
        """Σ (direct + remainder)²."""
        whole = direct.reshape(self.half.shape[1:]) + (self.half[0] + self.half[1]) / np.float32(self.samples)
        return float(np.sum(np.square(whole, dtype=np.float64)))

    def finite_light(self) -> FiniteLight | None:
        """What finite lens and lamp change; None where there are none."""
        if self.finite is None:
            return None
        return self.finite.result(self.samples, self.world.electrons, (self.world.rows, self.world.cols))

    def result(self) -> tuple[NDArray[np.float32], Float, Float]:
        """Light; amplitude of the paths; the standard error of these and of the water's shadow, which is drawn with the same
        random numbers: the two standard errors add."""
        shape = (self.world.rows, self.world.cols)
        light = (self.half[0] + self.half[1]) / np.float32(self.samples)
        mean = self.total / self.samples
        variance = np.maximum(self.squares / self.samples - mean**2, 0.0) / self.samples
        total, squares = self.shadow / self.samples
        hidden = np.maximum(squares - total**2, 0.0) / self.samples
        electrons = self.world.electrons
        return (
            light.reshape(-1, *shape),
            (mean * electrons).reshape(shape),
            ((np.sqrt(variance) + np.sqrt(hidden)) * electrons).reshape(shape),
        )
