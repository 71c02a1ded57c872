"""Design of a range-gated measurement: number and places of the delays, and the width of the gate, for so many pulses in all.

The light of every pixel, α at an open gate and what stands still beside it, comes from one generated capture at the asked rung; the
response R and the likelihood are those of `bounds.gated`. Pixels, each at its own range and `margin` nearer and farther, are the
elements; delays are found by exchange on a grid of a twelfth of R's width.

Ambiguity. With the echo at θ and at θ' and amplitude and background free, two stacks differ by

    d²(θ, θ') = min_{α', b'} Σ_k J(μ_k) (μ_k(θ) − α' R(θ' − t_k) − b')²,

and are taken for each other with a probability of about Q(d/2) (Ziv and Zakai 1969). A design is ambiguous where d falls below six
(Q(3) = .1 %) for two ranges of the window that are a width of R or more apart (nearer, the bound tells), and light as of the
weakest tenth of the pixels.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...optics.correlation import response as correlation
from ...optics.likelihood.fisher_table import InformationTable, information_table
from ...scenes.errors import InputError
from ...scenes.load import load_scene
from ...scenes.medium_index import group_index
from ...scenes.rigs.gated import gated_rig
from ...scenes.scene import Scene
from ..bounds.gated_instrument import gate_offsets, gated_responses, halo_of, noise_model, path_delay
from ..bounds.instrument import response_std_s
from .exchange import exchanged, profiled_variance
from .kind import Ask, Curve, Designs, Knob, Option

__all__ = ["DESIGNS", "Bank", "bank_of"]

Float = npt.NDArray[np.float64]

#: Elements, grid points per width of R, reach of the grid beyond the echoes in widths of R.
_ELEMENTS, _PER_WIDTH, _REACH = 100, 12, 3.0
#: Least distance d of two ranges that are `_APART` widths apart, and the share of pixels with less light than it is asked of.
_LEAST, _APART, _WEAK = 6.0, 1.0, 0.1
#: Weights of a window without prior knowledge beside the pixels, tried in turn until a design is not ambiguous.
_SPREAD = (0.0, 0.02, 0.1, 0.5)
_SLICES = (4, 6, 8, 12, 16, 24, 32)
#: Relative errors of the tabulated R, and of the light: a bound is half as wrong.
_RTOL, _LIGHT = 1e-5, 0.02
#: Places of a delay: six numbers are kept for each and every element.
_MOST_PLACES = 20_000


@dataclass(frozen=True, eq=False)
class Bank:
    """Light of the elements (i) under one gate.

    time_s, slope: of the echo, and its derivative by the range. own, halo: photoelectrons at an open gate and the scene's pulses.
    grid_s (j): places of a delay. still (i, j): what stands still beside them for the scene's pulses; dark: of the sensor.
    table: R. pulses: the scene's.
    """

    time_s: Float
    slope: Float
    own: Float
    halo: Float
    grid_s: Float
    still: Float
    dark: float
    table: correlation.Table
    information: InformationTable
    pulses: int

    @property
    def width_s(self) -> float:
        """Standard deviation of R, s."""
        return response_std_s([self.table])

    def parts(self, delay_s: Float, pulses: float, shift_s: Float | float = 0.0) -> Float:
        """(6, i, j): what one slice of so many pulses at each delay tells of each element, `shift_s` later than it is; as of
        `exchange.profiled_variance` for (range, amplitude, background)."""
        much = pulses / self.pulses
        u = self.time_s[:, None] + shift_s - delay_s
        r = np.maximum(correlation.lookup(self.table, u), 0.0)
        step = 0.02 * self.width_s
        rise = (correlation.lookup(self.table, u + step) - correlation.lookup(self.table, u - step)) / (2.0 * step)
        whole = much * (self.own + self.halo)[:, None]
        still = much * self.still_at(delay_s) + self.dark
        j = np.asarray(self.information(np.maximum(whole * r + still, 1e-9)))
        by_range, by_light = whole * self.slope[:, None] * rise, much * r
        # Beside a halo what stands still cannot be told from the halo's late tail: it is taken as known, as in `bounds.gated`.
        level = np.where(self.halo[:, None] > 0, 0.0, still)
        return np.stack([
            j * by_range**2, j * by_range * by_light, j * by_range * level, j * by_light**2, j * by_light * level, j * level**2,
        ])  # fmt: skip

    def still_at(self, delay_s: Float) -> Float:
        """`still` at any delays (i, k), linear between places."""
        if self.still.shape[1] == 1:
            return np.broadcast_to(self.still, (self.still.shape[0], delay_s.size))
        return np.stack([np.interp(delay_s, self.grid_s, row) for row in self.still])

    def distance(self, delay_s: Float, pulses: float, margin_m: float) -> float:
        """The least d of two ranges of the window that lie `_APART` widths apart, for light as of the weakest tenth."""
        much = pulses / self.pulses
        reach = margin_m * float(self.slope.max())
        low, high = self.time_s.min() - reach, self.time_s.max() + reach
        theta = np.linspace(low, high, max(int(3 * (high - low) / self.width_s), 2) + 1)
        light = much * float(np.quantile(self.own + self.halo, _WEAK))
        r = np.maximum(correlation.lookup(self.table, theta[:, None] - delay_s), 0.0)
        still = much * np.median(self.still_at(delay_s), axis=0) + self.dark
        mu = light * r + still
        j = np.asarray(self.information(np.maximum(mu, 1e-9)))
        apart = np.abs(theta[:, None] - theta) >= _APART * self.width_s
        if not apart.any():
            return math.inf
        # Least squares of μ(θ) by R(θ' − t) and a constant, each pair on its own.
        s_rr, s_r1, s_11 = j @ (r**2).T, j @ r.T, j.sum(axis=1)[:, None]
        s_mr, s_m1, s_mm = (j * mu) @ r.T, (j * mu).sum(axis=1)[:, None], (j * mu**2).sum(axis=1)[:, None]
        det = s_rr * s_11 - s_r1**2
        with np.errstate(divide="ignore", invalid="ignore"):
            a = np.where(det > 1e-9 * s_rr * s_11, (s_mr * s_11 - s_m1 * s_r1) / det, 0.0)
        a = np.maximum(a, 0.0)
        b = (s_m1 - a * s_r1) / s_11
        left = s_mm - 2.0 * (a * s_mr + b * s_m1) + a**2 * s_rr + 2.0 * a * b * s_r1 + b**2 * s_11
        return float(np.sqrt(np.maximum(left, 0.0))[apart].min())


def bank_of(scene: Scene, ask: Ask, gate: Mapping[str, Any]) -> Bank:
    """The light of the elements of a scene under a gate."""
    from ...generator.generate import generate

    held_scene = load_scene(scene, {"rig.gates": [dict(gate)]})
    rig = gated_rig(held_scene)
    table = gated_responses(rig, _RTOL)[0]
    width = response_std_s([table])
    # Two delays are enough: the light of every pixel is in the truth. In the middle of the window they see some.
    two = {"start_s": float(np.median(rig.delays.settings_s)), "step_s": 0.5 * width, "count": 2}
    lamp = generate(load_scene(held_scene, {"rig.delays": two}), seed=ask.seed, rtol=_LIGHT)
    chosen = _elements(lamp, ask.seed)
    truth = np.asarray(lamp["truth_range"].values, np.float64)
    time, slope = path_delay(truth, rig, group_index(scene.medium, rig.laser.wavelength_m))
    time = time - gate_offsets(rig, (truth.shape[0], truth.shape[1])) - rig.t0_s
    t, by_range, own = (
        np.asarray(a, np.float64).ravel()[chosen] for a in (time, slope, lamp["truth_amplitude"].values)
    )
    # An echo at t is seen by delays about t − u, u where R is greatest.
    top = table.start_s + table.step_s * float(np.argmax(table.value))
    wide = _REACH * width + (0.0 if ask.margin_m is None else ask.margin_m * float(by_range.max()))
    _check_margin(ask.margin_m, float(truth.ravel()[chosen].min()), (np.ptp(t) + 2.0 * wide) * _PER_WIDTH / width)
    grid = np.arange(t.min() - wide - top, t.max() + wide - top, width / _PER_WIDTH)
    detector = rig.detector
    dark = detector.dark_current_e_per_s * detector.exposure_s if detector.intensifier is None else 0.0
    bank = Bank(
        t, by_range, own, np.zeros(t.size), grid[:1], np.full((t.size, 1), _ambient(lamp, dark)), dark, table,
        information_table(noise_model(rig)), rig.pulses_per_slice,
    )  # fmt: skip
    bank = replace(bank, grid_s=grid)
    return bank if ask.fidelity in (None, "direct") else _traced(held_scene, ask, bank, chosen)


def _check_margin(margin_m: float | None, nearest_m: float, places: float) -> None:
    """Refuse a margin that brings the target to the camera, and a window too long to be searched. Raises InputError."""
    if margin_m is not None and margin_m >= nearest_m:
        raise InputError(
            "The margin brings the target to the camera.", where="margin_m", value=margin_m,
            allowed=f"below {nearest_m:.6g} m, the range of the nearest pixel",
        )  # fmt: skip
    if places > _MOST_PLACES:
        raise InputError(
            "The window is too long for this response: delays are looked for at each twelfth of its width.", where="margin_m",
            value=margin_m, allowed=f"up to {_MOST_PLACES} places, here {places:.3g}",
            next_step="choose a smaller margin, a wider gate, or a scene of less depth",
        )  # fmt: skip


def _ambient(lamp: xr.Dataset, dark: float) -> float:
    """Ambient photoelectrons of a slice of the scene's pulses."""
    return float(np.median(np.asarray(lamp["truth_background"].values, np.float64))) - dark


def _elements(lamp: xr.Dataset, seed: int) -> npt.NDArray[np.intp]:
    """Indices of some pixels that see one surface and some light. Raises InputError for a scene without any."""
    lit = np.asarray(lamp["truth_amplitude"].values, np.float64)
    good = np.isfinite(lamp["truth_range"].values) & (lit > 0) & ~np.asarray(lamp["truth_mixed"].values, bool)
    found = np.flatnonzero(good)
    if not found.size:
        raise InputError(
            "No pixel sees one lit surface: there is nothing to design for.", where="design", value=0, allowed="1 or more",
            next_step="beambench scenes preview SCENE",
        )  # fmt: skip
    return np.sort(np.random.default_rng(seed).choice(found, min(_ELEMENTS, found.size), replace=False))


def _traced(scene: Scene, ask: Ask, bank: Bank, chosen: npt.NDArray[np.intp]) -> Bank:
    """With what the rung adds to the direct light: a halo, and what stands still against the pixel's own range, at every place of a
    delay on a grid of a quarter of R's width."""
    from ...generator.generate import generate

    coarse = np.arange(bank.grid_s[0], bank.grid_s[-1] + bank.width_s, bank.width_s / 4.0)
    even = {"start_s": float(coarse[0]), "step_s": bank.width_s / 4.0, "count": coarse.size}
    seen = generate(
        load_scene(scene, {"rig.delays": even}), seed=ask.seed, fidelity=ask.fidelity, rtol=_LIGHT, truth_electrons=True
    )
    light = np.asarray(seen["truth_electrons"].values, np.float64).reshape(coarse.size, -1)[:, chosen].T - bank.dark
    halo = halo_of(seen).ravel()[chosen]
    r = np.maximum(correlation.lookup(bank.table, bank.time_s[:, None] - coarse), 0.0)
    still = np.maximum(light - (bank.own + halo)[:, None] * r, 0.0)
    return replace(bank, halo=halo, grid_s=coarse, still=still)


def _knobs(scene: Scene) -> Sequence[Knob]:
    rig = gated_rig(scene)
    own = rig.delays.count * rig.delays.repeats * len(rig.gates)
    count = tuple(float(k) for k in _SLICES if k <= max(own, _SLICES[0]))
    width = _width(rig.gates[0].model_dump(mode="json"))
    return (
        Knob("slices", "1", "number of slices; pulses per slice follow from their sum", count),
        Knob("gate-width", "s", "width of the gate", () if width is None else (width[1],)),
    )


def _width(gate: Mapping[str, Any]) -> tuple[str, float] | None:
    """(name, value [s]) of the width of a gate that has one."""
    return next(((name, float(gate[name])) for name in ("width_s", "fwhm_s") if name in gate), None)


@dataclass(frozen=True, eq=False)
class _Posed:
    """Elements under one gate: each pixel at its own range and `margin` nearer and farther, and ranges over the window."""

    bank: Bank
    margin_m: float

    def parts(self, delay_s: Float, pulses: float) -> Float:
        """As `Bank.parts`, of the pixels (3i, j)."""
        shifts = (0.0,) if self.margin_m == 0 else (-self.margin_m, 0.0, self.margin_m)
        return np.concatenate(
            [self.bank.parts(delay_s, pulses, (one * self.bank.slope)[:, None]) for one in shifts], axis=1
        )

    def window(self) -> Bank:
        """Ranges that lie evenly over the window, of the median light."""
        bank, reach = self.bank, self.margin_m * float(self.bank.slope.max())
        theta = np.linspace(bank.time_s.min() - reach, bank.time_s.max() + reach, 41)
        every = np.ones(theta.size)
        still = np.median(bank.still, axis=0)[None] * every[:, None]
        return replace(
            bank, time_s=theta, slope=every * np.median(bank.slope), own=every * np.median(bank.own),
            halo=every * np.median(bank.halo), still=still,
        )  # fmt: skip

    def rms(self, delay_s: Float, pulses: float) -> float:
        """Rms bound over the pixels, m."""
        return float(np.sqrt(profiled_variance(self.parts(delay_s, pulses).sum(axis=2)).mean()))


def _options(scene: Scene, ask: Ask) -> tuple[list[Option], Curve]:
    rig = gated_rig(scene)
    gates = [gate.model_dump(mode="json") for gate in rig.gates]
    every = rig.delays.repeats * rig.delays.count
    total = ask.budget * rig.pulses_per_slice * every * len(gates)
    first = bank_of(scene, ask, gates[0])
    margin = ask.margin_m
    if margin is None:
        margin = 0.5 * first.width_s / float(np.median(first.slope))
        ask = replace(ask, margin_m=margin)
    banks = {_key(gate): _Posed(bank_of(scene, ask, gate), margin) for gate in gates}
    settings = np.repeat(rig.delays.settings_s, rig.delays.repeats)
    own = _own(banks, gates, settings, ask.budget * rig.pulses_per_slice, every)
    found = [own]
    widths = ask.values.get("gate-width", ())
    allowed = [_with_width(gates[0], width) for width in widths] or gates[:1]
    lines: dict[str, Float] = {own.name: settings}
    for gate in allowed:
        posed = banks.setdefault(_key(gate), _Posed(bank_of(scene, ask, gate), margin))
        for count in ask.values["slices"]:
            even = np.linspace(settings.min(), settings.max(), int(count))
            tight = _tight(posed, int(count))
            for kind, delay in (("even", even), ("tight", tight), ("chosen", _chosen(posed, int(count), total))):
                option = _option(scene, posed, kind, delay, total, gate)
                found.append(option)
                lines[option.name] = delay
    best = min((one for one in found[1:] if one.allowed), key=lambda one: one.bound, default=own)
    used = banks[_key(best.overrides["rig.gates"][0] if best.overrides else gates[0])].bank
    return found, _curve(used, lines, {own.name, best.name})


def _tight(posed: _Posed, count: int) -> Float:
    """Even delays over the echoes alone, and two widths of R beyond them: what somebody sets who knows the ranges [s]."""
    grid, beyond = posed.bank.grid_s, (_REACH - 2.0) * posed.bank.width_s
    return np.linspace(grid[0] + beyond, grid[-1] - beyond, count)


def _key(gate: Mapping[str, Any]) -> str:
    return json.dumps(gate, sort_keys=True)


def _with_width(gate: Mapping[str, Any], width_s: float) -> dict[str, Any]:
    """A gate of another width. Raises InputError for one that has no single width."""
    held = _width(gate)
    if held is None:
        raise InputError(
            "The gate of this scene has no single width.", where="allow: gate-width", value=str(gate.get("kind")),
            allowed="rectangular, trapezoidal, gaussian",
        )  # fmt: skip
    return {**gate, held[0]: width_s}


def _own(
    banks: Mapping[str, _Posed], gates: Sequence[Mapping[str, Any]], delay: Float, pulses: float, every: int
) -> Option:
    """The scene's own design: every gate at every delay."""
    total: Any = 0.0
    guard = []
    for gate in gates:
        posed = banks[_key(gate)]
        total = total + posed.parts(delay, pulses).sum(axis=2)
        guard.append(posed.bank.distance(delay, pulses, posed.margin_m))
    bound = float(np.sqrt(profiled_variance(total).mean()))
    settings = {"slices": float(every * len(gates)), "pulses": pulses}
    return Option("the scene's own", settings, {}, bound, max(guard))


def _chosen(posed: _Posed, count: int, total: float) -> Float:
    """Delays of least mean square bound that are not ambiguous, or the last that was tried [s]."""
    pulses = max(math.floor(total / count), 1)
    grid = np.arange(posed.bank.grid_s[0], posed.bank.grid_s[-1], posed.bank.width_s / _PER_WIDTH)
    pixels, window = posed.parts(grid, pulses), posed.window().parts(grid, pulses)
    parts = np.concatenate([pixels, window], axis=1)
    start = np.linspace(0, grid.size - 1, count + 2)[1:-1].astype(np.int64)
    at = start
    for spread in _SPREAD:
        share = [np.full(pixels.shape[1], (1.0 - spread) / pixels.shape[1]), np.full(41, spread / 41)]
        at = min((exchanged(parts, np.concatenate(share), one) for one in (start, at)), key=lambda pair: pair[1])[0]
        if posed.bank.distance(grid[at], pulses, posed.margin_m) >= _LEAST:
            break
    rounded: Float = np.round(grid[at], 12).astype(np.float64)
    return rounded


def _option(scene: Scene, posed: _Posed, kind: str, delay: Float, total: float, gate: Mapping[str, Any]) -> Option:
    pulses = math.floor(total / delay.size)
    width = _width(gate)
    settings = {"slices": float(delay.size), "pulses": float(pulses)} | (
        {} if width is None else {"gate-width": width[1]}
    )
    name = f"{kind} {delay.size}" + ("" if width is None else f", gate {1e9 * width[1]:.3g} ns")
    overrides: dict[str, Any] = {
        "rig.delays": {"kind": "listed", "values_s": [float(one) for one in delay]}, "rig.pulses_per_slice": pulses,
        "rig.gates": [dict(gate)],
    }  # fmt: skip
    if pulses < 1:
        return Option(name, settings, overrides, math.inf, 0.0, "fewer pulses than slices")
    guard = posed.bank.distance(delay, pulses, posed.margin_m)
    why = "" if guard >= _LEAST else "ambiguous"
    try:
        load_scene(scene, overrides)
    except InputError as error:
        why = error.what
    return Option(name, settings, overrides, posed.rms(delay, pulses), guard, why)


def _curve(bank: Bank, lines: Mapping[str, Float], shown: set[str]) -> Curve:
    """R against the delay for the element in the middle of the window, and the delays of the designs shown."""
    middle = float(np.median(bank.time_s))
    grid = np.linspace(bank.grid_s[0], bank.grid_s[-1], 400)
    r = np.maximum(correlation.lookup(bank.table, middle - grid), 0.0)
    marks = {name: 1e9 * delay for name, delay in lines.items() if name in shown}
    return Curve(1e9 * grid, r, "delay [ns]", "response of the middle range", marks)


DESIGNS = Designs(
    knobs=_knobs, options=_options, quantity="range", shown=(1e3, "mm"),
    guard="least distance of two ranges of the window, in standard deviations: 6 or more",
)  # fmt: skip
