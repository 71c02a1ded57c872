"""Pixels that show one echo: which pixels of a scan the model of one echo explains.

A pixel at an edge sees two surfaces, and its response is the sum of two. Such a pixel would lengthen the pulse of a calibration,
and no stretch explains it. What a scan shows of it is its χ² about the fit of one echo, which is then far above its
degrees of freedom n. A pixel is *single* where

    χ²/(n + what frames that vary in light and time add) <= max(1, m) χ²(n; 0.001)/n,

m the median of the left side over lit pixels, relative to that of the distribution. Pixels are thus left out for being unlike
the others: where the declared pulse, gate or noise is wrong, all pixels are alike in it, none is left out, and χ² shows
it. One sound pixel in a thousand is left out. The fit is repeated on the single pixels until they stay the same.

No truth is used: a steep surface whose echo is wider than a pixel's noise tells is left out like an edge.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from .gated_scan import DelayScan
from .gated_widths import ResponseFit, fit_response, lit_pixels

__all__ = ["fit_one_echo"]

Float = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

#: Share of sound pixels that are left out.
_LEFT_OUT = 1e-3
#: Fits at most. With a sphere before a wall three suffice.
_ROUNDS = 10


def fit_one_echo(scan: DelayScan, *, known_s: Float | None = None) -> ResponseFit:
    """Fit the response to the pixels that show one echo; `single` of the result says which these are.

    Main arguments:
        scan: of a target. known_s: times of the echo (pixel), if the target was surveyed.

    Raises:
        InputError: as `fit_response`.
    """
    fit = fit_response(scan, known_s=known_s)
    for _ in range(_ROUNDS):
        single = _single(fit)
        if np.array_equal(single, fit.single):
            break
        fit = fit_response(scan, known_s=known_s, single=single)
    return fit


def _single(fit: ResponseFit) -> Mask:
    from scipy.special import chdtri

    lit = lit_pixels(fit)
    if fit.dof < 1 or not lit.any():
        return np.ones(lit.size, bool)
    relative = fit.chi2 / (fit.dof + fit.frames)
    typical = float(np.median(relative[lit])) * fit.dof / float(chdtri(fit.dof, 0.5))
    return np.asarray(relative <= max(1.0, typical) * float(chdtri(fit.dof, _LEFT_OUT)) / fit.dof)
