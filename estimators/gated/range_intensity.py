"""Range-intensity correlation: the range from the ratio of two overlapping slices."""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt
import xarray as xr

from ..registry import estimator
from ..response import Response
from ..result import range_result
from .tools.background import from_off_slices
from .tools.profiles import background_e, blocks, variance
from .tools.stack import Stack, read_stack

__all__ = ["range_intensity_correlation"]

Float = npt.NDArray[np.float64]
Background = Literal["auto", "off-slices", "outside", "none"]


def _clock(response: Response, gap_s: float) -> tuple[Float, Float, bool]:
    """(share, u, flat): share(u) = R(u)/(R(u) + R(u + gap)), the part of the later slice, where both slices see the echo.

    u = τ − t_late; the early slice, which opens by gap earlier, sees R(u + gap). Intervals are kept over which the share
    rises with u and both values exceed 1 % of the peak; where a plateau lies between two of them, on which both slices see
    the same light, `flat` is true, and the curve jumps over it. Otherwise it is the longest interval.
    """
    u = np.linspace(response.lo_s - gap_s, response.hi_s, 4097)
    late, early = response(u)[0], response(u + gap_s)[0]
    both = np.minimum(late, early) > 0.01 * response.peak
    share = late / np.maximum(late + early, 1e-300)
    rising = np.zeros(u.size, dtype=bool)
    rising[1:] = both[1:] & both[:-1] & (np.diff(share) > 1e-7)
    edges = np.flatnonzero(np.diff(np.concatenate(([0], rising.astype(np.int8), [0]))))
    if edges.size == 0:
        return np.zeros(0), np.zeros(0), False
    begin, end = edges[::2], edges[1::2]
    # A plateau: both slices at the top of R, or steps below the resolution of the test above.
    wide = end - begin > 8
    level = bool(wide.sum() == 2) and bool(both[begin[wide][0] : end[wide][1]].all())
    if level:
        first, last = (slice(max(int(b) - 1, 0), int(e)) for b, e in zip(begin[wide], end[wide], strict=True))
        whole = np.concatenate([share[first], share[last]])
        if (np.diff(whole) >= 0).all():
            return whole, np.concatenate([u[first], u[last]]), True
    longest = int((end - begin).argmax())
    cut = slice(max(int(begin[longest]) - 1, 0), int(end[longest]))
    return share[cut], u[cut], False


def _background(stack: Stack, how: Background) -> tuple[Float, Float]:
    """Level [photoelectrons per slice] and its variance, (row, col) each; that of "outside" is not counted."""
    has_off = stack.groups > stack.signal
    if how == "off-slices" or (how == "auto" and has_off):
        rig = stack.instrument
        level, exposures = from_off_slices(stack, "range-intensity-correlation")
        light = (level - rig.offset_dn) / rig.dn_per_pe
        reads = float(stack.count[stack.signal]) / float(stack.exposure[stack.signal])
        return light, (rig.excess * np.maximum(light, 0.0) + reads * rig.floor_var) / (exposures * stack.frames)
    light = background_e(stack, "none" if how == "none" else "outside")
    return light, np.zeros_like(light)


@estimator(
    "gated", cites="Laurenzis, Christnacher and Monnin, Opt. Lett. 32:3146, 2007; Wang et al., Appl. Opt. 52:7399, 2013"
)
def range_intensity_correlation(
    capture: xr.Dataset, *, slices_apart: int | None = None, background: Background = "auto", min_snr: float = 4.0
) -> xr.Dataset:
    """τ from q = y_late/(y_early + y_late) of two slices one response width apart: q(τ) = R(τ−t_l)/(R(τ−t_e) + R(τ−t_l)).

    The curve q(τ) is that of the declared samples, for triangular profiles (pulse as long as the gate: both slices on a
    slope) and for trapezoidal ones (one slice on the plateau). A pixel uses its brightest pair of slices; the other slices
    serve for the background only. Where the pulse is so much shorter than the gate that both slices may be on the plateau,
    every pair is read, the pair of least sigma is used, and sigma is half the way between τ(q − σ_q) and τ(q + σ_q).
    Other arguments: slices_apart: distance of the two slices in the order of delay (null: the one nearest to the area of R
    over its peak); background: "off-slices" subtracts the mean of the laser-off slices, "outside" that of the slices that R
    does not reach, "none" nothing, "auto" takes the laser-off slices where there are any, and those outside otherwise;
    min_snr: least sum of the pair in its standard errors.
    Returns range, sigma [m] by propagation of the noise of both samples and of laser-off slices, valid (row, col). Invalid:
    q outside the rise of the curve, a clipped or NaN sample. Raises InputError for "off-slices" where there is no such slice.
    """
    stack = read_stack(capture)
    rig = stack.instrument
    shape = stack.counts.shape[1:]
    tau, sigma, ok = np.full(shape, np.nan), np.full(shape, np.nan), np.zeros(shape, dtype=bool)
    n = stack.signal
    if n < 2 or np.unique(stack.gate[:n]).size > 1 or not np.ptp(stack.delay_s[:n]) > 0:
        return range_result(tau, sigma, ok)
    response = rig.responses[int(stack.gate[0])]
    apart = slices_apart if slices_apart is not None else round(response.area_s / response.peak / stack.spacing_s())
    apart = min(max(int(apart), 1), n - 1)
    t = stack.delay_s
    gaps = t[apart:n] - t[: n - apart]
    # A curve for each distinct distance of the pairs (one, where delays are even).
    names, which = np.unique(np.round(gaps / stack.spacing_s(), 6), return_inverse=True)
    curves = [_clock(response, float(name * stack.spacing_s())) for name in names]
    back, back_var = _background(stack, background)
    for rows, y, bad in blocks(stack):
        v = variance(stack, y)
        net = y - back[rows]
        total = net[:-apart] + net[apart:]
        brightest = total.argmax(axis=0)
        # One pair for each pixel; all of them where a plateau may hold the brightest.
        pairs = [np.full(bad.shape, i) for i in range(n - apart)] if any(c[2] for c in curves) else [brightest]
        for k in pairs:
            picked = [np.take_along_axis(a, (k + s)[None], axis=0)[0] for a in (net, v) for s in (0, apart)]
            found = _read_pair(picked, curves, which.reshape(-1)[k], back_var[rows], min_snr)
            better = found[2] & ~bad & ~(sigma[rows] <= found[1])
            tau[rows][better] = t[k[better] + apart] + found[0][better]
            sigma[rows][better] = found[1][better]
            ok[rows] |= better
    return range_result(*rig.to_range(tau, sigma), ok)


def _read_pair(
    picked: list[Float],
    curves: list[tuple[Float, Float, bool]],
    which: npt.NDArray[np.intp],
    back_var: Float,
    min_snr: float,
) -> tuple[Float, Float, npt.NDArray[np.bool_]]:
    """(u, its standard error, whether the pair tells it) of a pair of slices in every pixel; picked: light of the early and
    the late slice, and their variances."""
    early, late, noise_e, noise_l = picked
    u, sigma, ok = np.full(early.shape, np.nan), np.full(early.shape, np.nan), np.zeros(early.shape, dtype=bool)
    light = early + late
    with np.errstate(divide="ignore", invalid="ignore"):
        share = late / light
        spread = np.sqrt(early**2 * noise_l + late**2 * noise_e + (late - early) ** 2 * back_var) / light**2
        strong = light > min_snr * np.sqrt(noise_e + noise_l)
    for i, (curve, place, flat) in enumerate(curves):
        if curve.size < 3:
            continue
        inside = (which == i) & (share > curve[0]) & (share < curve[-1]) & strong
        u[inside] = np.interp(share[inside], curve, place)
        if flat:
            ends = [np.interp(share[inside] + sign * spread[inside], curve, place) for sign in (-1, 1)]
            sigma[inside] = 0.5 * (ends[1] - ends[0])
            # Within three standard errors of the share that both slices have all over the plateau, the pair tells nothing.
            inside &= np.abs(share - curve[int(np.argmax(np.diff(place)))]) > 3 * spread
        else:
            sigma[inside] = np.interp(share[inside], curve, np.abs(np.gradient(place, curve))) * spread[inside]
        ok |= inside
    return u, sigma, ok
