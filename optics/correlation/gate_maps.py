"""Per-pixel gate timing of an image intensifier.

The gate voltage travels over the photocathode from its rim, so that the centre opens later ("irising"); an asymmetric
feed adds a skew. Both delay the whole gate of a pixel: R_pixel(u) = R(u − offset).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["gate_offset_map"]


def gate_offset_map(rows: int, cols: int, iris_s: float, skew_s: tuple[float, float]) -> NDArray[np.float64]:
    """Opening offset of the gate of every pixel, (rows, cols), s: iris_s·ρ² + skew_s[0]·x + skew_s[1]·y.

    Main arguments:
        rows, cols: size of the sensor, px.
        iris_s: offset of the sensor's corner relative to its centre, s; negative where the centre opens last.
        skew_s: offset at the right and at the bottom edge relative to the centre, s.
    x and y run from −1 to 1 between the sensor's outer edges (pixel centres at integers, the sensor's centre at
    ((cols − 1)/2, (rows − 1)/2)), and ρ is the distance from the centre over that of the corner, so that offsets stay
    within |iris_s| + |skew_s[0]| + |skew_s[1]|. The offset of the centre is 0. Raises ValueError if the sensor has no pixels.
    """
    if rows < 1 or cols < 1:
        raise ValueError(f"rows and cols must be at least 1, not {rows} and {cols}")
    dx = np.arange(cols) - 0.5 * (cols - 1)
    dy = (np.arange(rows) - 0.5 * (rows - 1))[:, None]
    rho2 = (dx**2 + dy**2) / ((0.5 * cols) ** 2 + (0.5 * rows) ** 2)
    return np.asarray(iris_s * rho2 + skew_s[0] * dx / (0.5 * cols) + skew_s[1] * dy / (0.5 * rows), dtype=np.float64)
