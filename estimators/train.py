"""Train the learned estimator from captures on disk.

    beambench generate learned-training -o training
    beambench estimators train --data training --out weights.npz

The data are stores of gated captures with truth; with those of suite `learned-training` and the defaults the result is the
file that ships. Use other weights as `learned[weights=weights.npz]`.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping, Sequence
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

__all__ = ["fit", "samples_of", "stores_of", "train"]

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


def stores_of(data: Sequence[str | Path]) -> list[Path]:
    """The stores (*.zarr) that paths name: each a store, or a folder that holds some; a folder's by name.

    Raises InputError where a path holds none.
    """
    found: list[Path] = []
    for given in data:
        path = Path(given).expanduser()
        inside = [path] if (path / "zarr.json").is_file() else sorted(path.glob("*.zarr"))
        if not inside:
            raise InputError(
                "no captures to train on", where="--data", value=str(given), allowed="a store, or a folder of *.zarr",
                next_step="beambench generate learned-training -o training",
            )  # fmt: skip
        found += inside
    return found


def train(
    data: Sequence[str | Path], out: str | Path, *, units: int = 96, ridge: float = 1e-5, seed: int = 1,
    min_snr: float = 4.0,
) -> dict[str, float]:  # fmt: skip
    """Train on the captures of all stores in `data` and write the weights to `out` (.npz, below 200 kB).

    Equal data and parameters give equal bytes on one machine.
    Returns the numbers of captures and pixels, the held-out rms error in σ_R, and the first guess's.
    Raises InputError for unusable data or parameters.
    """
    if units < 1 or ridge < 0:
        raise InputError(
            "parameters out of range", where="train", value=(units, ridge), allowed="units >= 1, ridge >= 0"
        )
    rng = np.random.default_rng([seed, 0])
    parts, names = [], []
    for path in stores_of(data):
        seeds = []
        for capture in open_captures(path):
            parts.append(samples_of(capture, min_snr, rng))
            seeds.append(str(capture.attrs.get("seed", "?")))
        names.append(f"{path.stem} {', '.join(seeds)}")
    features = np.concatenate([p[0] for p in parts])
    answers = np.concatenate([p[1] for p in parts])
    weights = fit(features, answers, units=units, ridge=ridge, seed=seed)
    Path(out).parent.mkdir(parents=True, exist_ok=True)
    _write(Path(out), {**weights, "trained_on": np.array("; ".join(names))})
    return {
        "captures": len(parts), "pixels": int(answers.size), "rms_held_out": float(weights["rms_held_out"]),
        "rms_first_guess": float(weights["rms_first_guess"]), "bytes": Path(out).stat().st_size,
    }  # fmt: skip


def _write(path: Path, arrays: Mapping[str, Any]) -> None:
    """An .npz whose members carry no time of writing, unlike numpy's own."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, array in arrays.items():
            buffer = io.BytesIO()
            np.lib.format.write_array(buffer, np.asarray(array), allow_pickle=False)
            archive.writestr(zipfile.ZipInfo(f"{name}.npy"), buffer.getvalue(), zipfile.ZIP_DEFLATED)
