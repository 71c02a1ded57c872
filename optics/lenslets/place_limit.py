"""How well a spot tells its lenslet's mean slope, if the wave over the lenslet is not plane: bound, floor and what is possible.

A lenslet sees beside its mean slope what the wave does within it, coma first, and this moves the light of the spot about the
place that the mean slope gives. For small phases φ (samples of the lenslet) the image is linear,

    μ = N (P + J φ),    J = 2 Re(conj U₀ ∂U/∂φ),    U₀ the field of the flat wave,

and everything is Gaussian: φ of covariance C (Kolmogorov), noise of variance V = N P + B + σ² per pixel. With g φ the place that
the mean slope gives, D the image's derivatives by place and light, and W = V⁻¹:

    bound²  = (Dᵀ W D)⁻¹                            a spot of known shape, as the exact bound has it
    floor²  = e C eᵀ, e = (Dᵀ W D)⁻¹ Dᵀ W N J − g     what the fit of the known shape errs by without noise
    least²  = var(g φ | image)                      the best that any reading of the image can do, slope and light unknown

Sources: R. J. Noll, JOSA 66:207, 1976 (Kolmogorov's phase over an aperture); S. M. Kay, Estimation Theory, 1993, ch. 11 (least).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["PlaceLimit", "place_limit"]

Float = NDArray[np.float64]

#: Samples of a lenslet's side; points of a pixel's side; variances of the slope and of the light, over what any capture has.
_SAMPLES, _POINTS, _WIDE_PX2, _WIDE_LIGHT = 16, 6, 1e2, 1e2
#: D = 6.88388 (r/r0)^{5/3}, Kolmogorov's structure function.
_KOLMOGOROV = 6.88388


@dataclass(frozen=True)
class PlaceLimit:
    """Errors of a spot's place along one axis [px]: `bound` for the known shape, `floor` without noise, `least` possible."""

    bound: float
    floor: float
    least: float

    @property
    def fitted(self) -> float:
        """What the fit of the known shape errs by: noise and floor together."""
        return float(np.hypot(self.bound, self.floor))


def place_limit(
    photoelectrons: float, d_over_r0: float, *, width_px: float, half_px: float, background: float, read_noise_e: float
) -> PlaceLimit:
    """The limits of a square lenslet's spot.

    Main arguments:
        photoelectrons: N. d_over_r0: side of the lenslet over r0.
    Other arguments:
        width_px: λf/d, the spot's first zero. half_px: half side of the square of pixels that is read, whose middle pixel holds the
            spot's middle. background: B [photoelectrons] of a pixel. read_noise_e: σ.

    Raises ValueError for numbers that are not positive (zero is allowed for d_over_r0, background and read noise).
    """
    if not (photoelectrons > 0 and width_px > 0 and half_px >= 1) or min(d_over_r0, background, read_noise_e) < 0:
        raise ValueError(
            "photoelectrons, width_px and half_px (1 or more) must be positive, the others not negative: "
            f"{photoelectrons!r}, {width_px!r}, {half_px!r}, {d_over_r0!r}, {background!r}, {read_noise_e!r}."
        )
    spot, change = _image(width_px, half_px)
    phase, place = _phases()
    covariance = phase * d_over_r0 ** (5.0 / 3.0)
    g = place[0] * width_px / (2.0 * np.pi)  # px per rad of each sample, with lengths in sides of the lenslet
    variance = photoelectrons * spot + background + read_noise_e**2
    image = photoelectrons * change
    tilts = np.stack([axis * 2.0 * np.pi / width_px for axis in _axes()])  # phase that moves the spot by a pixel
    derivative = np.stack([*(image @ tilts.T).T, spot])
    inverse = np.linalg.inv((derivative / variance) @ derivative.T)
    error = (inverse @ (derivative / variance))[0] @ image - g
    known = image @ covariance
    spread = known @ image.T + np.diag(variance) + _WIDE_LIGHT * photoelectrons**2 * np.outer(spot, spot)
    moved = image @ tilts.T
    spread += _WIDE_PX2 * moved @ moved.T
    shared = known @ g + _WIDE_PX2 * moved @ (tilts @ g)
    whole = g @ covariance @ g + _WIDE_PX2 * float(((tilts @ g) ** 2).sum())
    least = whole - shared @ np.linalg.solve(spread, shared)
    return PlaceLimit(
        float(np.sqrt(inverse[0, 0])),
        float(np.sqrt(max(error @ covariance @ error, 0.0))),
        float(np.sqrt(max(least, 0.0))),
    )


def _axes() -> tuple[Float, Float]:
    """x and y (samples²) of the samples, in sides of the lenslet."""
    t = (np.arange(_SAMPLES) - 0.5 * (_SAMPLES - 1)) / _SAMPLES
    return np.tile(t, _SAMPLES), np.repeat(t, _SAMPLES)


def _image(width_px: float, half_px: float) -> tuple[Float, Float]:
    """(P (pixels), J (pixels, samples²)) of unit light, pixels integrated by the midpoint rule."""
    reach = int(np.floor(half_px))
    at = (np.arange((2 * reach + 1) * _POINTS) + 0.5) / _POINTS - reach - 0.5
    x = (np.arange(_SAMPLES) - 0.5 * (_SAMPLES - 1)) / _SAMPLES
    # Field of one sample along one axis, per root of light and pixel.
    wave = np.exp(-2j * np.pi * np.outer(at / width_px, x)) * np.sinc(at / width_px / _SAMPLES)[:, None]
    wave /= _SAMPLES * np.sqrt(width_px)
    flat = wave.sum(axis=1)

    def pixels(values: Float) -> Float:
        shape = (2 * reach + 1, _POINTS, 2 * reach + 1, _POINTS)
        return np.asarray(values.reshape(shape).sum(axis=(1, 3)).ravel() / _POINTS**2)

    spot = pixels(np.abs(np.outer(flat, flat)) ** 2)
    # 2 Re(conj(f_y f_x) i w_y w_x) of every sample: a product along the axes.
    across = np.conj(flat)[:, None] * wave
    change = np.stack(
        [
            pixels(-2.0 * np.imag(np.outer(across[:, row], across[:, col])))
            for row in range(_SAMPLES)
            for col in range(_SAMPLES)
        ],
        axis=1,
    )
    return spot, change


def _phases() -> tuple[Float, Float]:
    """(covariance (samples², samples²) of the phase for r0 of a side [rad²], mean gradient (axis, samples²) per side).

    The mean gradient is that of the phases at the edges, which the outermost samples stand for: differences over the sides.
    """
    x, y = _axes()
    structure = _KOLMOGOROV * np.hypot(x[:, None] - x, y[:, None] - y) ** (5.0 / 3.0)
    mean = structure.mean(axis=0)
    covariance = -0.5 * (structure - mean[:, None] - mean[None, :] + structure.mean())
    step = 1.0 / _SAMPLES
    rows = []
    for axis in (x, y):
        order = np.round(axis / step + 0.5 * (_SAMPLES - 1)).astype(int)
        # Σ over the samples of second-order differences telescopes to the ends.
        weight = np.zeros(_SAMPLES)
        weight[[0, 1, -2, -1]] = [-1.5, 0.5, -0.5, 1.5]
        rows.append(weight[order] / _SAMPLES)
    return covariance, np.stack(rows)
