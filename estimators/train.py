"""Train the learned estimator from captures on disk.

python -m beambench.estimators.train DATA [DATA ...] --out weights.npz [--units 96] [--ridge 1e-3] [--seed 1]

DATA are stores of gated captures with truth. Use the weights as `learned[weights=weights.npz]`.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from ..captures.store import open_captures
from ..scenes.errors import InputError
from .learned import predict
from .learned_features import FEATURES, features_of
from .stack import read_stack

__all__ = ["fit", "samples_of", "train"]

Float = npt.NDArray[np.float64]
#: Errors beyond this many σ_R are another echo's: no answer about a first guess can mend them.
FAR = 1.5
#: Most pixels taken of one capture, so that a large one does not drown the others.
MOST = 20_000
#: E ln|z| of a normal variable, with the sign turned: what separates a mean log error from a log standard error.
LOG_NORMAL = 0.635


def samples_of(capture: xr.Dataset, min_snr: float, rng: np.random.Generator) -> tuple[Float, Float]:
    """(features, answers) of a capture's unmixed pixels with truth; answer = (τ_true − τ₀)/σ_R, within ±3."""
    stack = read_stack(capture)
    rig = stack.instrument
    if rig.gate_offset() is not None or rig.laser_m.any():
        raise InputError("training needs a coaxial rig without gate maps", where="attribute rig")
    features, guess, width, ok = features_of(stack, min_snr)
    truth = np.asarray(capture["truth_range"].values, dtype=np.float64)
    with np.errstate(invalid="ignore"):
        answer = (truth / rig.m_per_s - guess) / width[0]
        good = ok & np.isfinite(truth) & (np.abs(answer) < FAR)
    if "truth_mixed" in capture:
        good &= ~capture["truth_mixed"].values.astype(bool)
    index = np.flatnonzero(good)
    if index.size > MOST:
        index = np.sort(rng.choice(index, MOST, replace=False))
    return features.reshape(-1, FEATURES)[index], answer.reshape(-1)[index]


def _design(features: Float, centre: Float, scale: Float, hidden: Float, bias: Float) -> Float:
    f = (features - centre) * scale
    return np.concatenate([np.ones((f.shape[0], 1)), f, np.tanh(f @ hidden.T + bias)], axis=1)


def _ridge(x: Float, y: Float, ridge: float) -> Float:
    penalty = ridge * x.shape[0] * np.eye(x.shape[1])
    penalty[0, 0] = 0.0
    return np.asarray(np.linalg.solve(x.T @ x + penalty, x.T @ y))


def fit(features: Float, answers: Float, *, units: int, ridge: float, seed: int) -> dict[str, Any]:
    """Weights from samples, shuffled by seed: ¾ fit the answer, the rest the error and its calibration.

    Raises InputError where there are fewer than 10 samples per unit.
    """
    if answers.size < 10 * (units + FEATURES):
        raise InputError(
            "too few pixels with truth", where="train", value=answers.size, allowed=f"{10 * units} or more"
        )
    rng = np.random.default_rng([seed, 1])
    order = rng.permutation(answers.size)
    cut = 3 * answers.size // 4
    first, second, third = order[:cut], order[cut::2], order[cut + 1 :: 2]
    centre = features[first].mean(axis=0)
    scale = 1 / np.maximum(features[first].std(axis=0), 1e-6)
    hidden = rng.normal(size=(units, FEATURES)) / np.sqrt(FEATURES)
    bias = rng.normal(size=units)
    arrays = (centre, scale, hidden, bias)
    answer = _ridge(_design(features[first], *arrays), answers[first], ridge)
    design = _design(features[second], *arrays)
    log_error = _ridge(design, np.log(np.abs(design @ answer - answers[second]) + 1e-4) + LOG_NORMAL, ridge)
    value, error = np.empty(third.size), np.empty(third.size)
    predict(features[third], np.ones(third.size, dtype=bool), *arrays, answer, log_error, value, error)
    factor = float(np.sqrt(np.mean(((value - answers[third]) / error) ** 2)))
    single = np.float32
    named = ("centre", "scale", "hidden", "bias", "answer", "log_error")
    weights = dict(zip(named, (a.astype(single) for a in (*arrays, answer, log_error)), strict=True))
    rms = float(np.sqrt(np.mean((value - answers[third]) ** 2)))
    return {**weights, "factor": single(factor), "rms_held_out": single(rms), "rms_first_guess": single(answers.std())}


def train(
    data: Iterable[str | Path], out: str | Path, *, units: int = 96, ridge: float = 1e-5, seed: int = 1,
    min_snr: float = 4.0,
) -> dict[str, float]:  # fmt: skip
    """Train on the captures of all stores in `data` and write the weights to `out` (.npz, below 200 kB).

    Returns the numbers of captures and pixels, the held-out rms error in σ_R, and the first guess's.
    Raises InputError for unusable data or parameters.
    """
    if units < 1 or ridge < 0:
        raise InputError(
            "parameters out of range", where="train", value=(units, ridge), allowed="units >= 1, ridge >= 0"
        )
    rng = np.random.default_rng([seed, 0])
    parts, names = [], []
    for path in data:
        for capture in open_captures(path):
            parts.append(samples_of(capture, min_snr, rng))
            names.append(f"{json.loads(capture.attrs['rig']).get('name', '?')} seed {capture.attrs.get('seed', '?')}")
    if not parts:
        raise InputError("no captures to train on", where="train")
    features = np.concatenate([p[0] for p in parts])
    answers = np.concatenate([p[1] for p in parts])
    weights = fit(features, answers, units=units, ridge=ridge, seed=seed)
    Path(out).parent.mkdir(parents=True, exist_ok=True)
    with open(out, "wb") as file:
        np.savez(file, **weights, trained_on=np.array("; ".join(names)))
    return {
        "captures": len(parts), "pixels": int(answers.size), "rms_held_out": float(weights["rms_held_out"]),
        "rms_first_guess": float(weights["rms_first_guess"]), "bytes": Path(out).stat().st_size,
    }  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line. Exit code 2 for unusable input."""
    parser = argparse.ArgumentParser(prog="python -m beambench.estimators.train", description="Train `learned`.")
    parser.add_argument("data", nargs="+", help="stores of gated captures with truth")
    parser.add_argument("--out", required=True, help="where to write the weights (.npz)")
    parser.add_argument("--units", type=int, default=96)
    parser.add_argument("--ridge", type=float, default=1e-5)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args(arguments)
    try:
        found = train(given.data, given.out, units=given.units, ridge=given.ridge, seed=given.seed)
    except InputError as error:
        print(error)
        return 2
    print(", ".join(f"{key} {value:g}" for key, value in found.items()))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
