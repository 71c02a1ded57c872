"""Which pixels of a gated capture are regular, decided from rig and truth before anything is estimated.

A pixel is regular where its Cramér-Rao bound is what an estimator can reach: the Ziv-Zakai bound at its delay within
1.05 of it on either side, and wrong cells adding less than that (`ziv_zakai.LocalBound.regular`). One table per rig over
(delay, ln amplitude, ln background) is filled once and looked up per pixel. The stack's background keeps the capture's
mean shape over slices; its level is the pixel's. Amplitude and background are taken as known; profiling them moves the
threshold little (for echoes apart the test is the same) and the edges of the window much, where `gated_bound` tells it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...optics import correlation, waveforms
from ...optics.constants import C_M_PER_S
from ...optics.fisher_table import information_table
from ...scenes.declare import group_index, optics_gate, optics_pulse
from ...scenes.errors import InputError
from ...scenes.rig import GatedRig
from ...scenes.scene import gated_rig
from ..score import Bound
from .bayes import posterior_bound
from .gated import _offsets, _path, _true_delay, noise_model, response_std_s, true_scene
from .ziv_zakai import REACHED, REGULAR, Arc, curvature, local_bound

__all__ = ["ThresholdTable", "is_regular", "threshold_bound", "threshold_table"]

Float = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]

_PER_WIDTH = 6.0  # delays per σ_R; Gaussian and rectangular R alike are resolved by closed forms between them
_BAYES_PER_WIDTH = 16.0  # finer: the grid must resolve the posterior
_BAYES_DRAWS = 1500
_MOST_DELAYS = 3601
_AMPLITUDE_STEP = 0.25  # of ln α: the threshold is some 1.5 wide
_BACKGROUND_STEP = 0.7


@dataclass(frozen=True)
class ThresholdTable:
    """Over (delay, ln α, ln β): ln of ε/CRB, of the predicted excess of maximum likelihood, and of ε [s].

    Axes are even; outside them the nearest value holds, beyond the delays nothing is regular.
    """

    delay_s: Float
    log_amplitude: Float
    log_background: Float
    log_ratio: Float
    log_excess: Float
    log_epsilon_s: Float

    def _at(self, values: Float, delay: Float, amplitude: Float, background: Float) -> Float:
        axes = (self.delay_s, self.log_amplitude, self.log_background)
        return _lookup(axes, values, (delay, amplitude, background))

    def regular(self, delay_s: npt.ArrayLike, amplitude: npt.ArrayLike, background: npt.ArrayLike) -> Bool:
        """Whether delays (of the echo at the camera, s) are regular at these amplitudes and mean backgrounds."""
        delay, a, b = self._axes(delay_s, amplitude, background)
        ratio, excess = self._at(self.log_ratio, delay, a, b), self._at(self.log_excess, delay, a, b)
        inside = (delay >= self.delay_s[0]) & (delay <= self.delay_s[-1]) & (a >= self.log_amplitude[0] - 1e-9)
        return np.asarray(inside & (np.abs(ratio) <= math.log(REGULAR)) & (excess <= math.log(REACHED)))

    def epsilon_s(self, delay_s: npt.ArrayLike, amplitude: npt.ArrayLike, background: npt.ArrayLike) -> Float:
        """ε(θ), s: its mean square over delays is the Ziv-Zakai bound."""
        delay, a, b = self._axes(delay_s, amplitude, background)
        return np.asarray(np.exp(self._at(self.log_epsilon_s, delay, a, b)))

    @staticmethod
    def _axes(delay: npt.ArrayLike, amplitude: npt.ArrayLike, background: npt.ArrayLike) -> tuple[Float, Float, Float]:
        with np.errstate(divide="ignore", invalid="ignore"):
            logs = (np.log(np.asarray(amplitude, np.float64)), np.log(np.asarray(background, np.float64)))
        d, a, b = np.broadcast_arrays(np.asarray(delay, np.float64), *logs)
        return d, a, b


def _lookup(axes: Sequence[Float], values: Float, points: Sequence[Float]) -> Float:
    """Linear in every axis; the nearest value outside."""
    shape = points[0].shape
    corners: list[tuple[tuple[npt.NDArray[np.intp], ...], Float]] = [((), np.ones(shape))]
    for axis, x in zip(axes, points, strict=True):
        if axis.size == 1:
            corners = [((*at, np.zeros(shape, np.intp)), weight) for at, weight in corners]
            continue
        place = np.clip(np.nan_to_num((x - axis[0]) / (axis[1] - axis[0])), 0.0, axis.size - 1.0)
        i = np.minimum(place.astype(np.intp), axis.size - 2)
        f = place - i
        corners = [
            ((*at, k), weight * part) for at, weight in corners for k, part in ((i, 1.0 - f), (i + 1, f))
        ]  # fmt: skip
    return np.asarray(sum(weight * values[at] for at, weight in corners))


def _grid(values: Float, step: float) -> Float:
    """An even grid of logarithms that covers positive finite values."""
    good = values[np.isfinite(values) & (values > 0)]
    if good.size == 0:
        return np.zeros(1)
    low, high = math.log(float(good.min())), math.log(float(good.max()))
    count = math.ceil((high - low) / step)
    return np.linspace(low, high, count + 1) if count else np.array([low])


@dataclass(frozen=True)
class _Stack:
    """R and two derivatives (delay, slice) on an even grid of delays over the window, and the background's shape."""

    delay_s: Float
    width_s: float
    r: Float
    slope: Float
    bend: Float
    share: Float
    level: Float


def _stack(capture: xr.Dataset, per_width: float) -> _Stack:
    rig = gated_rig(true_scene(capture))
    if "truth_amplitude" not in capture or "truth_background" not in capture:
        raise InputError("The capture does not tell its amplitudes.", where="truth_amplitude, truth_background")
    tables = _responses(rig)
    delay, gate, share, level = _slices(capture, rig)
    width = response_std_s(tables)
    centroid = float(np.mean([_centroid(table) for table in tables]))
    window = float(delay.max() - delay.min()) + math.sqrt(12.0) * width
    count = math.ceil(per_width * window / width) + 1
    if count > _MOST_DELAYS:
        raise InputError(
            "The window holds too many widths of the response to search it for wrong cells.", where="rig.delays",
            value=round(window / width), allowed=f"up to {_MOST_DELAYS / per_width:.0f}",
        )  # fmt: skip
    theta = np.linspace(-0.5, 0.5, count) * window + 0.5 * float(delay.max() + delay.min()) + centroid
    u = theta[:, None] - delay
    r, slope, bend = np.zeros(u.shape), np.zeros(u.shape), np.zeros(u.shape)
    tiny, small = 1e-4 * width, 0.05 * width  # a second difference must span cells of the table
    for g, table in enumerate(tables):
        mine = gate == g
        r[:, mine] = np.maximum(correlation.lookup(table, u[:, mine]), 0.0)
        ends = correlation.lookup(table, u[:, mine] + tiny), correlation.lookup(table, u[:, mine] - tiny)
        slope[:, mine] = (ends[0] - ends[1]) / (2.0 * tiny)
        sides = correlation.lookup(table, u[:, mine] + small) + correlation.lookup(table, u[:, mine] - small)
        bend[:, mine] = (sides - 2.0 * r[:, mine]) / small**2
    return _Stack(theta, width, r, slope, bend, share, level)


def _levels(grid: Float, values: Float) -> Float:
    """The amplitudes or backgrounds of a grid of logarithms; zero where there is none at all."""
    return np.exp(grid) if bool((values > 0).any()) else np.zeros(1)


def threshold_table(capture: xr.Dataset) -> ThresholdTable:
    """Fill the table of a generated capture's rig for the amplitudes and backgrounds that the capture holds.

    The window is that of the score: delays' span + √12 σ_R, about the middle delay plus R's centroid.
    Raises InputError where the capture lacks its true scene or amplitudes, or the window is over 600 σ_R.
    """
    stack = _stack(capture, _PER_WIDTH)
    theta, width, r, slope, bend, share = (
        stack.delay_s, stack.width_s, stack.r, stack.slope, stack.bend, stack.share,
    )  # fmt: skip
    rig = gated_rig(true_scene(capture))
    information = information_table(noise_model(rig))
    arc = Arc(information)
    amplitude = np.asarray(capture["truth_amplitude"].values, np.float64)
    log_a, log_b = _grid(amplitude, _AMPLITUDE_STEP), _grid(stack.level, _BACKGROUND_STEP)
    out = np.empty((3, theta.size, log_a.size, log_b.size))
    step = float(theta[1] - theta[0])
    for i, a in enumerate(_levels(log_a, amplitude)):
        for j, b in enumerate(_levels(log_b, stack.level)):
            mu = a * r + b * share
            j_mu = information(mu)
            root = np.sqrt((j_mu * (a * slope) ** 2).sum(axis=1))
            found = local_bound(mu, root, step, width, arc, curvature(mu, a * slope, a * bend, j_mu))
            with np.errstate(divide="ignore"):
                ratio, excess = np.log(found.ratio), np.log(found.excess)
            # Where there is no information at all the ratio is 0: a large number keeps lookups finite and irregular.
            out[0, :, i, j] = np.clip(np.nan_to_num(ratio, nan=-50.0), -50.0, 50.0)
            out[1, :, i, j] = np.clip(np.nan_to_num(excess, nan=50.0), 0.0, 50.0)
            out[2, :, i, j] = np.log(np.maximum(found.epsilon, 1e-300))
    return ThresholdTable(theta, log_a, log_b, *out)


def _responses(rig: GatedRig) -> list[correlation.Table]:
    """R of every gate, in closed form, as the scene truly is. 1e-4 of its peak is enough for a ratio of bounds."""
    pulse = optics_pulse(rig.laser.pulse)
    if rig.laser.jitter_shot_s > 0:
        pulse = waveforms.broadened(pulse, rig.laser.jitter_shot_s)
    return [correlation.tabulate(pulse, optics_gate(gate), 1e-4) for gate in rig.gates]


def _centroid(table: correlation.Table) -> float:
    u = table.start_s + table.step_s * np.arange(table.value.size)
    return float((table.value * u).sum() / table.value.sum())


def _slices(capture: xr.Dataset, rig: GatedRig) -> tuple[Float, npt.NDArray[np.int64], Float, Float]:
    """Of the lit, valid slices: true delay, gate, the background's shape (mean 1), and its level per pixel."""
    used = np.asarray(capture["valid"].values, bool) & np.asarray(capture["laser_on"].values, bool)
    background = np.asarray(capture["truth_background"].values, np.float64)
    level = background[used].mean(axis=0)
    shape = background[used].reshape(int(used.sum()), -1).mean(axis=1)
    mean = float(shape.mean())
    share = shape / mean if mean > 0 else np.ones(shape.size)
    return _true_delay(capture, rig)[used], np.asarray(capture["gate"].values, np.int64)[used], share, np.asarray(level)


def _pixels(capture: xr.Dataset) -> tuple[Float, Float, Float, float]:
    """Delay of the echo [s], amplitude and background level per pixel, and c/2n_g [m/s]."""
    scene = true_scene(capture)
    rig = gated_rig(scene)
    truth = np.asarray(capture["truth_range"].values, np.float64)
    n_g = group_index(scene.medium, rig.laser.wavelength_m)
    path, _ = _path(truth, rig)
    delay = path * (n_g / C_M_PER_S) - _offsets(rig, (truth.shape[0], truth.shape[1]))
    amplitude = np.asarray(capture["truth_amplitude"].values, np.float64)
    level = np.broadcast_to(_slices(capture, rig)[3], truth.shape)
    return delay, amplitude, level, C_M_PER_S / (2.0 * n_g)


def is_regular(capture: xr.Dataset, table: ThresholdTable | None = None) -> Bool:
    """Per pixel (row, col) of a generated capture: True where its Cramér-Rao bound may be asserted.

    Main arguments:
        table: of the same rig, to look up several captures in one; made here if not given. It must cover their
        amplitudes: weaker pixels than it holds are not regular, brighter ones count as its brightest.
    Pixels without truth are False. Raises InputError where the capture lacks its true scene.
    """
    delay, amplitude, level, _ = _pixels(capture)
    found = (table or threshold_table(capture)).regular(delay, amplitude, level)
    return np.asarray(found & np.isfinite(delay) & (amplitude > 0))


def _bayes_sigma_s(capture: xr.Dataset, amplitude: Float, level: Float, chosen: Bool) -> Float:
    """The Bayesian bound, s, for the amplitudes and backgrounds of the chosen pixels; (row, col), NaN elsewhere.

    Samples as their Poisson equivalent, of the same mean and variance: with V = F²μ + v, y/F² + v/F⁴ ~ Poisson of its
    mean, v the variance without light in photoelectrons².
    """
    noise = noise_model(gated_rig(true_scene(capture)))
    floor = (noise.dark_e + noise.read_noise_e**2 + 1.0 / (12.0 * noise.gain_dn_per_e**2)) / noise.intensifier_gain**2
    excess = noise.excess_noise_factor
    stack = _stack(capture, _BAYES_PER_WIDTH)
    step = float(stack.delay_s[1] - stack.delay_s[0])
    log_a, log_b = _grid(amplitude[chosen], 2.0 * _AMPLITUDE_STEP), _grid(level[chosen], _BACKGROUND_STEP)
    values = np.empty((log_a.size, log_b.size))
    for i, a in enumerate(_levels(log_a, amplitude[chosen])):
        for j, b in enumerate(_levels(log_b, level[chosen])):
            mean = (a * stack.r + b * stack.share) / excess + floor / excess**2
            values[i, j] = math.log(posterior_bound(np.maximum(mean, 1e-9), step, draws=_BAYES_DRAWS).mmse)
    with np.errstate(divide="ignore", invalid="ignore"):
        found = np.exp(_lookup((log_a, log_b), values, (np.log(amplitude), np.log(level))))
    return np.asarray(np.where(chosen, found, np.nan))


def threshold_bound(
    capture: xr.Dataset, bound: Bound, table: ThresholdTable | None = None,
    *, form: Literal["ziv-zakai", "bayes"] = "ziv-zakai",
) -> Bound:  # fmt: skip
    """`bound` with another one in pixels that are not regular, and its name as kind if there are any such pixels.

    Main arguments:
        bound: `gated_bound` of the capture. table: as for `is_regular`.
    Other arguments:
        form: "ziv-zakai", ε(θ)·c/2n_g: milliseconds, and up to half too low in the threshold region of a wide window; or
        "bayes", the least error over a uniform prior (`bayes.posterior_bound`): some seconds a rig, and attained.
    Neither exceeds the prior's error. Both bound the mean square over delays of the window, not a single pixel: a scene
    that sits where the window is best may do better. A "quasi" or "none" bound keeps its kind: what is missing from its
    likelihood is missing here too. Raises InputError where the capture lacks its true scene.
    """
    if bound.kind == "none":
        return bound
    delay, amplitude, level, half = _pixels(capture)
    table = table or threshold_table(capture)
    has_truth = ~np.isnan(bound.sigma)
    other = has_truth & ~is_regular(capture, table)
    if not other.any():
        return bound
    if form == "bayes":
        found = _bayes_sigma_s(capture, amplitude, level, other & (amplitude > 0))
    else:
        found = table.epsilon_s(delay, amplitude, level)
    replaced = np.fmin(found * half, bound.prior_m)  # fmin: pixels without any light have the prior alone
    return replace(
        bound, sigma=np.where(other, replaced, bound.sigma), kind=form if bound.kind == "exact" else bound.kind
    )
