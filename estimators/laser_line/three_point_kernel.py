"""The three-point formulas and their errors, compiled: as `windows.locked` where noise leaves the brightest pixel in place.

A formula reads three pixels. Its error is √(Σ (Δc_k)² + locking²), Δc_k half the change of c between pixel k plus and minus its
standard deviation. Rows in which noise may move the brightest pixel are left to `windows.locked`, which then takes changes
about the expected line.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from ...optics.jit import kernel

__all__ = ["three_points"]

Float = npt.NDArray[np.float64]

#: Standard deviations between the brightest pixel and its neighbours in a line of the declared width, from which noise does not
#: change which one is brightest: Φ(−5) = 3e-7, so that it moves by less than .01 px rms (`windows._SURE_PX`).
_SURE = 5.0


def three_points(
    z: Float, level: Float, floor_e2: float, excess: float, fall: Float, near: Float, locking: Float, *, log: bool
) -> tuple[Float, Float, npt.NDArray[np.bool_]]:
    """(position [px] from the middle pixel, its standard error [px], whether both are known), each (n).

    Main arguments:
        z (n, 2h + 1), level (n), floor_e2, excess: as of `windows.Windows`. fall, near (n): shares of the line's light in the
            middle pixel less, and plus, that in its neighbour, for a line about the middle of a pixel. locking (n) [px].
        log: of the logarithms, a Gaussian's vertex; else a parabola's.
    """
    out = np.empty((3, z.shape[0]))
    _three(z, level, floor_e2, excess, fall, near, locking, log, _SURE, out)
    return out[0], out[1], out[2] > 0


@kernel(error_model="numpy")
def _three(z, level, floor, excess, fall, near, locking, log, sure, out):  # type: ignore[no-untyped-def]
    half = z.shape[1] // 2
    for i in range(z.shape[0]):
        row = z[i]
        a, b, c = row[half - 1], row[half], row[half + 1]
        light = 0.0
        for j in range(row.size):
            light += row[j]
        light = max(light, 0.0)
        background = max(level[i], 0.0)
        spread = math.sqrt(excess * (light * near[i] + 2.0 * background) + 2.0 * floor)
        position = _place(a, b, c, log)
        square = locking[i] * locking[i]
        for k in range(3):
            value = row[half - 1 + k]
            step = math.sqrt(excess * max(value + level[i], 0.0) + floor)
            up, down = value + step, value - step
            if k == 0:
                change = 0.5 * (_place(up, b, c, log) - _place(down, b, c, log))
            elif k == 1:
                change = 0.5 * (_place(a, up, c, log) - _place(a, down, c, log))
            else:
                change = 0.5 * (_place(a, b, up, log) - _place(a, b, down, log))
            change = min(abs(change), float(half)) if change == change else float(half)
            square += change * change
        out[0, i], out[1, i] = position, math.sqrt(square)
        out[2, i] = 1.0 if light * fall[i] > sure * spread else 0.0


@kernel(error_model="numpy")
def _place(a, b, c, log):  # type: ignore[no-untyped-def]
    """½ (a − c)/(a − 2b + c), of the logarithms where `log`; NaN where it opens upward, or a value has no logarithm."""
    if log:
        if not (a > 0.0 and b > 0.0 and c > 0.0):
            return np.nan
        a, b, c = math.log(a), math.log(b), math.log(c)
    bend = a - 2.0 * b + c
    return 0.5 * (a - c) / bend if bend < 0.0 else np.nan
