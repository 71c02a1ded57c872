"""Design of a range-gated measurement: number and places of the delays, and the width of the gate, for so many pulses in all.

The light of every pixel comes from a generated capture at the asked rung (`gated_light`); response R and likelihood are those of
`bounds.gated`. What is made least is the error of an estimator that takes all light for direct, bias and noise, or with
the model `exact` the bound of one that knows the rest. Pixels, each at its own range and `margin` nearer and farther, are the
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

from ...optics.correlation import response as correlation
from ...scenes.errors import InputError
from ...scenes.load import load_scene
from ...scenes.rigs.gated import gated_rig
from ...scenes.scene import Scene
from .exchange import bias_square, exchanged, profiled_variance
from .gated_light import PER_WIDTH, REACH, Bank, bank_of
from .kind import Ask, Curve, Designs, Knob, Option, Steps
from .pseudo_true import Fitted

__all__ = ["DESIGNS"]

Float = npt.NDArray[np.float64]

#: Least distance d of two ranges.
_LEAST = 6.0
#: Weights of a window without prior knowledge beside the pixels, tried in turn until a design is not ambiguous.
_SPREAD = (0.0, 0.02, 0.1, 0.5)
_SLICES = (4, 6, 8, 12, 16, 24, 32)
#: Ranges over the window.
_WINDOW = 41
#: Delays of the first fit, and how often delays are exchanged again about the fit to those found.
_DENSE, _AGAIN = 24, 3


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
    """Elements under one gate: each pixel at its own range and `margin` nearer and farther, and ranges over the window. `exact`:
    who reads knows all light (`gated_light`)."""

    bank: Bank
    margin_m: float
    exact: bool

    def parts(self, delay_s: Float, pulses: float) -> Float:
        """As `Bank.parts`, of the pixels (3i, j)."""
        each = [self._parts(self.bank, delay_s, pulses, one * self.bank.slope) for one in self._shifts()]
        return np.concatenate(each, axis=1)

    def over_window(self, delay_s: Float, pulses: float) -> Float:
        """As `Bank.parts`, of ranges that lie evenly over the window, of the median light."""
        bank, reach = self.bank, self.margin_m * float(self.bank.slope.max())
        theta = np.linspace(bank.time_s.min() - reach, bank.time_s.max() + reach, _WINDOW)
        every = np.ones(theta.size)
        middle = int(np.argsort(bank.time_s)[bank.time_s.size // 2])
        window = replace(
            bank, time_s=theta, slope=every * np.median(bank.slope), own=every * np.median(bank.own),
            halo=every * np.median(bank.halo), still=every[:, None] * bank.still[middle],
            moving=None if bank.moving is None else every[:, None] * bank.moving[middle],
            late_s=theta - bank.time_s[middle], misread=_same(bank.misread, middle, theta.size),
        )  # fmt: skip
        return self._parts(window, delay_s, pulses, every * 0.0)

    def _parts(self, bank: Bank, delay_s: Float, pulses: float, shift_s: Float) -> Float:
        # Direct light over a level is what both models say.
        exact = self.exact or bank.moving is None
        return bank.parts(delay_s, pulses, shift_s[:, None], exact=exact)

    @property
    def misread(self) -> bool:
        """Whether who reads lacks some of the light."""
        return not self.exact and self.bank.moving is not None

    def about(self, delay_s: Float, pulses: float) -> _Posed:
        """The same, for designs near these delays."""
        return replace(self, bank=self.bank.reading(delay_s, pulses)) if self.misread else self

    def errors(self, delay_s: Float, pulses: float) -> tuple[float, float]:
        """(rms bound, rms bias) over the pixels, m; a bias is infinite where no fit settles."""
        sums = self.about(delay_s, pulses).parts(delay_s, pulses).sum(axis=2)
        bound = float(np.sqrt(profiled_variance(sums[:6]).mean()))
        if not self.misread:
            return bound, 0.0
        found = [self.bank.read(delay_s, pulses, (one * self.bank.slope)[:, None]) for one in self._shifts()]
        wrong = [np.where(each.settled, each.shift_s / self.bank.slope, np.inf) for each in found]
        return bound, float(np.sqrt(np.square(wrong).mean()))

    def _shifts(self) -> tuple[float, ...]:
        return (0.0,) if self.margin_m == 0 else (-self.margin_m, 0.0, self.margin_m)


def _same(fit: Fitted | None, of: int, count: int) -> Fitted | None:
    """The fit of one element for so many."""
    if fit is None:
        return None
    return Fitted(*(np.full(count, one[of]) for one in (fit.shift_s, fit.light, fit.level, fit.settled)))


def _options(scene: Scene, ask: Ask) -> tuple[list[Option], Curve]:
    rig = gated_rig(scene)
    gates = [gate.model_dump(mode="json") for gate in rig.gates]
    widths = ask.values.get("gate-width", ())
    allowed = [_with_width(gates[0], width) for width in widths] or gates[:1]
    every = rig.delays.repeats * rig.delays.count
    total = ask.budget * rig.pulses_per_slice * every * len(gates)
    counts = ask.values["slices"]
    unique = {_key(gate): gate for gate in (*gates, *allowed)}
    step = Steps(ask.progress, len(unique) + len(allowed) * len(counts))
    margin, banks = ask.margin_m, dict[str, _Posed]()
    for key, gate in unique.items():
        step("light of the scene")
        held = bank_of(scene, replace(ask, margin_m=margin), gate)
        if margin is None:
            margin = 0.5 * held.width_s / float(np.median(held.slope))
            held = bank_of(scene, replace(ask, margin_m=margin), gate)
        banks[key] = _Posed(held, margin, ask.model == "exact")
    settings = np.repeat(rig.delays.settings_s, rig.delays.repeats)
    own = _own(banks, gates, settings, ask.budget * rig.pulses_per_slice, every)
    found = [own]
    lines: dict[str, Float] = {own.name: settings}
    for gate in allowed:
        posed = banks[_key(gate)]
        for count in counts:
            step(f"{int(count)} slices")
            even = np.linspace(settings.min(), settings.max(), int(count))
            tight = _tight(posed, int(count))
            for kind, delay in (("even", even), ("tight", tight), ("chosen", _chosen(posed, int(count), total))):
                option = _option(scene, posed, kind, delay, total, gate)
                found.append(option)
                lines[option.name] = delay
    best = min((one for one in found[1:] if one.allowed), key=lambda one: one.error, default=own)
    used = banks[_key(best.overrides["rig.gates"][0] if best.overrides else gates[0])].bank
    return found, _curve(used, lines, {own.name, best.name})


def _tight(posed: _Posed, count: int) -> Float:
    """Even delays over the echoes alone, and two widths of R beyond them: what somebody sets who knows the ranges [s]."""
    grid, beyond = posed.bank.grid_s, (REACH - 2.0) * posed.bank.width_s
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
        total = total + posed.about(delay, pulses).parts(delay, pulses).sum(axis=2)
        guard.append(posed.bank.distance(delay, pulses, posed.margin_m))
    bound, bias = float(np.sqrt(profiled_variance(total[:6]).mean())), 0.0
    if len(gates) == 1:
        bound, bias = banks[_key(gates[0])].errors(delay, pulses)
    elif len(total) == 9:  # one fit to several responses: to first order
        bias = float(np.sqrt(bias_square(total)[1].mean()))
    settings = {"slices": float(every * len(gates)), "pulses": pulses}
    return Option("the scene's own", settings, {}, bound, max(guard), bias=bias)


def _chosen(posed: _Posed, count: int, total: float) -> Float:
    """Delays of least mean square bound that are not ambiguous, or the last that was tried [s]."""
    pulses = max(math.floor(total / count), 1)
    grid = np.arange(posed.bank.grid_s[0], posed.bank.grid_s[-1], posed.bank.width_s / PER_WIDTH)
    known = posed.about(np.linspace(grid[0], grid[-1], max(count, _DENSE)), pulses)
    found = _exchanged(known, posed, grid, count, pulses)
    for _ in range(_AGAIN if posed.misread else 0):  # what is misread depends on the design
        other = _exchanged(posed.about(grid[found], pulses), posed, grid, count, pulses)
        if math.hypot(*posed.errors(grid[other], pulses)) >= math.hypot(*posed.errors(grid[found], pulses)):
            break
        found = other
    rounded: Float = np.round(grid[found], 12).astype(np.float64)
    return rounded


def _exchanged(known: _Posed, posed: _Posed, grid: Float, count: int, pulses: int) -> npt.NDArray[np.int64]:
    """Places on the grid, by what is known about designs near one."""
    pixels, window = known.parts(grid, pulses), known.over_window(grid, pulses)
    parts = np.concatenate([pixels, window], axis=1)
    start = np.linspace(0, grid.size - 1, count + 2)[1:-1].astype(np.int64)
    at = start
    for spread in _SPREAD:
        share = [np.full(pixels.shape[1], (1.0 - spread) / pixels.shape[1]), np.full(_WINDOW, spread / _WINDOW)]
        at = min((exchanged(parts, np.concatenate(share), one) for one in (start, at)), key=lambda pair: pair[1])[0]
        if posed.bank.distance(grid[at], pulses, posed.margin_m) >= _LEAST:
            break
    return at


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
    bound, bias = posed.errors(delay, pulses)
    return Option(name, settings, overrides, bound, guard, why, bias)


def _curve(bank: Bank, lines: Mapping[str, Float], shown: set[str]) -> Curve:
    """R against the delay for the element in the middle of the window, and the delays of the designs shown."""
    middle = float(np.median(bank.time_s))
    grid = np.linspace(bank.grid_s[0], bank.grid_s[-1], 400)
    r = np.maximum(correlation.lookup(bank.table, middle - grid), 0.0)
    marks = {name: 1e9 * delay for name, delay in lines.items() if name in shown}
    return Curve(1e9 * grid, r, "delay [ns]", "response of the middle range", marks)


DESIGNS = Designs(
    knobs=_knobs, options=_options, quantity="range", shown=(1e3, "mm"),
    guard="least distance of two ranges of the window, in standard deviations: 6 or more", models=("direct", "exact"),
)  # fmt: skip
