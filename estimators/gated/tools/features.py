"""Features of a pixel for the learned estimator: the profile about a first guess, in units of the width of the response."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ....optics.jit import kernel
from .design import design_of
from .maximum import TILE
from .poisson_fit import start
from .stack import Stack, load_row

__all__ = ["FEATURES", "SIGNIFICANCE", "features_of", "resolved"]

Float = npt.NDArray[np.float64]
#: Samples of the profile, σ_R/2 apart, from −5 to 5 σ_R; then light, significance and the share of the pedestal.
POINTS = 21
FEATURES = POINTS + 3
#: Index of the feature lg(amplitude/its approximate standard error).
SIGNIFICANCE = POINTS + 1


@kernel(error_model="numpy")
def _read(  # type: ignore[no-untyped-def]
    counts,
    slices,
    group,
    e,
    s,
    levels,
    table,
    first,
    last,
    candidates,
    box,
    mean,
    norm,
    place,
    apart,
    snr,
    guess,
    out,
    light_of,
    ok,
):
    rows, cols = counts.shape[1], counts.shape[2]
    offset, scale, saturation = levels
    groups, signal = e.size, place.size
    z, running = np.empty((TILE, groups)), np.empty(groups + 1)
    bad = np.zeros(TILE, np.int64)
    for row in range(rows):
        for begin in range(0, cols, TILE):
            number = min(TILE, cols - begin)
            load_row(counts, slices, group, row, begin, offset, scale, saturation, z[:number], bad[:number])
            for c in range(number):
                if bad[c] != 0:
                    continue
                y, f = z[c], out[row, begin + c]
                x, a, _b = start(y, e, s, table, first, last, candidates, box, mean, norm, running)
                light, total = 0.0, 0.0
                for g in range(signal):
                    total += e[g]
                    light += y[g]
                # The noise of the amplitude if all light lay under the template.
                spread = np.sqrt(max(light, 1.0) / total + s[0]) * np.sqrt(1.0 / apart)
                if not a > snr * spread:
                    continue
                g = 0
                height, low = 0.0, np.inf
                for m in range(POINTS):
                    # The profile at the point, by a straight line between the two slices whose centroids enclose it.
                    at = x + 0.5 * apart * (m - POINTS // 2)
                    while g < signal - 2 and place[g + 1] <= at:
                        g += 1
                    w = (at - place[g]) / (place[g + 1] - place[g])
                    w = min(max(w, 0.0), 1.0)
                    f[m] = (1 - w) * y[g] / e[g] + w * y[g + 1] / e[g + 1]
                    height = max(height, f[m])
                    low = min(low, f[m])
                span = height - low
                if not span > 0:
                    continue
                for m in range(POINTS):
                    f[m] = (f[m] - low) / span
                f[POINTS] = np.log10(span + 1.0)
                f[POINTS + 1] = np.log10(a / spread)
                f[POINTS + 2] = low / height
                j = min(max(int(x + 0.5), 0), table.shape[0] - 1)
                shown = 0.0
                for g in range(signal):
                    shown += table[j, 0, g]
                guess[row, begin + c], light_of[row, begin + c], ok[row, begin + c] = x, a * shown, True


def resolved(stack: Stack) -> bool:
    """Whether neighbouring slices are no farther apart than the points at which the profile is read."""
    width_s = float(np.sqrt(stack.instrument.responses[int(stack.gate[0])].variance_s2)) if stack.signal else 0.0
    return stack.spacing_s() <= 0.5 * width_s * (1 + 1e-9)


def features_of(stack: Stack, min_snr: float) -> tuple[Float, Float, Float, npt.NDArray[np.bool_], Float]:
    """(features (row, col, FEATURES), first guess of τ [s] (row, col), σ_R [s] as an array of one number, ok (row, col),
    photoelectrons of the echo in all slices over F² (row, col)).

    The first guess is the start of `poisson-ml`, a matched filter. All features are relative to it and to σ_R, so that an
    answer learned with one rig carries over to another whose response has a similar shape.
    """
    rig = stack.instrument
    shape = stack.counts.shape[1:]
    out, guess, ok = np.zeros((*shape, FEATURES)), np.full(shape, np.nan), np.zeros(shape, dtype=bool)
    light = np.full(shape, np.nan)
    design = design_of(stack)
    place = (stack.centroid_delay_s - design.origin_s) / design.step_s
    shift = stack.count * rig.floor_var / rig.excess**2
    if stack.signal > 1 and (np.diff(place) > 0).all():
        _read(
            stack.counts, stack.slices, stack.group, stack.exposure, shift,
            (rig.offset_dn, stack.frames / (rig.dn_per_pe * rig.excess), rig.saturation_dn), design.table, design.first,
            design.last, design.candidates, design.box, design.mean, design.norm, place, design.width, min_snr,
            guess, out, light, ok,
        )  # fmt: skip
    return out, design.origin_s + design.step_s * guess, np.array([design.width * design.step_s]), ok, light
