"""gated-net: a small network reads each pixel of a gated stack. It needs NumPy alone; train_gated_net.py makes the weights."""

from __future__ import annotations

import math
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
import xarray as xr

from beambench.estimators import estimator, range_result, read_stack
from beambench.scenes.errors import InputError

Float = npt.NDArray[np.float64]

#: Slices to either side of the brightest one that the network sees.
REACH = 4
WINDOW = 2 * REACH + 1
#: Profile, response at the same places, then lg of light and of background, significance, and places beyond the stack.
FEATURES = 2 * WINDOW + 4
LAYERS = ("w0", "b0", "w1", "b1", "w2", "b2")


def features_of(capture: xr.Dataset) -> tuple[Float, Float, float, npt.NDArray[np.bool_]]:
    """(features (row, col, FEATURES), delay of the brightest slice [s] (row, col), step of the delays [s], sound (row, col)).

    Slices finer than the response's standard deviation are averaged in groups of about that width, which stand for slices. All
    is relative to the brightest slice and to the step, so that what is learned at one range holds at all. The instrument enters as
    samples of its response.
    """
    stack = read_stack(capture)
    rig = stack.instrument
    n = stack.signal
    shape = stack.counts.shape[1:]
    response = rig.responses[int(stack.gate[0])] if n else None
    bins = 1 if response is None else math.ceil(np.sqrt(response.variance_s2) / stack.spacing_s() - 0.01)
    if response is None or n // bins < WINDOW:
        return np.zeros((*shape, FEATURES)), np.zeros(shape), 1.0, np.zeros(shape, bool)
    light, reads = np.zeros((n, *shape)), np.zeros(n)
    sound = np.ones(shape, bool)
    for place, group in zip(stack.slices, stack.group, strict=True):
        if group < n:
            counts = stack.counts[place].astype(np.float64)
            sound &= np.isfinite(counts) & (counts < rig.saturation_dn)
            light[group] += (np.nan_to_num(counts) - rig.offset_dn) / rig.dn_per_pe
            reads[group] += 1.0
    light /= reads[:, None, None]
    delay, step, n = stack.centroid_delay_s, bins * stack.spacing_s(), n // bins
    light = light[: n * bins].reshape(n, bins, *shape).mean(axis=1)
    delay = delay[: n * bins].reshape(n, bins).mean(axis=1)
    background = np.median(light, axis=0)
    smooth = light[:-2] + 2.0 * light[1:-1] + light[2:]
    brightest = 1 + smooth.argmax(axis=0)
    index = brightest + np.arange(-REACH, REACH + 1)[:, None, None]
    inside = (index >= 0) & (index < n)
    window = np.take_along_axis(light, np.clip(index, 0, n - 1), axis=0)
    window = np.where(inside, window - background, 0.0)
    peak = np.maximum(window.max(axis=0), 1e-3)
    noise = np.sqrt(rig.excess * np.maximum(peak + background, 0.0) + rig.floor_var) / np.sqrt(bins)
    offset = response.centroid_s - step * np.arange(-REACH, REACH + 1)
    expected = response(offset)[0] / response.peak
    rows = [
        window / peak,
        np.broadcast_to(expected[:, None, None], window.shape),
        np.log10(bins * peak)[None],
        np.log10(bins * np.maximum(background, 0.0) + 1.0)[None],
        np.log10(peak / noise)[None],
        (~inside).sum(axis=0)[None] / WINDOW,
    ]
    features = np.moveaxis(np.concatenate(rows), 0, -1)
    return features, delay[brightest], step, sound


def forward(weights: dict[str, Float], features: Float) -> tuple[Float, Float]:
    """(place of the echo behind the brightest slice, lg of its standard error) in steps: two layers of tanh, one linear."""
    f = (features - weights["centre"]) * weights["scale"]
    for number in range(2):
        f = np.tanh(f @ weights[f"w{number}"] + weights[f"b{number}"])
    out = f @ weights["w2"] + weights["b2"]
    return out[..., 0], out[..., 1]


@lru_cache(maxsize=2)
def read_weights(path: str | None) -> dict[str, Float]:
    """Weights from an .npz file of numbers: nothing in it can run. Raises InputError where it cannot be used."""
    file = Path(__file__).with_name("gated_net.npz") if path is None else Path(path)
    names = (*LAYERS, "centre", "scale", "factor")
    try:
        with np.load(file, allow_pickle=False) as data:
            weights = {name: np.asarray(data[name], np.float64) for name in names}
    except PermissionError as error:
        raise InputError(
            "The weights of gated-net may not be read.", where=str(file), value=str(error)[:200],
            allowed="in the jail of a run: files of installed packages, and files that a parameter names by an absolute path",
            next_step=f"gated-net[weights={file.resolve()}]",
        ) from error  # fmt: skip
    except (OSError, ValueError, KeyError) as error:
        raise InputError(
            "The weights of gated-net cannot be read.", where=str(file), value=str(error)[:200],
            next_step="python train_gated_net.py DATA --out gated_net.npz",
        ) from error  # fmt: skip
    if weights["centre"].shape != (FEATURES,) or not all(np.isfinite(value).all() for value in weights.values()):
        raise InputError(
            "The weights of gated-net have the wrong shape.", where=str(file), allowed=f"{FEATURES} features"
        )
    return weights


@estimator("gated", cites="docs/training.md (a multilayer perceptron on nine slices, trained on gated-10k)")
def gated_net(capture: xr.Dataset, *, weights: str | None = None, least_sigmas: float = 4.0) -> xr.Dataset:
    """Range and its standard error by a network of two hidden layers, pixel by pixel.

    Invalid where the brightest slice is below `least_sigmas` of its noise, a slice is clipped or dead, or the stated error exceeds
    one step of the delays.
    """
    w = read_weights(weights)
    features, delay, step, sound = features_of(capture)
    place, log_sigma = forward(w, features)
    sigma = w["factor"] * np.exp(np.clip(log_sigma, -8.0, 3.0))
    valid = sound & (features[..., -2] > np.log10(least_sigmas)) & (sigma < 1.0) & (np.abs(place) < 3.0)
    instrument = read_stack(capture).instrument
    return range_result(*instrument.to_range(delay + step * place, step * sigma), valid)
