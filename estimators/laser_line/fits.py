"""Fits of the line's profile, a Gaussian integrated over the pixels: least squares, and maximum likelihood."""

from __future__ import annotations

from typing import Literal

import numpy as np
import xarray as xr

from ..registry import estimator
from .frames import OffFrames
from .profile_fit import fit_profiles
from .windows import Windows, answered, line_windows

__all__ = ["line_erf", "line_ml"]


@estimator(
    "line",
    cites="C. Steger et al., Machine Vision Algorithms and Applications, 2018, sec. 3.7 (least squares)",
)
def line_erf(
    capture: xr.Dataset, *, width: Literal["fitted", "declared"] = "fitted", returns: int = 1,
    off_frames: OffFrames = "unused", least_sigmas: float = 5.0,
) -> xr.Dataset:  # fmt: skip
    """c, A, B, s minimise Σ(z_j − B − A[Φ((j + ½ − c)/s) − Φ((j − ½ − c)/s)])², all pixels of the window alike.

    Returns column, sigma [px], valid (frame, row, return). sigma is that of the unweighted fit under the detector's noise.
    `width` "declared" holds s at what the rig declares for matter square to the view. `returns`: lines per row, brightest first,
    each outside of the windows before it. Invalid where the peak is not
    `least_sigmas` above the row's noise, where the window holds a bad pixel, or where the fit does not converge.
    """
    windows = line_windows(capture, least_sigmas=least_sigmas, returns=returns, off_frames=off_frames)
    return _fitted(windows, width, weighted=False)


@estimator(
    "line", cites="R. W. M. Wedderburn, Biometrika 61:439, 1974 (quasi-likelihood), on a pixel-integrated Gaussian"
)
def line_ml(
    capture: xr.Dataset, *, width: Literal["fitted", "declared"] = "fitted", returns: int = 1,
    off_frames: OffFrames = "unused", least_sigmas: float = 5.0,
) -> xr.Dataset:  # fmt: skip
    """As `line_erf` with weights 1/V_j, V = F²μ + σ_read² + 1/12 DN²: quasi-maximum likelihood for shot and read noise.

    Returns column, sigma [px], valid (frame, row, return). sigma² = (N⁻¹MN⁻¹)_cc with M = Σ ∇μ∇μᵀ/V, and N = M but for what is
    known of ln s beforehand.
    """
    windows = line_windows(capture, least_sigmas=least_sigmas, returns=returns, off_frames=off_frames)
    return _fitted(windows, width, weighted=True)


def _fitted(windows: Windows, width: str, *, weighted: bool) -> xr.Dataset:
    position, sigma, good = fit_profiles(
        windows.z, windows.level, windows.floor_e2 / windows.excess, windows.width(), weighted=weighted,
        free_width=width == "fitted",
    )  # fmt: skip
    # The fit is that of variances μ + floor/F²; those of the pixels are F² as large.
    return answered(windows, position, sigma * np.sqrt(windows.excess), good)
