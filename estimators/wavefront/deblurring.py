"""An image without the blur of the water: total variation, with the point spread of the reconstructed wavefront."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
import xarray as xr
from scipy.fft import irfft2, rfft2

from ...optics.deconvolution import deblur, point_spread, transfer_of
from ...optics.zernike import zernike
from ...scenes.errors import InputError
from ..registry import estimator
from ..result import stage_result
from ..rig import DeclaredRig
from .geometry import declared_geometry
from .modal import pupil_grid
from .options import in_range, whole

__all__ = ["deblur_tv"]

Float = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]

#: Black ground about the image, as a share of its side: light leaves the image, and none comes in from the other edge.
_GROUND = 0.5
#: Noise that is taken as the least, of white: rounding of what no photon lit.
_LEAST_NOISE = 1e-6


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

    Returns image, sigma, valid (frame, image_row, image_col), white 1. sigma: of the image's noise, and of the stated errors of the
    Zernike coefficients, each on its own, both as Wiener's filter passes them on; total variation lowers the noise in even parts,
    and edges that H wiped out err by more. A frame without a phase is invalid.
    Raises InputError for a capture without an image, and for a negative weight.
    """
    if "image" not in capture:
        raise InputError(
            "The capture has no image to deblur.", where="image", allowed="image (frame, image_row, image_col) [electron]",
            next_step="give the rig a camera beside the lenslets: rig.imager",
        )  # fmt: skip
    if not (weight >= 0.0 and np.isfinite(weight)):
        raise InputError(
            "A weight is not negative.", where="weight", value=weight, allowed="above 0, or 0: from the noise"
        )
    white, floor = rig.number("imager.photoelectrons", above=0), rig.number("imager.read_noise_e", least=0)
    in_range("tolerance", tolerance, 0, above=True)
    iterations = whole("iterations", iterations, 1)
    seen = np.asarray(capture["image"].values, np.float64) / white
    own = weight or 0.02 * float(np.sqrt(0.5 / white + (floor / white) ** 2))
    image, sigma = np.full(seen.shape, np.nan), np.full(seen.shape, np.nan)
    inside = np.asarray(phase["valid_phase"].values, bool)
    for frame, one in enumerate(seen):
        if not inside[frame].any() or not np.isfinite(one).all():
            continue
        noise = float(np.sqrt(np.maximum(one, 0.0).mean() / white + (floor / white) ** 2 + _LEAST_NOISE**2))
        wave = _Wave.of(phase, frame, rig)
        if fidelity == "printed":
            image[frame], sigma[frame] = 0.0, noise
            continue
        wide, held = _on_ground(one)
        found = deblur(wide, wave.transfer(wide.shape), own, tolerance=tolerance, iterations=iterations)
        if found.converged:
            image[frame], sigma[frame] = found.image[held], _error(found.image, wave, noise)[held]
    return stage_result("deconvolution", image=image, sigma=sigma, valid=np.isfinite(image))


@dataclass(frozen=True, eq=False)
class _Wave:
    """A reconstructed phase [rad] and `pupil` (samples, samples); surfaces (n, samples, samples) [rad] of one standard error."""

    phase: Float
    pupil: Bool
    errors: Float

    @staticmethod
    def of(phase: xr.Dataset, frame: int, rig: DeclaredRig) -> _Wave:
        """That of a frame. Without Zernike coefficients its errors are tilts, of the size of the phase's own."""
        pupil = np.asarray(phase["valid_phase"].values[frame], bool)
        x, y, _ = pupil_grid(declared_geometry(rig))
        radius = 0.5 * declared_geometry(rig).diameter_m
        known = np.flatnonzero(np.asarray(phase["valid"].values[frame], bool))
        noll = (known + 2).tolist() or [2, 3]
        spread = np.asarray(phase["sigma"].values[frame], np.float64)[known]
        if not known.size:
            spread = np.full(2, float(phase["sigma_phase"].values[frame][pupil].mean()))
        errors = spread[:, None, None] * np.where(pupil, zernike(noll, x / radius, y / radius), 0.0)
        return _Wave(np.where(pupil, phase["phase"].values[frame], 0.0), pupil, errors)

    def transfer(self, shape: tuple[int, int], number: int | None = None) -> npt.NDArray[np.complex128]:
        """The half spectrum of H for images of `shape`; with the phase wrong by the error of that number."""
        phase = self.phase if number is None else self.phase + self.errors[number]
        return transfer_of(point_spread(phase, self.pupil.astype(np.float64)), shape)


def _on_ground(seen: Float) -> tuple[Float, tuple[slice, slice]]:
    """The image on its ground, and where it lies."""
    pad = [round(_GROUND * 0.5 * size) for size in seen.shape]
    held = slice(pad[0], pad[0] + seen.shape[0]), slice(pad[1], pad[1] + seen.shape[1])
    return np.pad(seen, [(p, p) for p in pad]), held


def _error(image: Float, wave: _Wave, noise: float) -> Float:
    """Standard error of a deblurred image from its noise and that of the phase, by Wiener's filter H*/(|H|² + noise²/var u)."""
    transfer, spectrum = wave.transfer(image.shape), rfft2(image)
    power = np.abs(transfer) ** 2
    back = np.conj(transfer) / (power + noise**2 / max(float(image.var()), noise**2))
    variance = np.full(image.shape, noise**2 * float((np.abs(back) ** 2).mean()))
    for number in range(len(wave.errors)):
        moved = (wave.transfer(image.shape, number) - transfer) * spectrum
        variance += irfft2(back * moved, s=image.shape) ** 2
    return np.asarray(np.sqrt(variance))
