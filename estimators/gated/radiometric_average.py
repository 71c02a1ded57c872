"""A radiometric weighted average: the weights come from the expected intensity, so that the reflection matters."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...optics.constants import C_M_PER_S, PLANCK_J_S
from ...optics.jit import kernel
from ...scenes.errors import InputError
from ..registry import estimator
from ..result import range_result
from .chua_2017 import model_angle, printed_reflection
from .tools.background import from_outside
from .tools.design import design_of
from .tools.goodness import hold_misfit
from .tools.instrument import Instrument
from .tools.maximum import TILE, brightest
from .tools.stack import load_row, read_stack

__all__ = ["radiometric_average", "expected_electrons"]

Float = npt.NDArray[np.float64]


def expected_electrons(rig: Instrument, range_m: Float, reflection: Float) -> Float:
    """α [photoelectrons per slice, gate open] of a surface at range_m with reflection f [1/sr] (Eq. 6 in photons).

    α = N·E λ/(hc) · I(θ)/r² · f · πA_px/(4F²)·T·QE · e^(−2cr), I(θ) the declared beam [1/sr]; a beam that is not Gaussian is
    taken as uniform over its cone. Raises InputError where the declared rig lacks a value.
    """
    declared = rig.rig
    half, offset = declared.number("laser.half_angle_rad", above=0), declared.numbers("laser.offset_rad", length=2)
    x = (np.arange(rig.cols) - rig.principal_col)[None, :] / rig.focal_px - np.tan(offset[0])
    y = (np.arange(rig.rows) - rig.principal_row)[:, None] / rig.focal_px - np.tan(offset[1])
    angle = np.arctan(np.hypot(x, y))
    if declared.need("laser.profile") == "gaussian":
        beam = 2 / (np.pi * half**2) * np.exp(-2 * (angle / half) ** 2)
    else:
        beam = np.full(angle.shape, 1 / (2 * np.pi * (1 - np.cos(half))))
    energy, wave = declared.number("laser.pulse_energy_j", least=0), declared.number("laser.wavelength_m", above=0)
    photons = rig.pulses_per_slice * energy * wave / (PLANCK_J_S * C_M_PER_S)
    pitch, f_number = declared.number("camera.pixel_pitch_m", above=0), declared.number("camera.f_number", above=0)
    lens = np.pi * pitch**2 / (4 * f_number**2) * declared.number("camera.transmission", least=0)
    absorption = declared.number("medium.absorption_per_m", least=0)
    loss = np.exp(-2 * (absorption + declared.number("medium.scattering_per_m", least=0)) * range_m)
    efficiency = declared.number("camera.quantum_efficiency", least=0)
    return np.asarray(photons * beam / range_m**2 * reflection * lens * efficiency * loss)


@kernel(error_model="numpy")
def _iterate(  # type: ignore[no-untyped-def]
    counts, slices, group, levels, noise, share, number, reads, table, bounds, start, alpha, level, tau, sigma, ok
):
    """Move τ until the weighted centroid of the data equals that of the model A·R + B under the same weights."""
    rows, cols = counts.shape[1], counts.shape[2]
    offset, scale, saturation = levels
    excess, floor = noise
    low, high, reach = bounds
    groups = share.size
    bad = np.zeros(TILE, np.int64)
    w = np.empty(groups)
    for row in range(rows):
        for first in range(0, cols, TILE):
            width = min(TILE, cols - first)
            y = np.empty((width, groups))
            load_row(counts, slices, group, row, first, offset, scale, saturation, y, bad[:width])
            for c in range(width):
                col = first + c
                x, b, done = start[row, col], level[row, col], False
                s, amplitude, error = 0.0, 0.0, np.inf
                if bad[c] or not (low <= x <= high):
                    continue
                for _ in range(50):
                    j = int(x + 0.5)
                    f = x - j
                    wy, wr, wb = 0.0, 0.0, 0.0
                    for g in range(groups):
                        r = table[j, 0, g] + f * (table[j, 1, g] + f * table[j, 2, g])
                        signal = alpha[row, col] * r
                        w[g] = signal / (excess * (signal + max(b, 0.0)) + floor)
                        wy += w[g] * y[c, g] * share[g]
                        wr += w[g] * r
                        wb += w[g]
                    amplitude = (wy - b * wb) / wr if wr > 0 else 0.0
                    if not amplitude > 0:
                        break
                    centre_up, centre_down = 0.0, 0.0
                    for g in range(groups):
                        centre_up += w[g] * y[c, g] * share[g] * g
                        centre_down += w[g] * y[c, g] * share[g]
                    centre = centre_up / centre_down
                    gap, gain, variance = 0.0, 0.0, 0.0
                    for g in range(groups):
                        r = table[j, 0, g] + f * (table[j, 1, g] + f * table[j, 2, g])
                        d = table[j, 1, g] + 2 * f * table[j, 2, g]
                        gap -= w[g] * (g - centre) * (amplitude * r + b)
                        gain += w[g] * (g - centre) * amplitude * d
                        s = excess * (amplitude * r + max(b, 0.0)) + floor * reads[g]
                        variance += (w[g] * (g - centre)) ** 2 * s / number[g]
                    if not gain > 0:
                        break
                    step = min(max(gap / gain, -reach), reach)
                    x += step
                    error = np.sqrt(variance) / gain
                    if not (low <= x <= high):
                        break
                    if abs(step) < 0.005 * error:
                        done = True
                        break
                tau[row, col], sigma[row, col] = x, error
                ok[row, col] = done


@estimator("gated", cites="this project; Guo et al. 2017, Eq. 4 and 6 (light)")
def radiometric_average(
    capture: xr.Dataset, *, k_s: float = 0.0, k_d: float = 0.16, slope: float = 0.3, diffusivity: float = 1.0,
    k: float = 1.0, phi: float | None = None,
) -> xr.Dataset:  # fmt: skip
    """Average with radiometric weights w_k = S_k/(F²(S_k + B) + σ_r²), S_k = α(r, θ)·R(τ−t_k) from the LADAR equation.

    α is `expected_electrons` with Eq. 4 in 1/sr at the angle θ = (ρ/ρ_max)^k·φ of the model: a wrong reflection gives wrong
    weights (more noise) here, while it cancels in `chua-2017`. B is the mean of the slices that R does not reach. τ is
    moved until the weighted centroid of the data equals that of A·R + B under the same weights; otherwise weights that
    follow τ would hold it back. At that point it is near maximum likelihood. It is not the estimator of Chua et al. 2016 (J.
    Eur. Opt. Soc. Rapid Publ. 11:16015), whose weights come from a detection threshold and the system's noise.
    Other arguments: as `chua-2017` (k_d = .16/sr: a Lambert albedo of .5).
    Returns range, sigma [m] by error propagation and, in pixels of several surfaces, their spread (`misfit`), valid
    (row, col): settled within 50 steps inside the window, no clipped sample, brightest slice above the background by 2
    standard deviations. Raises InputError for parameters that are no reflection, and for a rig that lacks a value.
    """
    if k_s < 0 or k_d < 0 or k_s + k_d <= 0 or slope <= 0:
        raise InputError(
            "The parameters describe no reflection.", where="radiometric-average[k_s, k_d, slope]", value=(k_s, k_d, slope),
            allowed="k_s, k_d >= 0 and not both 0, slope > 0",
        )  # fmt: skip
    stack = read_stack(capture)
    rig = stack.instrument
    shape = stack.counts.shape[1:]
    tau, sigma, ok = np.full(shape, np.nan), np.full(shape, np.nan), np.zeros(shape, dtype=bool)
    if stack.signal < 3:
        return range_result(tau, sigma, ok)
    design = design_of(stack)
    found = brightest(stack)
    peak_u = np.array([r.peak_s for r in rig.responses])
    first_guess = stack.delay_s[found.index] + peak_u[stack.gate[found.index]]
    distance = np.maximum(rig.to_range(first_guess, first_guess)[0], 1e-3)
    theta = model_angle(rig, k, phi)
    alpha = expected_electrons(rig, distance, printed_reflection(theta, k_s, k_d, slope, diffusivity))
    level, _number = from_outside(stack)
    signal = stack.group < stack.signal
    n = stack.signal
    background = np.nan_to_num((level - rig.offset_dn) / rig.dn_per_pe)
    share = stack.frames / stack.exposure[:n]
    table = np.ascontiguousarray(design.table[:, :, :n] * share)
    _iterate(
        stack.counts, stack.slices[signal], stack.group[signal], (rig.offset_dn, 1 / rig.dn_per_pe, rig.saturation_dn),
        (rig.excess, rig.floor_var), share, stack.exposure[:n], stack.reads[:n], table,
        (design.low, design.high, 0.7 * design.width),
        np.clip((first_guess - design.origin_s) / design.step_s, design.low, design.high),
        np.maximum(alpha, 1e-12), background, tau, sigma, ok,
    )  # fmt: skip
    with np.errstate(invalid="ignore"):
        noise = np.sqrt((rig.excess * np.maximum(background, 0) + rig.floor_var) * 4)
        ok &= (found.at - background > noise) & (sigma < design.width)
    hold_misfit(stack, design, tau, sigma, ok)
    return range_result(*rig.to_range(design.origin_s + design.step_s * tau, design.step_s * sigma), ok)
