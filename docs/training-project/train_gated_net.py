"""Train gated-net on a data set, and tell how it does on captures that it has not seen.

    beambench generate gated-10k --set captures=64 -o gated-64
    beambench generate gated-1k --set captures=64 -o walls-64
    python train_gated_net.py gated-64 walls-64 --out gated_net.npz

A network knows the instruments that it was shown: in the landscapes of gated-10k the delays are coarser than the response, in
gated-1k finer. NumPy alone: Adam on the Gaussian likelihood of place and standard error. Equal data and seed give equal weights on
one machine.
"""

from __future__ import annotations

import argparse
import os
from itertools import pairwise
from pathlib import Path

# The matrices are small: on a busy machine threads wait for each other, some ten times longer than one takes for all.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import numpy.typing as npt
from gated_net import FEATURES, features_of, forward

from beambench.captures.readers import Captures
from beambench.estimators import read_stack

Float = npt.NDArray[np.float64]

HIDDEN = 48


def pixels(data: Path, part: str, most: int, rng: np.random.Generator) -> tuple[Float, Float]:
    """(features (n, FEATURES), true place of the echo behind the brightest slice, in steps (n)) of up to `most` pixels a capture.

    Mixed pixels have no one range, and pixels whose echo is lost in the noise, or lies elsewhere, cannot be learned from.
    """
    held: list[Float] = []
    true: list[Float] = []
    parts = Captures(data, ["counts"], part=part)
    for number in parts.places:
        capture = parts.captures[int(number)]
        features, delay, step, sound = features_of(capture)
        rig = read_stack(capture).instrument
        near, far = (rig.to_range(np.full(1, t), np.zeros(1))[0][0] for t in (0.0, 1e-8))
        tau = (capture["truth_range"].values - near) / (far - near) * 1e-8
        place = (tau - delay) / step
        with np.errstate(invalid="ignore"):
            good = sound & ~capture["truth_mixed"].values & (np.abs(place) < 2.0) & (features[..., -2] > np.log10(3.0))
        index = np.flatnonzero(good)
        index = rng.choice(index, min(most, index.size), replace=False)
        held.append(features.reshape(-1, FEATURES)[index])
        true.append(place.ravel()[index])
    return np.concatenate(held), np.concatenate(true)


def gradient(weights: dict[str, Float], f: Float, true: Float) -> tuple[float, dict[str, Float]]:
    """Mean of ½((true − place)/σ)² + ln σ, the logarithm of the likelihood but for a constant, and its gradient."""
    h0 = np.tanh(f @ weights["w0"] + weights["b0"])
    h1 = np.tanh(h0 @ weights["w1"] + weights["b1"])
    out = h1 @ weights["w2"] + weights["b2"]
    log_sigma = np.clip(out[:, 1], -6.0, 2.0)
    z = (out[:, 0] - true) * np.exp(-log_sigma)
    # Beyond three standard errors the square becomes a straight line (Huber): outliers pull no harder.
    pull = np.clip(z, -3.0, 3.0)
    loss = float(np.mean(pull * z - 0.5 * pull**2 + log_sigma))
    inside = (out[:, 1] > -6.0) & (out[:, 1] < 2.0)
    back = np.stack([pull * np.exp(-log_sigma), np.where(inside, 1.0 - pull * z, 0.0)], axis=1) / len(f)
    found = {"w2": h1.T @ back, "b2": back.sum(axis=0)}
    back = (back @ weights["w2"].T) * (1.0 - h1**2)
    found |= {"w1": h0.T @ back, "b1": back.sum(axis=0)}
    back = (back @ weights["w1"].T) * (1.0 - h0**2)
    return loss, found | {"w0": f.T @ back, "b0": back.sum(axis=0)}


def train(features: Float, true: Float, *, epochs: int, seed: int) -> dict[str, Float]:
    """Weights by Adam (Kingma and Ba, ICLR 2015), in batches of 1024, at a rate that falls to zero."""
    rng = np.random.default_rng(seed)
    centre, spread = features.mean(axis=0), features.std(axis=0)
    scale = np.where(spread > 1e-6, 1.0 / np.maximum(spread, 1e-6), 0.0)
    sizes = (FEATURES, HIDDEN, HIDDEN, 2)
    weights = {f"w{i}": rng.standard_normal((a, b)) / np.sqrt(a) for i, (a, b) in enumerate(pairwise(sizes))}
    weights |= {f"b{i}": np.zeros(b) for i, b in enumerate(sizes[1:])}
    first, second = ({name: np.zeros_like(value) for name, value in weights.items()} for _ in range(2))
    scaled = (features - centre) * scale
    batches = max(len(true) // 1024, 1)
    step, total = 0, epochs * batches
    for epoch in range(epochs):
        order, losses = rng.permutation(len(true)), []
        for batch in np.array_split(order, batches):
            step += 1
            loss, slopes = gradient(weights, scaled[batch], true[batch])
            losses.append(loss)
            rate = 3e-3 * (1.0 - step / (total + 1.0))
            for name, slope in slopes.items():
                first[name] += 0.1 * (slope - first[name])
                second[name] += 0.001 * (slope**2 - second[name])
                move = first[name] / (1.0 - 0.9**step) / (np.sqrt(second[name] / (1.0 - 0.999**step)) + 1e-8)
                weights[name] -= rate * move
        print(f"epoch {epoch + 1}/{epochs}: loss {np.mean(losses):.3f}", flush=True)
    return weights | {"centre": centre, "scale": scale, "factor": np.array(1.0)}


def calibrated(weights: dict[str, Float], features: Float, true: Float) -> dict[str, Float]:
    """The weights with the factor that makes 68.3 % of the errors on held-out pixels smaller than the stated one."""
    place, log_sigma = forward(weights, features)
    ratio = np.abs(place - true) * np.exp(-np.clip(log_sigma, -8.0, 3.0))
    return weights | {"factor": np.array(np.quantile(ratio, 0.683))}


def main() -> None:
    """Train, calibrate on the part "validation", save."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, nargs="+", help="data sets")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "gated_net" / "gated_net.npz")
    parser.add_argument("--epochs", type=int, default=40)
    parser.add_argument("--pixels", type=int, default=1000, help="of each capture")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    rng = np.random.default_rng(given.seed)
    held = [pixels(data, "train", given.pixels, rng) for data in given.data]
    others = [pixels(data, "validation", given.pixels, rng) for data in given.data]
    features, true = (np.concatenate(parts) for parts in zip(*held, strict=True))
    weights = train(features, true, epochs=given.epochs, seed=given.seed)
    weights = calibrated(weights, *(np.concatenate(parts) for parts in zip(*others, strict=True)))
    print(f"{len(true)} pixels to train on")
    for data, (seen, place) in zip(given.data, others, strict=True):
        error = forward(weights, seen)[0] - place
        print(f"{data.name}: error on {error.size} others: {np.sqrt(np.mean(error**2)):.3g} steps rms")
    np.savez(given.out, **{name: value.astype(np.float32) for name, value in weights.items()})  # type: ignore[arg-type]


if __name__ == "__main__":
    main()
