"""A learned estimator: one layer of fixed random units and a ridge regression, trained on generated captures."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import as_file, files
from pathlib import Path

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...optics.jit import kernel
from ...scenes.errors import InputError
from ...scenes.npz import read_npz
from ..registry import estimator
from ..result import range_result
from .tools.features import FEATURES, features_of, resolved
from .tools.stack import read_stack

__all__ = ["Weights", "learned", "predict", "read_weights"]

Float = npt.NDArray[np.float64]


#: Most bytes of the arrays of a file of weights: 10,000 units have 5 MB.
_MOST_BYTES = 2**26


@dataclass(frozen=True)
class Weights:
    """centre, scale (feature); hidden (unit, feature) and bias (unit), drawn once; answer and log_error
    (1 + feature + unit): linear in 1, the scaled features and the units; factor: calibration of the stated error.

    Limits of the training data: low, high (feature); light (2): least and most photoelectrons of an echo, over F²; excess:
    greatest excess noise factor.
    """

    centre: Float
    scale: Float
    hidden: Float
    bias: Float
    answer: Float
    log_error: Float
    factor: float
    low: Float
    high: Float
    light: Float
    excess: float


@kernel(error_model="numpy")
def predict(features, ok, centre, scale, hidden, bias, answer, log_error, value, error):  # type: ignore[no-untyped-def]
    """Answers of all rows of features (pixel, feature) that are ok: h = tanh(H·f + b), value = w·(1, f, h), error =
    exp(v·(1, f, h)). The pixels are computed one by one, so that no answer depends on other pixels."""
    n, units = centre.size, bias.size
    f = np.empty(n)
    for p in range(features.shape[0]):
        if not ok[p]:
            continue
        a, b = answer[0], log_error[0]
        for i in range(n):
            f[i] = (features[p, i] - centre[i]) * scale[i]
            a += answer[1 + i] * f[i]
            b += log_error[1 + i] * f[i]
        for u in range(units):
            t = bias[u]
            for i in range(n):
                t += hidden[u, i] * f[i]
            t = np.tanh(t)
            a += answer[1 + n + u] * t
            b += log_error[1 + n + u] * t
        value[p], error[p] = a, np.exp(min(max(b, -12.0), 3.0))


@lru_cache(maxsize=4)
def read_weights(path: str | None) -> Weights:
    """Weights from an .npz file, or those that ship with the package. Raises InputError where the file cannot be used."""
    where = path or "library/learned.npz"
    with as_file(files("beambench.estimators.gated") / "library" / "learned.npz") as shipped:
        data = read_npz(
            shipped if path is None else Path(path), "The file of weights", where=where, most_bytes=_MOST_BYTES
        )
    try:
        arrays = {k: np.asarray(data[k], dtype=np.float64) for k in
                  ("centre", "scale", "hidden", "bias", "answer", "log_error", "low", "high", "light")}  # fmt: skip
        numbers = {k: float(data[k]) for k in ("factor", "excess")}
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(
            "The file does not hold weights of the estimator learned.", where=where, value=str(error)[:200],
            next_step="beambench estimators train --data FOLDER --out FILE",
        ) from error  # fmt: skip
    units = arrays["bias"].size
    fit = arrays["hidden"].shape == (units, FEATURES) and arrays["centre"].shape == arrays["scale"].shape == (FEATURES,)
    fit = fit and arrays["low"].shape == arrays["high"].shape == (FEATURES,) and arrays["light"].shape == (2,)
    fit = fit and arrays["answer"].shape == arrays["log_error"].shape == (1 + FEATURES + units,)
    if not fit or not all(np.isfinite(a).all() for a in arrays.values()) or not min(numbers.values()) > 0:
        raise InputError(
            "The weights have the wrong shape or are not finite.", where=where, allowed=f"{FEATURES} features",
            next_step="beambench estimators train --data FOLDER --out FILE",
        )  # fmt: skip
    return Weights(factor=numbers["factor"], excess=numbers["excess"], **arrays)


@estimator("gated", cites="Huang, Zhu and Siew, Neurocomputing 70:489, 2006 (random hidden units, linear output)")
def learned(capture: xr.Dataset, *, weights: str | None = None, min_snr: float = 4.0) -> xr.Dataset:
    """τ = τ₀ + σ_R·w·(1, f, tanh(H f + b)): f the normalised profile about a matched filter's first guess τ₀.

    Trained by `beambench estimators train` on the generated captures of the suite `learned-training`, in water and air (the
    entry `trained_on` of the weights names them); H and b are random and fixed, w comes from one linear solve. The declared
    instrument enters only through τ₀, σ_R and the centroid of R; the effects of water (ramp, halo, attenuation) are learned.
    Other arguments: weights: an .npz file of `train`; min_snr: least amplitude in its approximate standard errors.
    Returns range, sigma [m], valid (row, col). sigma is learned as well (a regression of the logarithm of the error,
    calibrated on captures held out), and at least σ_R·F/√N, that of a centroid of the N photoelectrons of the echo without
    background.
    Invalid: pixels beyond the training data (more excess noise, fewer or more photoelectrons, more background; the weights
    hold the limits), slices farther apart than the points of f, clipped or NaN samples, no echo, a stated error above the
    width of R. Raises InputError for weights that cannot be used.
    """
    if min_snr < 0:
        raise InputError(
            "The least signal must not be negative.", where="learned[min_snr]", value=min_snr, allowed=">= 0"
        )
    w = read_weights(weights)
    stack = read_stack(capture)
    shape = stack.counts.shape[1:]
    value, error = np.full(shape, np.nan), np.full(shape, np.nan)
    # The features show neither a tube noisier than those of the training nor slices wider apart than the points of the
    # profile: the rig does.
    if stack.signal < 5 or stack.instrument.excess > 1.001 * w.excess or not resolved(stack):
        return range_result(value, error, np.zeros(shape, dtype=bool))
    features, guess, width, ok, light = features_of(stack, min_snr)
    with np.errstate(invalid="ignore"):
        ok &= (light >= w.light[0]) & (light <= w.light[1])
    ok &= ((features >= w.low) & (features <= w.high)).all(axis=-1)
    predict(
        features.reshape(-1, FEATURES), ok.reshape(-1), w.centre, w.scale, w.hidden, w.bias, w.answer, w.log_error,
        value.reshape(-1), error.reshape(-1),
    )  # fmt: skip
    with np.errstate(invalid="ignore", divide="ignore"):
        error = np.maximum(w.factor * error, 1 / np.sqrt(light))
        ok &= (error < 1) & (np.abs(value) < 5)
    return range_result(*stack.instrument.to_range(guess + width[0] * value, width[0] * error), ok)
