"""The light of a gated scene, as a design counts it: what one slice at any delay tells of every pixel, and how it misleads.

Own light of a pixel, α R, is the response's closed form. All else, X(t) (what water scatters, and other surfaces), comes from one
generated capture at the asked rung on a grid of delays, and its derivative by the range from `generator.gated.growth`: there all
ranges grow by the same share, so that what others bring to a pixel moves too.

Two models of who reads the stack. `exact` knows X up to its brightness: gradients by range, amplitude and brightness are

    a = (α R' dτ/dr + dX/dr, α R, X + d).

`direct` takes all light for A R + b, as estimators here do, with A and b free. Where X is of another shape its range is wrong by
β, which `pseudo_true` finds; while delays are exchanged it is, to first order about such a fit x, A, b,

    β = x + (F⁻¹ Σ_k J_k a_k (μ_k − m_k))₀,        m = A R + b,    a = (A R' dτ/dr, A R, b),    J_k at m_k.

Its error is √(σ² + β²) with σ of the gradients a.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
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
from .kind import Ask
from .pseudo_true import Fitted, pseudo_true

__all__ = ["PER_WIDTH", "REACH", "Bank", "bank_of"]

Float = npt.NDArray[np.float64]

#: Elements, grid points per width of R, reach of the grid beyond the echoes in widths of R.
_ELEMENTS, PER_WIDTH, REACH = 100, 12, 3.0
#: Two ranges of the window are told apart where they lie so many widths apart; share of pixels with less light than it is asked of.
_APART, _WEAK = 1.0, 0.1
#: Relative errors of the tabulated R, and of the light: a bound is half as wrong.
_RTOL, _LIGHT = 1e-5, 0.02
#: Places of a delay: numbers are kept for each and every element.
_MOST_PLACES = 20_000
#: Places per width of R at which all but the own light is kept.
_COARSE = 4


@dataclass(frozen=True, eq=False)
class Bank:
    """Light of the elements (i) under one gate.

    time_s, slope: of the echo, and its derivative by the range. own, halo: photoelectrons at an open gate and the scene's pulses.
    grid_s (j): places of a delay. still (i, j): all but the own light for the scene's pulses, by delay; dark: of the sensor.
    table: R. pulses: the scene's. moving (i, j): derivative of `still` by the range, per metre; None: it does not move. late_s (i):
    how much later than where it was generated an element's `still` is; None: not at all. misread: what a fit of direct light
    finds, for the scene's pulses.
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
    moving: Float | None = None
    late_s: Float | None = None
    misread: Fitted | None = None

    @property
    def width_s(self) -> float:
        """Standard deviation of R, s."""
        return response_std_s([self.table])

    def parts(self, delay_s: Float, pulses: float, shift_s: Float | float = 0.0, *, exact: bool = True) -> Float:
        """What one slice of so many pulses at each delay tells of each element, `shift_s` later than it is.

        (6, i, j) for `exact`, as of `exchange.profiled_variance`, for (range, amplitude, the rest's brightness); else (9, i, j) as
        of `exchange.expected_square`, of an estimator that takes all light for direct.
        """
        much = pulses / self.pulses
        if not exact:
            return self._misread(delay_s, pulses, shift_s)
        r, rise = self._response(delay_s, shift_s)
        own = much * self.own[:, None]
        still = much * self._at(self.still, delay_s, shift_s) + self.dark
        j = np.asarray(self.information(np.maximum(own * r + still, 1e-9)))
        by_range, by_light = own * self.slope[:, None] * rise, own * r
        if self.moving is not None:
            by_range = by_range + much * self._at(self.moving, delay_s, shift_s)
        return j * np.stack(_products(by_range, by_light, still))

    def _misread(self, delay_s: Float, pulses: float, shift_s: Float | float) -> Float:
        """The nine sums of a fit of direct light, to first order about `misread`, whose bias is in the last three."""
        much, fit = pulses / self.pulses, self.misread
        if fit is None:
            raise ValueError("what is misread is known after `reading`")
        r, rise = self._response(delay_s, shift_s + fit.shift_s[:, None])
        level = (much * fit.level)[:, None] + self.dark
        light = much * fit.light[:, None]
        model = np.maximum(light * r + level, 1e-9)
        left = self.mean(delay_s, pulses, shift_s) - model
        by_range, by_light = light * self.slope[:, None] * rise, light * r
        products = _products(by_range, by_light, np.broadcast_to(level, r.shape))
        off = (fit.shift_s / self.slope)[:, None]
        pulls = [one * left + products[k] * off for k, one in enumerate((by_range, by_light, level))]
        return np.asarray(self.information(model)) * np.stack([*products, *pulls])

    def _response(self, delay_s: Float, shift_s: Float | float) -> tuple[Float, Float]:
        """R (i, j) of light that comes `shift_s` later, and its derivative by time."""
        u = self.time_s[:, None] + shift_s - delay_s
        step = 0.02 * self.width_s
        rise = (correlation.lookup(self.table, u + step) - correlation.lookup(self.table, u - step)) / (2.0 * step)
        return np.maximum(correlation.lookup(self.table, u), 0.0), rise

    def mean(self, delay_s: Float, pulses: float, shift_s: Float | float = 0.0) -> Float:
        """Photoelectrons (i, j) of a slice at each delay."""
        still, r = self._at(self.still, delay_s, shift_s), self._response(delay_s, shift_s)[0]
        return np.maximum(pulses / self.pulses * (self.own[:, None] * r + still) + self.dark, 1e-9)

    def read(self, delay_s: Float, pulses: float, shift_s: Float | float = 0.0) -> Fitted:
        """What a fit of direct light finds in a stack at these delays."""
        time = self.time_s + np.ravel(shift_s)
        mean = self.mean(delay_s, pulses, shift_s)
        return pseudo_true(mean, time, delay_s, self.table, self.width_s, self.information)

    def reading(self, delay_s: Float, pulses: float) -> Bank:
        """The same light, with what is misread in it as at these delays."""
        found, much = self.read(delay_s, pulses), pulses / self.pulses
        shift = np.where(found.settled, found.shift_s, 0.0)
        level = np.maximum(found.level - self.dark, 0.0) / much
        return replace(self, misread=Fitted(shift, found.light / much, level, found.settled))

    def still_at(self, delay_s: Float) -> Float:
        """`still` at any delays (i, k), linear between places."""
        return self._at(self.still, delay_s, 0.0)

    def _at(self, value: Float, delay_s: Float, shift_s: Float | float) -> Float:
        """Values (i, j) by delay, of light that comes `shift_s` later, at any delays (i, k)."""
        count = self.time_s.size
        if value.shape[1] == 1:
            return np.broadcast_to(value, (count, delay_s.size))
        late = np.broadcast_to(np.ravel(shift_s), (count,)) + (0.0 if self.late_s is None else self.late_s)
        return np.stack([np.interp(delay_s - by, self.grid_s, row) for by, row in zip(late, value, strict=True)])

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


def _products(by_range: Float, by_light: Float, level: Float) -> list[Float]:
    return [
        by_range**2, by_range * by_light, by_range * level, by_light**2, by_light * level, level**2,
    ]  # fmt: skip


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
    wide = REACH * width + (0.0 if ask.margin_m is None else ask.margin_m * float(by_range.max()))
    _check_margin(ask.margin_m, float(truth.ravel()[chosen].min()), (np.ptp(t) + 2.0 * wide) * PER_WIDTH / width)
    grid = np.arange(t.min() - wide - top, t.max() + wide - top, width / PER_WIDTH)
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
    """With what the rung adds to the direct light, and its derivative by the range, on a grid of a quarter of R's width."""
    from ...generator.gated.growth import background_growth
    from ...generator.generate import generate

    own = gated_rig(scene).delays.settings_s
    first, last = min(bank.grid_s[0], own.min()), max(bank.grid_s[-1], own.max())
    step = bank.width_s / _COARSE
    coarse = np.arange(first, last + step, step)
    even = {"start_s": float(coarse[0]), "step_s": step, "count": coarse.size}
    held = load_scene(scene, {"rig.delays": even})
    seen = generate(held, seed=ask.seed, fidelity=ask.fidelity, rtol=_LIGHT)
    background = np.asarray(seen["truth_background"].values, np.float64)
    traced = json.loads(seen.attrs["fidelity"])
    rung = traced["rung"]
    if background.ndim == 1 or rung == "direct":  # nothing scatters here, or "auto" chose so
        return bank
    still = background.reshape(coarse.size, -1)[:, chosen].T - bank.dark
    grown = background_growth(
        held, rung, seed=ask.seed, key=int(seen.attrs["capture_key"]), rtol=_LIGHT,
        samples=traced.get("samples_per_pixel", 0),
    )  # fmt: skip
    range_m = np.asarray(seen["truth_range"].values, np.float64).ravel()[chosen]
    moving = grown.by_share.reshape(coarse.size, -1)[:, chosen].T / range_m[:, None]
    halo = halo_of(seen).ravel()[chosen]
    return replace(bank, halo=halo, grid_s=coarse, still=np.maximum(still, 0.0), moving=moving)
