"""Range-intensity correlation: the range from the ratio of two overlapping slices."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import xarray as xr

from ..registry import estimator
from ..response import Response
from ..result import range_result
from .tools.profiles import Background, background_e, blocks, variance
from .tools.stack import read_stack

__all__ = ["range_intensity_correlation"]

Float = npt.NDArray[np.float64]


def _clock(response: Response, gap_s: float) -> tuple[Float, Float]:
    """(share, u): share(u) = R(u)/(R(u) + R(u + gap)), the part of the later slice, where both slices see the echo.

    u = τ − t_late; the early slice, which opens by gap earlier, sees R(u + gap). The longest interval is kept over which
    the share rises with u and both values exceed 1 % of the peak.
    """
    u = np.linspace(response.lo_s - gap_s, response.hi_s, 4097)
    late, early = response(u)[0], response(u + gap_s)[0]
    both = np.minimum(late, early) > 0.01 * response.peak
    share = late / np.maximum(late + early, 1e-300)
    rising = np.zeros(u.size, dtype=bool)
    rising[1:] = both[1:] & both[:-1] & (np.diff(share) > 1e-7)
    edges = np.flatnonzero(np.diff(np.concatenate(([0], rising.astype(np.int8), [0]))))
    if edges.size == 0:
        return np.zeros(0), np.zeros(0)
    begin, end = edges[::2], edges[1::2]
    longest = int((end - begin).argmax())
    cut = slice(max(int(begin[longest]) - 1, 0), int(end[longest]))
    return share[cut], u[cut]


@estimator(
    "gated", cites="Laurenzis, Christnacher and Monnin, Opt. Lett. 32:3146, 2007; Wang et al., Appl. Opt. 52:7399, 2013"
)
def range_intensity_correlation(
    capture: xr.Dataset, *, slices_apart: int | None = None, background: Background = "outside", min_snr: float = 4.0
) -> xr.Dataset:
    """τ from q = y_late/(y_early + y_late) of two slices one response width apart: q(τ) = R(τ−t_l)/(R(τ−t_e) + R(τ−t_l)).

    The curve q(τ) is that of the declared samples, for triangular profiles (pulse as long as the gate: both slices on a
    slope) and for trapezoidal ones (one slice on the plateau). A pixel uses its brightest pair of slices; the other slices
    serve for the background only.
    Other arguments: slices_apart: distance of the two slices in the order of delay (null: the one nearest to the area of R
    over its peak); background: "outside" subtracts the mean of the slices that R does not reach, "none" nothing; min_snr:
    least sum of the pair in its standard errors.
    Returns range, sigma [m] by propagation of the noise of both samples, valid (row, col). Invalid: q outside the rise of
    the curve, a clipped or NaN sample.
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
    back = background_e(stack, background)
    for rows, y, bad in blocks(stack):
        v = variance(stack, y)
        net = y - back[rows]
        total = net[:-apart] + net[apart:]
        k = total.argmax(axis=0)
        early, late = (np.take_along_axis(net, (k + s)[None], axis=0)[0] for s in (0, apart))
        noise_e, noise_l = (np.take_along_axis(v, (k + s)[None], axis=0)[0] for s in (0, apart))
        light = early + late
        with np.errstate(divide="ignore", invalid="ignore"):
            share = late / light
            spread = np.sqrt(early**2 * noise_l + late**2 * noise_e) / light**2
        for i, (curve, u) in enumerate(curves):
            here = which.reshape(-1)[k] == i
            if curve.size < 3:
                continue
            inside = (
                here & (share > curve[0]) & (share < curve[-1]) & ~bad & (light > min_snr * np.sqrt(noise_e + noise_l))
            )
            slope = np.gradient(u, curve)
            tau[rows][inside] = t[k[inside] + apart] + np.interp(share[inside], curve, u)
            sigma[rows][inside] = np.interp(share[inside], curve, np.abs(slope)) * spread[inside]
            ok[rows] |= inside
    return range_result(*rig.to_range(tau, sigma), ok)
