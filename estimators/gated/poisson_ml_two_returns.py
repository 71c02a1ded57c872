"""Poisson maximum likelihood of one or two echoes per pixel; a likelihood-ratio test decides how many there are."""

from __future__ import annotations

from typing import Literal

import numpy as np
import xarray as xr

from ...optics.jit import kernel
from ...scenes.errors import InputError
from ..registry import estimator
from ..result import range_result
from .tools.design import design_of
from .tools.goodness import hold_misfit
from .tools.maximum import TILE
from .tools.poisson_fit import start
from .tools.returns import climb, model
from .tools.stack import load_row, read_stack

__all__ = ["poisson_ml_two_returns"]

#: Standard errors of χ² beyond which two echoes do not explain a pixel; its tail is long where samples hold few electrons.
MISFIT = 5.0


@kernel(error_model="numpy")
def _second(zs, table, candidates, mean):  # type: ignore[no-untyped-def]
    """The place at which one more echo explains most, given the mean of the first fit: (x, A, score in its standard errors)."""
    place, amplitude, top = 0.0, 0.0, 0.0
    for i in range(candidates.size):
        j = candidates[i]
        score, square = 0.0, 0.0
        for g in range(zs.size):
            v = table[j, 0, g]
            w = v / mean[g]
            score += w * (zs[g] - mean[g])
            square += v * w
        if square > 0 and score > top * np.sqrt(square):
            place, amplitude, top = float(j), score / square, score / np.sqrt(square)
    return place, amplitude, top


@kernel(error_model="numpy")
def _misfit(zs, e, s, table, none, flat, q, level, columns):  # type: ignore[no-untyped-def]
    """Half the distance of two echoes, where Pearson's χ² is beyond MISFIT of its standard errors: there are more surfaces, the
    farthest about as far from each echo. Else 0."""
    model(q, e, s, table, none, flat, level, columns)
    square, spread, free = 0.0, 0.0, zs.size - 5
    for g in range(zs.size):
        square += (zs[g] - level[g]) ** 2 / level[g]
        spread += 2 + 1 / level[g]
    return 0.5 * abs(q[4] - q[2]) if square > free + MISFIT * np.sqrt(spread) else 0.0


@kernel(error_model="numpy")
def _fit_rows(  # type: ignore[no-untyped-def]
    counts, slices, group, e, s, levels, table, first, last, candidates, box, mean, norm, bounds, width, snr, gain, pick,
    tau, sigma, ok, alone,
):  # fmt: skip
    rows, cols = counts.shape[1], counts.shape[2]
    offset, scale, saturation = levels
    low, high, _reach, floor = bounds
    groups = e.size
    z, zs, running = np.empty((TILE, groups)), np.empty(groups), np.empty(groups + 1)
    bad = np.zeros(TILE, np.int64)
    none, flat = np.zeros((1, groups)), np.zeros(1)
    one, error1, two, error2, held, held_error = (
        np.empty(4),
        np.empty(4),
        np.empty(6),
        np.empty(6),
        np.empty(6),
        np.empty(6),
    )
    level, columns = np.empty(groups), np.empty((6, groups))
    for row in range(rows):
        for begin in range(0, cols, TILE):
            number = min(TILE, cols - begin)
            load_row(counts, slices, group, row, begin, offset, scale, saturation, z[:number], bad[:number])
            for c in range(number):
                if bad[c] != 0:
                    continue
                x, a, b = start(z[c], e, s, table, first, last, candidates, box, mean, norm, running)
                if not a > 0:
                    continue
                for g in range(groups):
                    zs[g] = z[c, g] + s[g]
                one[0], one[1], one[2], one[3] = max(b, floor), 0.0, min(max(x, low), high), a
                single, likelihood = climb(zs, e, s, table, none, flat, bounds, one, error1)
                model(one, e, s, table, none, flat, level, columns)
                pearson = 0.0
                for g in range(groups):
                    pearson += (zs[g] - level[g]) ** 2 / level[g]
                place, light, t = _second(zs, table, candidates, level)
                better = -np.inf
                # Where the fit explains the data, no second echo is tried.
                if not single or t > 2.5 or pearson > groups + 2 * np.sqrt(2.0 * groups):
                    for attempt in range(2):
                        if attempt == 0:
                            if not light > 0 or abs(place - one[2]) < 1:
                                continue
                            two[2], two[3], two[4], two[5] = one[2], one[3], place, light
                        else:
                            # One broad echo: two of half its height, one on either side.
                            two[2], two[4] = one[2] - 0.8 * width, one[2] + 0.8 * width
                            two[3], two[5] = 0.6 * one[3], 0.6 * one[3]
                        if two[2] > two[4]:
                            two[2], two[3], two[4], two[5] = two[4], two[5], two[2], two[3]
                        if two[2] < low or two[4] > high:
                            continue
                        two[0], two[1] = max(one[0], floor), 0.0
                        settled, found = climb(zs, e, s, table, none, flat, bounds, two, error2)
                        if settled and found > better:
                            better = found
                            held[:], held_error[:] = two, error2
                if better > likelihood + 0.5 * gain and held[3] > 3 * held_error[3] and held[5] > 3 * held_error[5]:
                    i = 2
                    if pick == 1 or (pick == 2 and held[5] > held[3]):
                        i = 4
                    x, dx, a, da = held[i], held_error[i], held[i + 1], held_error[i + 1]
                    alone[row, begin + c] = False
                    dx = np.hypot(dx, _misfit(zs, e, s, table, none, flat, held, level, columns))
                elif single:
                    x, dx, a, da = one[2], error1[2], one[3], error1[3]
                else:
                    continue
                if a > snr * da and dx < width and low < x < high:
                    tau[row, begin + c], sigma[row, begin + c], ok[row, begin + c] = x, dx, True


@estimator("gated", cites="Hernandez-Marin, Wallace and Gibson, IEEE Trans. PAMI 29(12):2170, 2007 (not verified)")
def poisson_ml_two_returns(
    capture: xr.Dataset, *, pick: Literal["first", "last", "brightest"] = "brightest", min_gain: float = 20.0,
    min_snr: float = 4.0,
) -> xr.Dataset:  # fmt: skip
    """Maximum likelihood of μ_k = Σ_i A_i·R(τ_i−t_k) + B with one echo, or with two where the data require it.

    Two echoes are taken where 2·ln(L₂/L₁) > min_gain and both amplitudes exceed 3 of their standard errors. The second echo
    is searched for over the whole window, so that its gain is not χ² with 2 degrees of freedom; with some 40 resolvable
    places, a gain of 20 occurs by chance in fewer than 1 of 1,000 pixels (measured: 2 of 48,000 at 10⁴ photoelectrons). The
    method of the source is Bayesian, by reversible jumps; the likelihood-ratio test replaces it here. Noise as in
    `poisson-ml`.
    Other arguments: pick: the echo whose range is returned; min_gain; min_snr: least A in its standard errors.
    Returns range, sigma [m] from the Fisher information of the chosen model and, where its profile is not that of the data, from
    the spread of the delays (`misfit`), valid (row, col). Invalid: not settled, sigma beyond the width of R, a clipped or NaN
    sample. Raises InputError for negative min_gain or min_snr.
    """
    if min_gain < 0 or min_snr < 0:
        raise InputError(
            "A parameter is negative.", where="poisson-ml-two-returns[min_gain, min_snr]", value=(min_gain, min_snr),
            allowed=">= 0",
        )  # fmt: skip
    stack = read_stack(capture)
    rig = stack.instrument
    shape = stack.counts.shape[1:]
    tau, sigma, ok = np.full(shape, np.nan), np.full(shape, np.nan), np.zeros(shape, dtype=bool)
    if stack.signal < 6:
        return range_result(tau, sigma, ok)
    design, alone = design_of(stack), np.ones(shape, dtype=bool)
    shift = stack.count * rig.floor_var / rig.excess**2
    floor = -0.5 * float((shift / stack.exposure).min())
    _fit_rows(
        stack.counts, stack.slices, stack.group, stack.exposure, shift,
        (rig.offset_dn, stack.frames / (rig.dn_per_pe * rig.excess), rig.saturation_dn), design.table, design.first,
        design.last, design.candidates, design.box, design.mean, design.norm,
        (design.low, design.high, 0.7 * design.width, floor), design.width, min_snr, min_gain,
        ("first", "last", "brightest").index(pick), tau, sigma, ok, alone,
    )  # fmt: skip
    hold_misfit(stack, design, tau, sigma, ok & alone)
    return range_result(*rig.to_range(design.origin_s + design.step_s * tau, design.step_s * sigma), ok)
