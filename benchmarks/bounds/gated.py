"""Cramer-Rao bound of the range of every pixel of a gated stack, amplitude and background profiled.

Slice k of a pixel has the mean μ_k = α R(u_k) + b β_k, u_k = n_g ℓ(r)/c − t_k − o, with ℓ the path from laser to target
to camera, o the pixel's gate offset and β the shape of the background over slices. With J(μ) the Fisher information of one
sample about its mean (Poisson ⊗ gamma ⊗ Gaussian ⊗ ADC, `optics.fisher`) and gradients a_k = (α R'(u_k) n_g/c dℓ/dr, R(u_k), β_k),

    F = Σ_k J(μ_k) a_k a_kᵀ,        σ² = (F⁻¹)₀₀ = 1/(F₀₀ − F₀₁ F₁₁⁻¹ F₁₀).

In water the gradient holds α + h in place of α. The halo h, light from the target around the pixel, does not depend on the
pixel's own range, but it moves with the target as a whole, and so do the estimates of all estimators that obey the law of
shift. With α alone the bound would hold only for estimators that know the halo, and none does. The halo is taken at the pixel's
range and as sharp as R, and β as known beside it (its late tail would be taken for light that stands still): the bound is
"quasi" there, and not too high.

An estimator does not know amplitude and background of the pixel, which costs information. A background of exactly 0 costs
none: if slices without light are noise-free they determine it without error (J → ∞); if all slices show light it is at the
limit b ≥ 0, and an estimator that knows this limit can be better than F with free b. R is computed from the closed forms of
`optics.correlation` for the true scene; α, b and r are the capture's truth.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...estimators.rig import DeclaredRig
from ...optics.constants import C_M_PER_S
from ...optics.correlation import response as correlation
from ...optics.likelihood.fisher_table import information_table
from ...scenes.medium_index import group_index
from ...scenes.rigs.gated import GatedRig, gated_rig
from ..scores.truth import Bound
from .gated_instrument import gate_offsets, gated_responses, halo_of, noise_model, path_delay, true_delay
from .instrument import bounded, moves, response_std_s, samples_variance_s2, true_scene, unbounded

__all__ = ["gated_bound"]

Float = npt.NDArray[np.float64]

#: Relative error of the tabulated R; that of the bound is about a hundred times larger, and below 1e-3.
_RTOL = 3e-6


def gated_bound(capture: xr.Dataset) -> Bound:
    """The bound of every pixel of a generated capture (with its truth).

    `kind` is "exact", or "quasi" if the capture has an effect that the likelihood above does not include: pulse energy or delay
    that fluctuate from slice to slice (the mean of its pulses by more than a tenth of a bound), a halo, correlated noise of a
    phosphor, averaged counts, unsound samples, a lens or lamp of finite size, a moving rig, a screen. Fixed patterns (PRNU,
    DSNU) are constants of each pixel, and part of the profiled amplitude and background.

    A capture without its true scene, amplitude or background (surveyed, or measured by a reference instrument) has no
    bound: `kind` is "none", and the scales follow from the declared rig.

    Raises:
        InputError: the true scene is invalid, or the declared rig lacks a required pulse, gate or medium.
    """
    if not bounded(capture, "truth_amplitude", "truth_background"):
        return unbounded(capture, lambda rig: _declared_scales(capture, rig))
    scene = true_scene(capture)
    rig = gated_rig(scene)
    tables = gated_responses(rig, _RTOL)
    n_g = group_index(scene.medium, rig.laser.wavelength_m)
    half = C_M_PER_S / (2.0 * n_g)
    sigma_r = response_std_s(tables)
    delay = np.asarray(capture["delay"].values, np.float64)
    scale = half * sigma_r
    window = _window(delay, half, scale)
    truth = np.asarray(capture["truth_range"].values, np.float64)
    sigma = _sigma(capture, truth, rig, tables, n_g)
    return Bound(sigma, _kind(capture, rig, half, sigma), scale, window)


def _window(delay: Float, half: float, scale: float) -> float:
    return half * float(delay.max() - delay.min()) + math.sqrt(12.0) * scale


def _declared_scales(capture: xr.Dataset, rig: DeclaredRig) -> tuple[float, float]:
    """(scale, window) of the declared samples, interpolated linearly: the variance of R is the sum of their variances."""
    half = C_M_PER_S / (2.0 * rig.number("medium.group_index", above=0))
    pulse = samples_variance_s2(rig.samples("pulse")) + rig.number("laser.jitter_shot_s", least=0) ** 2
    gates = range(len(rig.need("gates")))
    scale = half * math.sqrt(max(pulse + samples_variance_s2(rig.samples(f"gates.{i}")) for i in gates))
    return scale, _window(np.asarray(capture["delay"].values, np.float64), half, scale)


def _kind(capture: xr.Dataset, rig: GatedRig, half: float, sigma: Float) -> str:
    tube = rig.detector.intensifier
    mean_jitter = rig.laser.jitter_shot_s / math.sqrt(rig.pulses_per_slice)
    outside = (
        rig.laser.energy_fluctuation > 0,
        rig.laser.jitter_frame_s > 0,
        moves(half * mean_jitter, sigma),  # the mean delay of a slice's pulses scatters
        tube is not None and tube.phosphor_sigma_px > 0,
        bool(capture.attrs.get("averaged", False)),
        bool(halo_of(capture).any()),
        "valid_sample" in capture and not bool(capture["valid_sample"].values.all()),
        # The mean above is that of a rig at rest with point-like lens and lamp, and without a screen.
        rig.camera.focus_distance_m is not None or rig.laser.source_radius_m > 0.0,
        rig.motion_m_per_s is not None or rig.screen is not None,
    )
    return "quasi" if any(outside) else "exact"


def _sigma(capture: xr.Dataset, truth: Float, rig: GatedRig, tables: list[correlation.Table], n_g: float) -> Float:
    from .gated_kernel import range_sigma

    shape = (truth.shape[0], truth.shape[1])
    slices = int(capture.sizes["slice"])
    background = np.asarray(capture["truth_background"].values, np.float64)
    dims = capture["truth_background"].dims
    if dims == ("slice",):
        background = background[:, None, None]
    background = np.broadcast_to(background, (slices, *shape))
    largest = float(background.max(initial=0.0))
    amplitude = np.asarray(capture["truth_amplitude"].values, np.float64)
    time, time_slope = path_delay(truth, rig, n_g)
    peak = max(float(table.value.max()) for table in tables)
    information = _information(rig, background, float(np.nanmax(amplitude, initial=0.0)) * peak)
    width = max(table.value.size for table in tables)
    value, slope = np.zeros((len(tables), width)), np.zeros((len(tables), width))
    for row, table in enumerate(tables):  # tables end in zeros, so that padding with zeros continues them
        value[row, : table.value.size], slope[row, : table.slope.size] = table.value, table.slope
    usable = np.asarray(capture["valid"].values, bool)
    lit = np.asarray(capture["laser_on"].values, bool)
    result = range_sigma(
        truth, np.ascontiguousarray(amplitude), np.ascontiguousarray(halo_of(capture)), background, largest, time, time_slope,
        np.ascontiguousarray(gate_offsets(rig, shape)), true_delay(capture, rig),
        np.asarray(capture["gate"].values, np.int64), lit, usable,
        np.array([table.start_s for table in tables]), np.array([table.inv_step for table in tables]), value, slope,
        *information,
    )  # fmt: skip
    return np.asarray(result, np.float64)


def _information(rig: GatedRig, background: npt.NDArray[Any], brightest: float) -> tuple[float, float, Float]:
    """ln J on a uniform grid of ln μ that covers all means of the capture: (first ln μ, 1/step, values)."""
    low = max(float(background.min()), 1e-4)
    high = max(brightest + float(background.max()), 2.0 * low)
    low = min(low, high / 10.0)
    grid = np.linspace(math.log(low * 0.99), math.log(high * 1.01), 1 + math.ceil(64 * math.log(high / low)))
    table = information_table(noise_model(rig))
    values = np.log(np.maximum(np.asarray(table(np.exp(grid)), np.float64), 1e-300))
    return float(grid[0]), float(1.0 / (grid[1] - grid[0])), values
