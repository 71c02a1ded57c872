"""Poisson maximum likelihood: echo time, amplitude and background of every pixel from the whole stack."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...optics.jit import kernel
from ...scenes.errors import InputError
from ..registry import estimator
from ..result import masked_result, range_result
from .tools.design import design_of
from .tools.even_design import even_design_of
from .tools.even_fit import fit_even
from .tools.maximum import TILE
from .tools.misfit import LIMIT, NO_VEIL, state_misfit
from .tools.poisson_clipped import leave_out, plausible
from .tools.poisson_fit import fit_careful, fit_fast, start
from .tools.poisson_flat import fit_flat
from .tools.stack import Stack, load_row, read_stack

__all__ = ["poisson_ml"]

Float = npt.NDArray[np.float64]
_Bool = npt.NDArray[np.bool_]
#: tau, sigma, ok, again and suspect (row, col).
_Out = tuple[Float, Float, _Bool, _Bool, _Bool]


@kernel(error_model="numpy")
def _usable(counts, slices, group, row, col, e, s, levels, whole, z, share, held):  # type: ignore[no-untyped-def]
    """Sums of the samples of one pixel per group. z, share: the sum of the unclipped, finite samples, and the part of the
    group that they are; whole: the sum with the clipped samples too, scaled up for missing ones, for the start of a fit;
    held: the clipped samples, as `fit_careful` takes them. Returns the number of groups that have unclipped samples."""
    offset, scale, saturation = levels
    clipped, clip, e_one, s_one, part = held
    number = np.zeros(z.size)
    seen = np.zeros(z.size)
    whole[:] = 0.0
    z[:] = 0.0
    share[:] = 0.0
    clipped[:] = 0.0
    for i in range(slices.size):
        g = group[i]
        v = float(counts[slices[i], row, col])
        number[g] += 1.0
        if np.isfinite(v):
            whole[g] += (v - offset) * scale
            seen[g] += 1.0
            if not v < saturation:
                clipped[g] += 1.0
        if v < saturation:
            z[g] += (v - offset) * scale
            share[g] += 1.0
    good = 0
    for g in range(z.size):
        whole[g] *= number[g] / max(seen[g], 1.0)
        share[g] /= number[g]
        part[g] = 1 / number[g]
        e_one[g], s_one[g] = e[g] * part[g], s[g] * part[g]
        # Half a DN for rounding; half an electron, since P(Y >= clip) is that of a whole number of them.
        clip[g] = max((saturation - 0.5 - offset) * scale + s_one[g] + 0.5, 1.0)
        if share[g] > 0:
            good += 1
    return good


@kernel(error_model="numpy")
def _fit_rows(  # type: ignore[no-untyped-def]
    counts,
    slices,
    group,
    e,
    s,
    levels,
    table,
    first,
    last,
    bounds,
    candidates,
    box,
    mean,
    norm,
    snr,
    units,
    tau,
    sigma,
    ok,
    again,
):
    rows, cols = counts.shape[1], counts.shape[2]
    offset, scale, saturation = levels
    low, high, width, floor = bounds
    groups = e.size
    e_sum, s_sum = np.zeros(groups + 1), np.zeros(groups + 1)
    for g in range(groups):
        e_sum[g + 1], s_sum[g + 1] = e_sum[g] + e[g], s_sum[g] + s[g]
    z = np.empty((TILE, groups))
    zs, zu, share, running = np.empty(groups), np.empty(groups), np.empty(groups), np.empty(groups + 1)
    held = (np.empty(groups), np.empty(groups), np.empty(groups), np.empty(groups), np.empty(groups))
    bad = np.zeros(TILE, np.int64)
    for row in range(rows):
        for begin in range(0, cols, TILE):
            number = min(TILE, cols - begin)
            if not again[row, begin : begin + number].any():
                continue
            load_row(counts, slices, group, row, begin, offset, scale, saturation, z[:number], bad[:number])
            for c in range(number):
                col = begin + c
                if not again[row, col]:
                    continue
                tau[row, col], sigma[row, col], ok[row, col] = np.nan, np.nan, False
                done = False
                y = z[c]
                if bad[c] == 0:
                    x0, a0, b0 = start(y, e, s, table, first, last, candidates, box, mean, norm, running)
                    if a0 > 0:
                        for g in range(groups):
                            zs[g] = y[g] + s[g]
                        x, a, _b, var_x, var_a, done = fit_fast(
                            zs, e, s, e_sum, s_sum, table, first, last, low, high, 0.7 * width, floor,
                            min(max(x0, low), high), a0, max(b0, floor),
                        )  # fmt: skip
                if not done:
                    good = _usable(counts, slices, group, row, col, e, s, levels, y, zu, share, held)
                    clips = held[0].any()
                    for turn in range(2):
                        x0, a0, b0 = start(y, e, s, table, first, last, candidates, box, mean, norm, running)
                        if good < min(4, groups) or not a0 > 0:
                            break
                        for g in range(groups):
                            zs[g] = zu[g] + s[g] * share[g]
                        x, a, b, var_x, var_a, done = fit_careful(
                            zs, e * share, s * share, share, held, table, low, high, 0.7 * width, floor,
                            min(max(x0, low), high), a0, max(b0, floor),
                        )  # fmt: skip
                        if not clips:
                            break
                        done = done and plausible(zs, e * share, s * share, share, held, table, x, a, b)
                        if done or turn == 1:
                            break
                        # A stray clipped sample: the others may give the range without it.
                        leave_out(y, share, held[0])
                if done and a > snr * np.sqrt(var_a) and var_x < width * width and low < x < high:
                    tau[row, col] = units[0] + units[1] * x
                    sigma[row, col] = units[1] * np.sqrt(var_x)
                    ok[row, col] = True


@kernel(error_model="numpy")
def _fit_flat_rows(  # type: ignore[no-untyped-def]
    counts, slices, group, e, s, levels, table, first, last, bounds, candidates, box, mean, norm, snr, units, tau, sigma, ok
):  # fmt: skip
    """As `_fit_rows`, for responses with corners: the middle of the top of the likelihood, for every pixel."""
    low, high, width, floor = bounds
    groups = e.size
    whole, z, zs = np.empty(groups), np.empty(groups), np.empty(groups)
    share, running = np.empty(groups), np.empty(groups + 1)
    held = (np.empty(groups), np.empty(groups), np.empty(groups), np.empty(groups), np.empty(groups))
    for row in range(counts.shape[1]):
        for col in range(counts.shape[2]):
            tau[row, col], sigma[row, col], ok[row, col] = np.nan, np.nan, False
            good = _usable(counts, slices, group, row, col, e, s, levels, whole, z, share, held)
            clips, found = held[0].any(), False
            for turn in range(2):
                x0, a0, b0 = start(whole, e, s, table, first, last, candidates, box, mean, norm, running)
                if good < min(4, groups) or not a0 > 0:
                    break
                for g in range(groups):
                    zs[g] = z[g] + s[g] * share[g]
                x, a, b, var_x, var_a, found = fit_flat(
                    zs, e * share, s * share, share, held, table, low, high, width, floor, min(max(x0, low), high), a0,
                    max(b0, floor),
                )  # fmt: skip
                if not clips:
                    break
                found = found and plausible(zs, e * share, s * share, share, held, table, x, a, b)
                if found or turn == 1:
                    break
                leave_out(whole, share, held[0])
            if found and a > snr * np.sqrt(var_a) and var_x < width * width and low < x < high:
                tau[row, col] = units[0] + units[1] * x
                sigma[row, col] = units[1] * np.sqrt(var_x)
                ok[row, col] = True


@estimator(
    "gated",
    cites="Fisher scoring: Osborne, Int. Stat. Rev. 60:99, 1992; read noise: Snyder et al., JOSA A 12:272, 1995",
)
def poisson_ml(capture: xr.Dataset, *, min_snr: float = 4.0) -> xr.Dataset:
    """Maximum likelihood of μ_k = A·R(τ−t_k) + B over (τ, A, B), Poisson counts, R from the declared samples.

    With y = (counts − offset)/gain in photoelectrons, read noise σ_r (and the 1/12 DN² of the ADC) enters by the shifted
    Poisson approximation y + σ_r² ~ Poisson(μ + σ_r²), which matches mean and variance; the excess noise F² of an
    intensifier by scaling, y/F² ~ Poisson(μ/F²), which matches them too. Of a clipped sample the likelihood takes the
    probability that it reaches the clip (`poisson_clipped`); NaN samples are left out; laser-off slices give background.
    B is bounded by −σ_r²/2. Start: matched filter on a grid of ¾ σ_R, background projected out; then Fisher scoring.
    Pixels that have clipped samples, or do not settle in some ten steps, are fitted with step halving on the likelihood;
    they are invalid where light and clips contradict each other (one bright slice among dark ones) and the other samples
    give no range either. Stacks of even delays are fitted in tiles of pixels in single precision (`even_fit`), others one
    pixel at a time. Where R has corners (rectangular pulse and gate) the top of the likelihood may be flat, and its middle
    is the answer (`poisson_flat`).
    Other arguments: min_snr: least A in its standard errors; a weaker echo is not answered.
    Returns range, sigma [m] from the Fisher information with A and B profiled, valid (row, col): converged, at least
    a quarter of the echo inside the window, sigma below the width of R. Where the echo is broader than R by more than
    chance, as in a pixel that sees two surfaces, sigma holds the spread of their delays (`misfit`). Two lit slices are
    enough where there are laser-off slices (by `poisson_flat`). Raises InputError for min_snr < 0.
    """
    if min_snr < 0:
        raise InputError(
            "The least signal must not be negative.", where="poisson-ml[min_snr]", value=min_snr, allowed=">= 0"
        )
    stack = read_stack(capture)
    rig = stack.instrument
    shape = stack.counts.shape[1:]
    # Two lit slices give time and amplitude where laser-off slices give the background.
    if stack.signal < 2 or stack.groups < 3:
        nothing = np.full(shape, np.nan)
        return range_result(nothing, nothing, np.zeros(shape, dtype=bool))
    direct = rig.gate_offset() is None and not rig.laser_m.any()
    factor = rig.m_per_s if direct else 1.0
    scale = 1 / (rig.dn_per_pe * rig.excess)
    shift = stack.count * rig.floor_var / rig.excess**2
    floor = -0.5 * float((shift / stack.exposure).min())
    levels = (rig.offset_dn, scale * stack.frames, rig.saturation_dn)
    value, sigma = np.empty(shape), np.empty(shape)
    valid, again, suspect = np.empty(shape, dtype=bool), np.empty(shape, dtype=bool), np.ones(shape, dtype=bool)
    design = design_of(stack)
    units = (factor * design.origin_s, factor * design.step_s)
    bounds = (design.low, design.high, design.width, floor)
    common = (stack.counts, stack.slices, stack.group, stack.exposure, shift, levels, design.table, design.first,
              design.last, bounds, design.candidates, design.box, design.mean, design.norm, min_snr, units)  # fmt: skip
    # Two slices that both show the plateau of R do not tell delays apart either.
    if design.corners or stack.signal == 2:
        _fit_flat_rows(*common, value, sigma, valid)
    else:
        _fit_smooth(stack, levels, shift, floor, min_snr, factor, (value, sigma, valid, again, suspect))
        # Also where no pixel needs it: a warm-up must compile the same kernels for all data.
        _fit_rows(*common, value, sigma, valid, again)
    state_misfit(
        stack.counts, stack.slices, stack.group, stack.exposure, shift, levels, design.table, design.first, design.last,
        design.width, floor, LIMIT, units, value, sigma, valid & suspect, *NO_VEIL,
    )  # fmt: skip
    if direct:
        valid &= value > 0
        if not valid.all():
            value[~valid], sigma[~valid] = np.nan, np.nan
        return masked_result(value, sigma, valid)
    return range_result(*rig.to_range(value, sigma), valid)


def _fit_smooth(
    stack: Stack, levels: tuple[float, ...], shift: Float, floor: float, min_snr: float, factor: float, out: _Out
) -> None:
    """Fit even delays in tiles; `again` marks the pixels that are left, all of them for other stacks, and `suspect` those
    whose profile may not be R."""
    value, sigma, valid, again, suspect = out
    even = even_design_of(stack)
    if even is None:
        again[:] = True
        return
    order = np.empty(stack.signal, dtype=np.int64)
    order[stack.group] = stack.slices
    # One path for any memory layout: another one would settle within its tolerance, but not on the same bits.
    flat = np.ascontiguousarray(stack.counts).reshape(stack.counts.shape[0], -1)
    fit_even(
        flat, order, levels, float(shift[0]), floor * float(stack.exposure[0]),
        (even.table, even.bend, even.held), even.phases, even.xi,
        even.mask, even.pad, (even.low, even.high), even.width, even.grid, even.template, even.span, even.mean,
        even.norm, min_snr, (factor * even.origin_s, factor * even.step_s), value.reshape(-1), sigma.reshape(-1),
        valid.reshape(-1), again.reshape(-1), suspect.reshape(-1),
    )  # fmt: skip
