"""The range model of Guo et al. 2017 (Eq. 23, 24) as printed, and with the cosine where their text requires it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...optics.jit import kernel
from ...scenes.errors import InputError
from ..registry import estimator
from ..result import range_result
from .tools.instrument import Instrument
from .tools.maximum import TILE
from .tools.stack import Stack, load_row, read_stack

__all__ = ["chua_2017", "chua_2017_orthogonal", "model_angle", "printed_reflection"]

Float = npt.NDArray[np.float64]
CITES = "Chua, Guo and Wang, Sensors 17(9):2031, 2017; Guo et al. 2017, Eq. 23-24"


def model_angle(rig: Instrument, k: float, phi: float | None) -> Float:
    """θ(x, y) = (ρ/ρ_max)^k·φ [rad] (Eq. 12, 13), (row, col): ρ from the principal point [px].

    In the text the illumination covers "an area within (x_max, y_max) with half diverging cone propagation of angle φ":
    φ is the angle of the edge of the cone. So for phi None φ is the declared half angle of the beam and ρ_max = focal
    length·tan φ, where that edge meets the plane of the array, inside the array or outside. A phi that is given is the
    angle at the farthest corner of the array, and ρ_max the ρ of that corner: (x_max, y_max) read as the size of the image.
    The result is at most π/2. Raises InputError where the rig declares no half angle.
    """
    x = (np.arange(rig.cols) - rig.principal_col)[None, :]
    y = (np.arange(rig.rows) - rig.principal_row)[:, None]
    rho = np.hypot(x, y)
    if phi is None:
        angle = rig.rig.number("laser.half_angle_rad", least=0)
        edge = rig.focal_px * np.tan(min(angle, 0.5 * np.pi))
    else:
        angle, edge = phi, float(rho.max())
    with np.errstate(over="ignore", divide="ignore"):
        return np.asarray(np.minimum((rho / max(edge, 1e-300)) ** k * angle, 0.5 * np.pi))


def printed_reflection(theta: Float, k_s: float, k_d: float, slope: float, diffusivity: float) -> Float:
    """Eq. 4: K_S/cos⁶θ·exp(−tan²θ/s²) + K_D·cosᵐθ; the first term in logarithms, since cos⁻⁶ overflows at grazing angles."""
    cos = np.cos(theta)
    with np.errstate(divide="ignore", invalid="ignore"):
        log_cos = np.log(np.maximum(cos, 1e-300))
        specular = np.exp(-6 * log_cos - (np.tan(theta) / slope) ** 2)
        return np.asarray(np.where(cos > 0, k_s * specular + k_d * np.exp(diffusivity * log_cos), 0.0))


@kernel(error_model="numpy")
def _moments(  # type: ignore[no-untyped-def]
    counts, slices, group, levels, noise, share, number, reads, t, wide, reflection, threshold, tau, sigma, ok
):
    """Σ f⁻¹ w I t³ / Σ f⁻¹ w I t² with w = 1 (for uneven delays half the distance of a delay's neighbours), the factor of
    Eq. 23 in every term as printed."""
    rows, cols = counts.shape[1], counts.shape[2]
    offset, scale, saturation = levels
    excess, floor = noise
    bad = np.zeros(TILE, np.int64)
    for row in range(rows):
        for first in range(0, cols, TILE):
            width = min(TILE, cols - first)
            y = np.empty((width, share.size))
            load_row(counts, slices, group, row, first, offset, scale, saturation, y, bad[:width])
            for c in range(width):
                col = first + c
                factor = 1.0 / reflection[row, col] if reflection[row, col] > 0 else np.inf
                top, light, quiet = 0.0, 0.0, 0.0
                for g in range(t.size):
                    v = y[c, g] * share[g]
                    top = max(top, v)
                    light += v
                    quiet += (excess * max(v, 0.0) + floor * reads[g]) / number[g]
                up, down = 0.0, 0.0
                for g in range(t.size):
                    v = y[c, g] * share[g]
                    if threshold == 0.0 or v >= threshold * top:  # as printed: all, negative ones too
                        up += factor * wide[g] * v * t[g] ** 3
                        down += factor * wide[g] * v * t[g] ** 2
                mean = up / down if down > 0 else np.nan
                variance = 0.0
                for g in range(t.size):
                    v = y[c, g] * share[g]
                    if threshold == 0.0 or v >= threshold * top:  # as printed: all, negative ones too
                        lever = factor * wide[g] * t[g] ** 2 * (t[g] - mean) / down if down > 0 else np.nan
                        variance += lever * lever * (excess * max(v, 0.0) + floor * reads[g]) / number[g]
                tau[row, col] = mean
                sigma[row, col] = np.sqrt(variance)
                ok[row, col] = bad[c] == 0 and light > 3 * np.sqrt(quiet)


def _average(stack: Stack, reflection: Float, threshold: float) -> tuple[Float, Float, npt.NDArray[np.bool_]]:
    rig = stack.instrument
    shape = stack.counts.shape[1:]
    tau, sigma, ok = np.full(shape, np.nan), np.full(shape, np.nan), np.zeros(shape, dtype=bool)
    if stack.signal:
        _moments(
            stack.counts, stack.slices, stack.group, (rig.offset_dn, 1 / rig.dn_per_pe, rig.saturation_dn),
            (rig.excess, rig.floor_var), stack.frames / stack.exposure, stack.exposure, stack.reads,
            stack.centroid_delay_s, stack.widths(), reflection, threshold, tau, sigma, ok,
        )  # fmt: skip
    return tau, sigma, ok


def _run(
    capture: xr.Dataset, k_s: float, k_d: float, slope: float, diffusivity: float, k: float, phi: float | None,
    threshold: float,
) -> tuple[Instrument, Float, Float, npt.NDArray[np.bool_], Float]:  # fmt: skip
    if k_s < 0 or k_d < 0 or k_s + k_d <= 0 or slope <= 0:
        raise InputError(
            "The parameters describe no reflection.",
            where="chua-2017[k_s, k_d, slope]",
            value=(k_s, k_d, slope),
            allowed="k_s, k_d >= 0 and not both 0, slope > 0",
        )
    if not 0 <= threshold < 1:
        raise InputError(
            "The threshold is not a fraction.", where="chua-2017[threshold]", value=threshold,
            allowed="0 <= threshold < 1",
        )  # fmt: skip
    stack = read_stack(capture)
    theta = model_angle(stack.instrument, k, phi)
    tau, sigma, ok = _average(stack, printed_reflection(theta, k_s, k_d, slope, diffusivity), threshold)
    radial, error = stack.instrument.to_range(tau, sigma)
    return stack.instrument, radial, error, ok, np.cos(theta)


@estimator("gated", cites=CITES)
def chua_2017(
    capture: xr.Dataset, *, k_s: float = 0.0, k_d: float = 1.0, slope: float = 0.3, diffusivity: float = 1.0,
    k: float = 1.0, phi: float | None = None, threshold: float = 0.0,
) -> xr.Dataset:  # fmt: skip
    """⟨r⟩ = 1/cos θ_m · Σ f⁻¹ w I r³ / Σ f⁻¹ w I r², exactly as printed; I = counts − offset, w = 1, r_i = c·t_i/2n_g.

    f is Eq. 4 at θ_m = (ρ/ρ_max)^k·φ. It is the same for all slices of a pixel, so that it cancels; it is computed all the
    same. t_i is the delay plus the centroid of R. A time of flight gives the radial range. The printed model divides it by
    cos θ_m (orthogonal → radial, a second time); r³/r² moves a symmetric echo away by 2σ²/r; a background pulls as in
    `weighted-average`. None of this is corrected: the result is returned as the radial range [m].
    Other arguments: k_s, k_d, slope, diffusivity: K_S, K_D, s, m of Eq. 4; k, phi [rad]: Eq. 13 (None: the declared half
    angle of the beam at the edge of the cone; a number: the angle at the farthest corner of the array); threshold: samples
    below this fraction of the greatest of the pixel are left out (printed: 0).
    Returns range, sigma [m] by error propagation, valid (row, col). Raises InputError for parameters out of range.
    """
    _rig, radial, error, ok, cos = _run(capture, k_s, k_d, slope, diffusivity, k, phi, threshold)
    with np.errstate(divide="ignore", invalid="ignore"):
        return range_result(radial / cos, error / np.abs(cos), ok & (cos > 1e-6))


@estimator("gated", cites=CITES + " (cosine multiplied: the orthogonal distance of Eq. 11)")
def chua_2017_orthogonal(
    capture: xr.Dataset, *, k_s: float = 0.0, k_d: float = 1.0, slope: float = 0.3, diffusivity: float = 1.0,
    k: float = 1.0, phi: float | None = None, threshold: float = 0.0,
) -> xr.Dataset:  # fmt: skip
    """As `chua-2017` with ×cos θ_m instead of ÷: r_orthogonal = cos θ_m · Σ f⁻¹ w I r³ / Σ f⁻¹ w I r² (Eq. 11).

    An estimate is a radial range, so the orthogonal distance is divided by the cosine of the true ray of the pixel: the
    errors that remain are those of the angle (ρ/ρ_max)^k·φ of the model and of the weights r³/r².
    Arguments, result and errors as `chua-2017`.
    """
    rig, radial, error, ok, cos = _run(capture, k_s, k_d, slope, diffusivity, k, phi, threshold)
    ratio = cos / rig.rays()[..., 2]
    return range_result(radial * ratio, error * np.abs(ratio), ok & (cos > 1e-6))
