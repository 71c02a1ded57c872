"""Pulse, gate and time zero from a scan of delays over a target, by weighted least squares on the declared samples.

The mean count of delay k and pixel i, above its dark level, is

    y_ki = a_i R(τ_i + δ − t_k; 1 + p, 1 + g) + b_i,
 R the correlation of pulse and gate whose times are stretched by 1 + p and 1 + g (`estimators.response`). Amplitude a_i and
what stands still, b_i, belong to the pixel and are eliminated; p and g belong to all pixels. The echo's time τ_i is fitted in
every pixel, or, with a surveyed target, known but for the common shift δ, which is the error of the declared time zero.
Fisher scoring, three steps:

    H = Σ_i [C_iᵀ W C_i − C_iᵀ W L_i (L_iᵀ W L_i)⁻¹ L_iᵀ W C_i],     (p, g, δ) = H⁻¹ g,     covariance H⁻¹,
 with L the columns of one pixel, C the common ones, W = 1/variance of the mean. Where pulse and gate widen R in the same way
(two Gaussians), H is singular in p − g, and only the response as a whole is told.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ...scenes.errors import InputError
from ..response import Response, correlate_samples
from ..rig import DeclaredRig, Samples
from .gated_noise import Found, dark_statistics, noise_statistics
from .gated_scan import DelayScan

__all__ = [
    "ResponseFit",
    "delays_before",
    "fit_response",
    "lit_pixels",
    "response_profile",
    "time_bound_s",
]

Float = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

_STEPS = 5
#: Amplitude of a lit pixel, in its standard errors.
_LIT = 5.0
#: Steps below this many standard errors end the fit.
_SETTLED = 0.05
#: Finite difference of a stretch; R is smooth in it.
_STRETCH = 0.01
#: Pulse and gate are told apart where the standard errors of both stretches are below this.
_APART = 0.03


@dataclass(frozen=True, eq=False)
class ResponseFit:
    """What a scan tells of the response.

    Main arguments:
        pulse, gate: stretch of the declared pulse and gate, 1 where they are right; NaN where they are not told apart.
        response: stretch of R as a whole. shift_s: common shift of the echo, s; NaN where every pixel has its own.
        tau_s, tau_sigma_s, amplitude, amplitude_sigma, still: per pixel; DN for the last three.
        chi2: Σ of squared residuals over their variances, per pixel. dof: its degrees of freedom. frames: what light and time of
        whole frames, which vary, add to chi2 in the mean, per pixel.
        single: pixels that the stretches and the shift come from.
    """

    pulse: Found
    gate: Found
    response: Found
    shift_s: Found
    tau_s: Float
    tau_sigma_s: Float
    amplitude: Float
    amplitude_sigma: Float
    still: Float
    chi2: Float
    dof: int
    frames: Float
    single: Mask


@dataclass(frozen=True, eq=False)
class _Data:
    """Mean counts above dark (delay, pixel), their variances, and delays. `dark`: frames that the dark level is the mean of."""

    y: Float
    slope: float
    floor: Float
    repeats: int
    dark: float
    delay_s: Float
    fluctuation: float
    jitter_s: float
    single: Mask

    def variance(self, mean: Float) -> Float:
        """Variance of a mean over repeats at a light level, DN²."""
        return np.asarray((self.floor + self.slope * np.maximum(mean, 0.0)) / self.repeats)


def _stretched(samples: Samples, factor: float) -> Samples:
    return Samples(samples.start_s * factor, samples.step_s * factor, samples.value)


def _response(rig: DeclaredRig, pulse: float, gate: float) -> Response:
    jitter = rig.number("laser.jitter_shot_s", least=0)
    return correlate_samples(
        _stretched(rig.samples("pulse"), pulse), _stretched(rig.samples("gates.0"), gate), jitter_s=jitter
    )


def fit_response(
    scan: DelayScan, *, known_s: Float | None = None, light: Float | None = None, single: Mask | None = None,
    noise: Mapping[str, Found] | None = None, dark: Mapping[str, Found] | None = None,
) -> ResponseFit:  # fmt: skip
    """Fit stretches of pulse and gate, and the time of the echo, to a scan.

    Main arguments:
        scan: of a target that fills the image. known_s: times of the echo (pixel), if the target was surveyed.
    Other arguments:
        light: counts above the dark level (delay, pixel) to fit instead of the scan's means, e.g. those that a model expects.
        single: pixels (pixel) that stretches and shift are taken from, e.g. those with one echo (`gated_single`); all by default.
        noise, dark: statistics of the scan, where they are known already (`gated_noise`).

    Where pulse and gate are told apart, `response` is NaN; where not, these are, and the response is stretched as a whole.

    Raises:
        InputError: no pixel shows an echo within the scan, or the declared rig lacks pulse, gate or medium.
    """
    noise, dark = noise or noise_statistics(scan, errors=False), dark or dark_statistics(scan, errors=False)
    level = scan.dark.astype(np.float64).mean(axis=0)
    varies = noise["fluctuation"].value
    data = _Data(
        scan.counts.astype(np.float64).mean(axis=1) - level if light is None else light,
        max(noise["slope"].value, 1e-12),
        np.full(level.shape, max(dark["noise"].value ** 2, 1.0 / 12.0)),
        scan.repeats,
        len(scan.dark) if light is None else math.inf,
        scan.delay_s,
        max(varies, 0.0) if math.isfinite(varies) else 0.0,
        float(scan.rig.get("laser.jitter_frame_s") or 0.0),  # a laboratory need not know it
        np.ones(level.size, bool) if single is None else single,
    )
    nothing = Found(math.nan, math.nan)
    best = _fit(scan.rig, data, known_s, ("pulse", "gate"))
    told = all(one.sigma < _APART for one in (best.common["pulse"], best.common["gate"]))
    if not told:
        best = _fit(scan.rig, data, known_s, ("both",))
    return ResponseFit(
        best.common["pulse"] if told else nothing, best.common["gate"] if told else nothing,
        nothing if told else best.common["both"], best.common.get("shift", nothing),
        best.tau, best.tau_sigma, best.amplitude, best.amplitude_sigma, best.still, best.chi2, best.dof, best.frames, data.single,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Fitted:
    common: Mapping[str, Found]
    tau: Float
    tau_sigma: Float
    amplitude: Float
    amplitude_sigma: Float
    still: Float
    chi2: Float
    dof: int
    frames: Float


def _start(response: Response, data: _Data) -> Float:
    """Times of the echo by the best match of R on a grid of a quarter of its width; R's own centroid where all is dark."""
    step = 0.25 * math.sqrt(response.variance_s2)
    grid = np.arange(data.delay_s[0] + response.lo_s, data.delay_s[-1] + response.hi_s, step)
    shape = response(grid[:, None] - data.delay_s)[0]
    shape = shape - shape.mean(axis=1, keepdims=True)
    norm = np.sqrt((shape**2).sum(axis=1))
    score = (shape / np.maximum(norm, 1e-3 * norm.max())[:, None]) @ data.y
    return np.asarray(grid[score.argmax(axis=0)])


def _fit(rig: DeclaredRig, data: _Data, known_s: Float | None, stretches: tuple[str, ...]) -> _Fitted:
    shared = dict.fromkeys(stretches, 1.0)
    shift = 0.0
    tau = _start(_response(rig, 1.0, 1.0), data) if known_s is None else np.array(known_s, np.float64)
    steps = _STEPS if known_s is not None else 2 * _STEPS
    for step in range(steps + 1):
        own, columns, local = _design(rig, data, shared, tau + shift, known_s is None)
        weight = 1.0 / data.variance(own.light)
        solved = _solve(columns, local, own.residual, weight, data.single)
        scale = 1.0 / np.sqrt(np.maximum(np.diag(solved.normal), 1e-300))
        settled = step > 0 and bool((np.abs(solved.common) < _SETTLED * scale).all())
        if known_s is None:
            settled = settled and step > 3
        if step == steps or settled:
            break
        limit = 0.2 * math.sqrt(own.response.variance_s2)
        for name, change in zip(stretches, solved.common, strict=False):
            shared[name] = float(np.clip(shared[name] + np.clip(change, -0.1, 0.1), 0.3, 3.0))
        if known_s is None:
            tau = tau + np.clip(solved.local[:, 1] / np.where(own.amplitude > 0, own.amplitude, np.inf), -limit, limit)
        else:
            shift += float(np.clip(solved.common[-1], -limit, limit))
    covariance = _covariance(data, own, columns, local, weight, solved)
    error = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    common = {name: Found(shared[name], float(error[i])) for i, name in enumerate(stretches)}
    if known_s is not None:
        common["shift"] = Found(shift, float(error[-1]))
    sigma = np.sqrt(np.maximum(np.diagonal(solved.inverse, axis1=1, axis2=2), 0.0))
    lit = own.amplitude > 0
    tau_sigma = (
        np.where(lit, sigma[:, 1] / np.where(lit, own.amplitude, 1.0), np.inf)
        if known_s is None
        else np.zeros(tau.size)
    )
    rest = own.residual - np.einsum("kpl,pl->kp", local, solved.local) - np.einsum("kpc,c->kp", columns, solved.common)
    dof = data.y.shape[0] - local.shape[2]
    return _Fitted(
        common, tau + shift, tau_sigma, own.amplitude, sigma[:, 0], own.still,
        np.asarray((weight * rest**2).sum(axis=0)), dof, _frames(data, own, weight),
    )  # fmt: skip


def _frames(data: _Data, own: _Own, weight: Float) -> Float:
    """Σ_k W [(f y)² + (j a R′)²]/repeats of every pixel: f the relative rms of a frame's light, j that of its delay, s."""
    moved = (data.fluctuation * own.echo) ** 2 + (data.jitter_s * own.amplitude * own.slope) ** 2
    return np.asarray((weight * moved).sum(axis=0) / data.repeats)


def _covariance(data: _Data, own: _Own, columns: Float, local: Float, weight: Float, solved: _Solved) -> Float:
    """H⁻¹, and what the light of whole frames adds that varies by f: H⁻¹ Σ_k g_k g_kᵀ f²/repeats H⁻¹, g_k = Σ_i W C̃ (y's
    light), C̃ the common columns without what the pixels' own explain."""
    inverse = np.linalg.inv(solved.normal)
    cross = np.einsum("kpl,kp,kpc->plc", local, weight, columns)
    left = columns - np.einsum("kpl,plc->kpc", local, np.einsum("plm,pmc->plc", solved.inverse, cross))
    frame = np.einsum("kpc,kp,kp->kc", left, weight * data.single, own.light)
    return np.asarray(inverse + inverse @ (frame.T @ frame) @ inverse * data.fluctuation**2 / data.repeats)


@dataclass(frozen=True, eq=False)
class _Own:
    response: Response
    amplitude: Float
    still: Float
    light: Float
    echo: Float
    residual: Float
    slope: Float


def _design(
    rig: DeclaredRig, data: _Data, shared: Mapping[str, float], tau: Float, free: bool
) -> tuple[_Own, Float, Float]:
    """Amplitudes and constants of the pixels at the present times; columns (delay, pixel, common) and (delay, pixel, local)."""
    both = shared.get("both", 1.0)
    pulse, gate = both * shared.get("pulse", 1.0), both * shared.get("gate", 1.0)
    centre = _response(rig, pulse, gate)
    u = tau[None, :] - data.delay_s[:, None]
    r, slope, _ = centre(u)
    amplitude, still, standing = _linear(r, data)
    echo = amplitude * r
    columns = []
    for name in shared:
        moved = [
            _response(
                rig, pulse * (1 + s * (name != "gate")), gate * (1 + s * (name != "pulse"))
            )(u)[0]
            for s in (_STRETCH, -_STRETCH)
        ]  # fmt: skip
        columns.append(amplitude * (moved[0] - moved[1]) / (2 * _STRETCH) / shared[name])
    if not free:
        columns.append(amplitude * slope)
    local = [r, slope, np.ones_like(r)] if free else [r, np.ones_like(r)]
    own = _Own(centre, amplitude, still, echo + standing, echo, data.y - echo - still, slope)
    return own, np.stack(columns, axis=-1), np.stack(local, axis=-1)


def _linear(r: Float, data: _Data) -> tuple[Float, Float, Float]:
    """Amplitude and constant of every pixel, weighted by the variances of the mean that a first, unweighted fit gives; and the
    light in that constant."""
    weight = np.ones_like(r)
    for step in range(2):
        total, first = weight.sum(axis=0), (weight * r).sum(axis=0)
        square = (weight * r * r).sum(axis=0)
        one, cross = (weight * data.y).sum(axis=0), (weight * r * data.y).sum(axis=0)
        determinant = np.maximum(total * square - first**2, 1e-30)
        amplitude = (total * cross - first * one) / determinant
        still = (square * one - first * cross) / determinant
        # The unweighted fit's own variance is that of its weights of 1: times the floor, which is the least it can be.
        error = square / determinant * (data.floor / data.repeats if step == 0 else 1.0)
        standing = _standing(still, error + data.floor / data.dark, data.single)
        weight = 1.0 / data.variance(np.maximum(amplitude, 0.0) * r + standing)
    return amplitude, still, standing


def _standing(still: Float, variance: Float, single: Mask) -> Float:
    """Light that is the same at all delays (pixel), DN, from the fitted constants.

    A constant holds the noise of the pixel's dark level, which is no light: taken for light where it is above 0, it raised the
    variances, and χ² came out 3 % too low with four dark frames. Constants are therefore drawn together, to their median, by
    the share of their scatter that noise explains (half the distance of the quantiles .16 and .84 stands for the scatter).
    """
    low, middle, high = np.quantile(still[single], (0.159, 0.5, 0.841))
    scatter, noise = (0.5 * (high - low)) ** 2, float(np.median(variance[single]))
    share = 1.0 - min(noise / scatter, 1.0) if scatter > 0.0 else 0.0
    return np.asarray(np.maximum(middle + share * (still - middle), 0.0))


@dataclass(frozen=True, eq=False)
class _Solved:
    common: Float
    local: Float
    normal: Float
    inverse: Float


def _solve(columns: Float, local: Float, residual: Float, weight: Float, single: Mask) -> _Solved:
    """One step of scoring with the pixels' own columns eliminated. A pixel without an echo, whose own columns are dependent,
    is left out; pixels that are not `single` have no say in what is common."""
    wl = local * weight[..., None]
    inner = np.einsum("kpl,kpm->plm", wl, local)
    scale = np.sqrt(np.maximum(np.diagonal(inner, axis1=1, axis2=2), 1e-300))
    unit = inner / scale[:, :, None] / scale[:, None, :]
    good = np.linalg.eigvalsh(unit)[:, 0] > 1e-9
    if not (good & single).any():
        raise _no_echo()
    unit[~good] = np.eye(unit.shape[1])
    inverse = np.linalg.inv(unit) / scale[:, :, None] / scale[:, None, :]
    inverse[~good] = 0.0
    right = np.einsum("kpl,kp->pl", wl, residual)
    cross = np.einsum("kpl,kpc->plc", wl, columns)
    wc = columns * (weight * (good & single))[..., None]
    told = cross * single[:, None, None]
    normal = np.einsum("kpc,kpd->cd", wc, columns) - np.einsum("plc,plm,pmd->cd", told, inverse, cross)
    gradient = np.einsum("kpc,kp->c", wc, residual) - np.einsum("plc,plm,pm->c", told, inverse, right)
    try:
        common = np.linalg.solve(normal, gradient)
    except np.linalg.LinAlgError as error:
        raise _no_echo() from error
    own = np.einsum("plm,pm->pl", inverse, right - np.einsum("plc,c->pl", cross, common))
    return _Solved(common, own, normal, inverse)


def _no_echo() -> InputError:
    return InputError(
        "No pixel shows an echo within the scan.", where="counts", next_step="scan the delays of the target's echo"
    )


def time_bound_s(scan: DelayScan, fit: ResponseFit) -> Float:
    """Least standard error [s] of the echo's time in one repeat, (pixel): 1/√(F₀₀ − F₀₁²/F₁₁) of time and amplitude,
    background known, in the moment form (a Gaussian of the counts' variance); infinite where no light is."""
    noise, dark = noise_statistics(scan, errors=False), dark_statistics(scan, errors=False)
    pulse, gate = ((one.value if math.isfinite(one.value) else fit.response.value) for one in (fit.pulse, fit.gate))
    r, slope, _ = _response(scan.rig, pulse, gate)(fit.tau_s[None, :] - scan.delay_s[:, None])
    a = np.maximum(fit.amplitude, 0.0)
    weight = 1.0 / (dark["noise"].value ** 2 + noise["slope"].value * a * np.maximum(r, 0.0))
    f00, f01, f11 = (
        (weight * (a * slope) ** 2).sum(axis=0),
        (weight * a * slope * r).sum(axis=0),
        (weight * r * r).sum(axis=0),
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where((f11 > 0) & (a > 0), 1.0 / np.sqrt(f00 - f01**2 / f11), np.inf))


def response_profile(scan: DelayScan, fit: ResponseFit, bins: int = 48) -> dict[str, Any]:
    """The response as measured, without a model of its shape: R/max R against u = τ − t, pooled over single pixels in even bins.

    Returns `u_s`, `value` and `sigma` (bin), the last two relative to the fitted amplitude; bins that no sample falls into
    are NaN. A pixel's τ and amplitude come from the fit, so that the profile shows where the measured shape leaves the
    declared one.
    """
    y = scan.counts.astype(np.float64).mean(axis=1) - scan.dark.astype(np.float64).mean(axis=0) - fit.still
    spread = scan.counts.astype(np.float64).var(axis=1, ddof=1) / scan.repeats
    u = fit.tau_s[None, :] - scan.delay_s[:, None]
    used = np.broadcast_to(fit.single & lit_pixels(fit), u.shape)
    edges = np.linspace(float(u[used].min(initial=0.0)), float(u[used].max(initial=1e-12)), bins + 1)
    place = np.clip(np.searchsorted(edges, u[used], side="right") - 1, 0, bins - 1)
    a = np.broadcast_to(fit.amplitude, u.shape)[used]
    weight = np.bincount(place, a**2, bins)
    with np.errstate(divide="ignore", invalid="ignore"):
        value = np.bincount(place, a * y[used], bins) / weight
        sigma = np.sqrt(np.bincount(place, a**2 * spread[used], bins)) / weight
    return {"u_s": 0.5 * (edges[1:] + edges[:-1]), "value": value, "sigma": sigma}


def lit_pixels(fit: ResponseFit) -> Mask:
    """Pixels (pixel) that show an echo, five standard errors or more."""
    return np.asarray(fit.amplitude > _LIT * fit.amplitude_sigma)


def delays_before(scan: DelayScan, tau_s: Float) -> npt.NDArray[np.bool_]:
    """Delays (delay) at which the gate has closed before the echo of any pixel arrives: what they show is scattered on the
    way."""
    response = _response(scan.rig, 1.0, 1.0)
    known = tau_s[np.isfinite(tau_s)]
    # 1.1: the response may be wider than declared.
    late = response.centroid_s + 1.1 * (response.hi_s - response.centroid_s)
    return np.asarray(float(np.quantile(known, 0.001)) - scan.delay_s > late)
