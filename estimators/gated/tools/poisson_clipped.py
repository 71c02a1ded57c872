"""Clipped samples in a Poisson likelihood: a clipped sample is known only to have reached the clip.

With c the clip in (shifted, scaled) photoelectrons, a sample of mean V reaches it with P(Y >= c) = P(Γ(c) <= V), by Wilson
and Hilferty Φ(t), t = 3√c·((V/c)^⅓ − 1 + 1/9c), accurate to 10⁻³ from c = 3 on and smooth in V. To leave clipped samples out
would keep those samples of a pixel that noise held below the clip, and no others: a bias, and a sigma that is too small.
Source: E. B. Wilson and M. M. Hilferty, PNAS 17:684, 1931; censored samples: J. Tobin, Econometrica 26:24, 1958.
"""

from __future__ import annotations

import math

import numpy as np

from ....optics.jit import kernel

__all__ = ["leave_out", "log_reached", "plausible", "reached"]

#: Standard normal deviate below which Φ is taken by its asymptote.
_FAR = -25.0
#: A clipped sample less likely than this deviate was not clipped by the light that the other samples show.
_STRANGE = -6.0


@kernel(error_model="numpy")
def _deviate(mean, clip):  # type: ignore[no-untyped-def]
    return 3 * np.sqrt(clip) * ((mean / clip) ** (1 / 3) - 1 + 1 / (9 * clip))


@kernel(error_model="numpy")
def log_reached(mean, clip):  # type: ignore[no-untyped-def]
    """ln P(Y >= clip) of a Poisson-like sample of this mean; both in photoelectrons, clip >= 1."""
    t = _deviate(mean, clip)
    if t > _FAR:
        return math.log(0.5 * math.erfc(-t / math.sqrt(2.0)))
    return -0.5 * t * t - math.log(-t * math.sqrt(2 * math.pi))


@kernel(error_model="numpy")
def reached(mean, clip):  # type: ignore[no-untyped-def]
    """First derivative of ln P(Y >= clip) in the mean, and minus the second: score and information of a clipped sample."""
    t = _deviate(mean, clip)
    hazard = -t - 1 / t
    if t > _FAR:
        hazard = math.exp(-0.5 * t * t) / math.sqrt(2 * math.pi) / (0.5 * math.erfc(-t / math.sqrt(2.0)))
    slope = (mean / clip) ** (-2 / 3) / np.sqrt(clip)
    return hazard * slope, hazard * slope * ((hazard + t) * slope + 2 / (3 * mean))


@kernel(error_model="numpy")
def plausible(zs, e, s, share, held, table, x, a, b):  # type: ignore[no-untyped-def]
    """Whether the fit of a pixel with clipped samples explains the other samples: arguments as `poisson_fit.fit_careful`.

    A single bright sample among dark ones (a hot slice, a cosmic ray) is no echo: the fit then predicts light in its
    neighbours that they do not have, or too little light for the clip. The unclipped samples must show more than half of
    the echo that the fit predicts for them, and the clipped ones must not lie beyond −6 standard deviations."""
    clipped, clip, e_one, s_one, part = held
    j = int(x + 0.5)
    f = x - j
    off, light, worst, number = 0.0, 0.0, 0.0, 0.0
    for g in range(zs.size):
        v = a * (table[j, 0, g] + f * (table[j, 1, g] + f * table[j, 2, g]))
        if share[g] > 0:
            off += abs(zs[g] - v * share[g] - b * e[g] - s[g]) - np.sqrt(max(v * share[g] + b * e[g] + s[g], 0.0))
            light += v * share[g]
        if clipped[g] > 0:
            worst += clipped[g] * _deviate(max(v * part[g] + b * e_one[g] + s_one[g], 1e-9), clip[g])
            number += clipped[g]
    return worst >= _STRANGE * number and off < 0.5 * light


@kernel(error_model="numpy")
def leave_out(whole, share, clipped):  # type: ignore[no-untyped-def]
    """Treat clipped samples as missing: groups that hold no other get the mean of their neighbours in `whole`."""
    for g in range(whole.size):
        if clipped[g] > 0 and share[g] == 0:
            left, right = g - 1, g + 1
            while left >= 0 and share[left] == 0:
                left -= 1
            while right < whole.size and share[right] == 0:
                right += 1
            before = whole[left] if left >= 0 else whole[min(right, whole.size - 1)]
            after = whole[right] if right < whole.size else before
            whole[g] = 0.5 * (before + after)
    clipped[:] = 0.0
