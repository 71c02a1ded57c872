"""An image without the blur of the water: total variation, with the point spread of the reconstructed wavefront."""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...optics.deconvolution import deblur, point_spread, transfer_of
from ...scenes.errors import InputError
from ..registry import estimator
from ..result import stage_result
from ..rig import DeclaredRig

__all__ = ["deblur_tv"]

Float = npt.NDArray[np.float64]

#: Black ground about the image, as a share of its side: light leaves the image, and none comes in from the other edge.
_GROUND = 0.5


@estimator(
    "deconvolution",
    cites="Guo et al. 2017, Eq. 31-32; A. Chambolle and T. Pock, J. Math. Imaging Vis. 40:120, 2011",
    joint=True,
)
def deblur_tv(
    phase: xr.Dataset, capture: xr.Dataset, rig: DeclaredRig, *, fidelity: Literal["meant", "printed"] = "meant",
    weight: float = 0.0, tolerance: float = 1e-3, iterations: int = 500,
) -> xr.Dataset:  # fmt: skip
    """u' = argmin ½‖H(u) − v‖² + Δ Σ|∇u|, H the convolution with |F[P e^{iφ}]|², φ the reconstructed phase in the pupil P.

    Main arguments: phase [rad] on the pupil's grid; the capture, for its `image` v; the declared rig, for white and read noise.
    Other arguments:
        fidelity: "printed": argmin ½‖H(u) − p‖² + Δ‖u‖ as Eq. 32 has it, p the noise, of which an estimator knows only that its
            mean is 0: the minimum is the black image, whatever was seen.
        weight: Δ, of an image whose white is 1; 0: .02 of the noise of half a white pixel. tolerance: the search has converged
            when the gap of the objective is below this share of it. iterations: at most; an image that has not converged is
            invalid.

    Returns image, sigma, valid (frame, image_row, image_col), white 1. sigma: of the noise v has there, which total variation lowers
    in even parts, while edges that H wiped out err by more. A frame without a phase is invalid.
    Raises InputError for a capture without an image, and for a negative weight.
    """
    if "image" not in capture:
        raise InputError(
            "The capture has no image to deblur.", where="image", allowed="image (frame, image_row, image_col) [electron]",
            next_step="give the rig a camera beside the lenslets: rig.imager",
        )  # fmt: skip
    if not (weight >= 0.0 and np.isfinite(weight)):
        raise InputError("A weight is not negative.", where="weight", value=weight, allowed="above 0, or 0: from the noise")
    white, floor = rig.number("imager.photoelectrons", above=0), rig.number("imager.read_noise_e", least=0)
    seen = np.asarray(capture["image"].values, np.float64) / white
    noise = np.sqrt(np.maximum(seen, 0.0) / white + max(floor, 1.0) ** 2 / white**2)
    own = weight or 0.02 * float(np.sqrt(0.5 / white + (floor / white) ** 2))
    held, inside = np.asarray(phase["phase"].values, np.float64), np.asarray(phase["valid_phase"].values, bool)
    image = np.full(seen.shape, np.nan)
    for frame in range(len(seen)):
        if not inside[frame].any() or not np.isfinite(seen[frame]).all():
            continue
        if fidelity == "printed":
            image[frame] = 0.0
            continue
        image[frame] = _deblurred(seen[frame], held[frame], inside[frame], own, tolerance, iterations)
    return stage_result("deconvolution", image=image, sigma=noise, valid=np.isfinite(image))


def _deblurred(
    seen: Float, phase: Float, pupil: npt.NDArray[np.bool_], weight: float, tolerance: float, iterations: int
) -> Float:
    """One frame; NaN where the search has not converged."""
    pad = [round(_GROUND * 0.5 * size) for size in seen.shape]
    wide = np.pad(seen, [(p, p) for p in pad])
    transfer = transfer_of(point_spread(np.where(pupil, phase, 0.0), pupil.astype(np.float64)), wide.shape)
    found = deblur(wide, transfer, weight, tolerance=tolerance, iterations=iterations)
    if not found.converged:
        return np.full(seen.shape, np.nan)
    return found.image[pad[0] : pad[0] + seen.shape[0], pad[1] : pad[1] + seen.shape[1]]
