"""The look of an amplitude-modulated capture: samples against phase, all shots, and the truth."""

from __future__ import annotations

import numpy as np
import xarray as xr

from .panel import Curve, Curves, Image, chosen, curve_colour, image, true_ranges, unit_of

__all__ = ["amcw_look"]


def amcw_look(capture: xr.Dataset, element: int | None) -> list[Image | Curves]:
    """The samples of the shot with most light, or of the asked one, a curve a frequency; all samples; the truth of every shot."""
    samples = capture["samples"].transpose("shot", "frequency", "phase").values.astype(np.float64)
    unit = unit_of(capture["samples"])
    shot = chosen(element, samples, "shot")
    steps = samples.shape[2]
    phase = capture["phase"].values if "phase" in capture.variables else 2.0 * np.pi * np.arange(steps) / steps
    hertz = capture["frequency"].values if "frequency" in capture.variables else None
    lines = tuple(
        Curve(
            f"{hertz[n] / 1e6:g} MHz" if hertz is not None else f"frequency {n}",
            phase,
            samples[shot, n],
            curve_colour(n),
            True,
        )
        for n in range(samples.shape[1])
    )
    found: list[Image | Curves] = [Curves(f"shot {shot}", lines, "phase of the reference, rad", f"samples, {unit}")]
    if len(samples) > 1:
        flat = samples.reshape(len(samples), -1)
        found.append(image("all shots", flat, unit, x="frequency and phase step", y="shot"))
    return found + true_ranges(capture)
