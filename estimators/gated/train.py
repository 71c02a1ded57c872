"""Train the learned estimator from captures on disk.

    beambench generate learned-training -o training
    beambench estimators train --data training --out weights.npz

The data are stores of gated captures with truth; with those of suite `learned-training` and the defaults the result is the
file that ships. Use other weights as `learned[weights=weights.npz]`.
"""

from __future__ import annotations

import io
import math
import os
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...captures import open_captures
from ...scenes.errors import InputError
from .learned import predict
from .tools.features import FEATURES, SIGNIFICANCE, features_of
from .tools.instrument import instrument_of
from .tools.stack import read_stack

__all__ = ["fit", "samples_of", "stores_of", "train"]

Float = npt.NDArray[np.float64]
#: Errors beyond this many σ_R are another echo's: no answer about a first guess can mend them.
FAR = 1.5
#: Most pixels taken of one capture, so that a large one does not drown the others.
MOST = 20_000
#: E ln|z| of a normal variable, with the sign turned: what separates a mean log error from a log standard error.
LOG_NORMAL = 0.635
#: Most first guesses that may be another echo's at a photon level and significance that count as learned.
STRAY = 1e-3


def samples_of(capture: xr.Dataset, min_snr: float, rng: np.random.Generator) -> tuple[Float, Float, Float]:
    """(features, answers, echo's photoelectrons) of a capture's unmixed pixels with truth; answer = (τ_true − τ₀)/σ_R."""
    stack = read_stack(capture)
    rig = stack.instrument
    if rig.gate_offset() is not None or rig.laser_m.any():
        raise InputError("training needs a coaxial rig without gate maps", where="attribute rig")
    features, guess, width, ok, light = features_of(stack, min_snr)
    truth = np.asarray(capture["truth_range"].values, dtype=np.float64)
    with np.errstate(invalid="ignore"):
        answer = (truth / rig.m_per_s - guess) / width[0]
        good = ok & np.isfinite(truth)
    if "truth_mixed" in capture:
        good &= ~capture["truth_mixed"].values.astype(bool)
    index = np.flatnonzero(good)
    if index.size > MOST:
        index = np.sort(rng.choice(index, MOST, replace=False))
    return features.reshape(-1, FEATURES)[index], answer.reshape(-1)[index], light.reshape(-1)[index]


def _design(features: Float, centre: Float, scale: Float, hidden: Float, bias: Float) -> Float:
    f = (features - centre) * scale
    return np.concatenate([np.ones((f.shape[0], 1)), f, np.tanh(f @ hidden.T + bias)], axis=1)


def _sound_from(decades: Float, near: npt.NDArray[np.bool_]) -> float:
    """The tenth of a decade above which a first guess is another echo's in at most STRAY of the samples: below it the
    error has tails that a standard error does not tell."""
    tenth = np.floor(10 * decades).astype(np.int64)
    bad = [step for step in np.unique(tenth) if not near[tenth == step].mean() >= 1 - STRAY]
    return (max(bad) + 1) / 10 if bad else float(decades.min())


def _held(features: Float, answers: Float, light: Float) -> dict[str, Any]:
    """What the samples hold, as `Weights` keeps it: the limits outside which nothing was learned."""
    near = np.abs(answers) < FAR
    low, high = features[near].min(axis=0), features[near].max(axis=0)
    low[SIGNIFICANCE] = _sound_from(features[:, SIGNIFICANCE], near)
    return {"low": low, "high": high, "light": np.array([10 ** _sound_from(np.log10(light), near), light[near].max()])}


def _ridge(x: Float, y: Float, ridge: float) -> Float:
    penalty = ridge * x.shape[0] * np.eye(x.shape[1])
    penalty[0, 0] = 0.0
    try:
        found = np.asarray(np.linalg.solve(x.T @ x + penalty, x.T @ y))
    except np.linalg.LinAlgError:
        found = np.full(x.shape[1], np.nan)
    if not np.isfinite(found).all():
        raise InputError(
            "These captures do not determine the weights.", where="--ridge", value=ridge, allowed="a ridge above 0",
            next_step="leave out --ridge: 1e-5 if not given",
        )  # fmt: skip
    return found


def fit(
    features: Float, answers: Float, light: Float, *, units: int, ridge: float, seed: int, excess: float = 1.0
) -> dict[str, Any]:
    """Weights from samples, shuffled by seed: ¾ fit the answer, the rest the error and its calibration. Samples whose
    first guess is another echo's tell only where the learned range begins; excess: the greatest of the samples' rigs.

    Raises InputError where there are fewer than 10 samples per unit.
    """
    every, near = (features, answers, light), np.abs(answers) < FAR
    features, answers = features[near], answers[near]
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
    # In double precision: rounded, a limit could leave out the sample that it is taken from.
    weights |= _held(*every) | {"excess": np.float64(excess)}
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
    _check(units, ridge, seed, min_snr)
    stores = stores_of(data)
    rng = np.random.default_rng([seed, 0])
    parts, names, excess = [], [], 1.0
    for path in stores:
        seeds = []
        for capture in open_captures(path):
            parts.append(samples_of(capture, min_snr, rng))
            excess = max(excess, instrument_of(capture).excess)
            seeds.append(str(capture.attrs.get("seed", "?")))
        names.append(f"{path.stem} {', '.join(seeds)}")
    features, answers, light = (np.concatenate([p[i] for p in parts]) for i in range(3))
    weights = fit(features, answers, light, units=units, ridge=ridge, seed=seed, excess=excess)
    _write(Path(out), {**weights, "trained_on": np.array("; ".join(names))})
    return {
        "captures": len(parts), "pixels": int((np.abs(answers) < FAR).sum()), "rms_held_out": float(weights["rms_held_out"]),
        "rms_first_guess": float(weights["rms_first_guess"]), "bytes": Path(out).stat().st_size,
    }  # fmt: skip


def _check(units: int, ridge: float, seed: int, min_snr: float) -> None:
    """Refuse parameters that train nothing, before any capture is read."""

    def whole(value: object) -> bool:
        return isinstance(value, int) and not isinstance(value, bool)

    rules = (
        ("units", units, "a whole number, 1 … 10,000", whole(units) and 1 <= units <= 10_000),
        ("ridge", ridge, "a finite number, 0 … 10⁶", _finite(ridge) and 0.0 <= ridge <= 1e6),
        ("seed", seed, "a whole number, 0 or more", whole(seed) and seed >= 0),
        ("min_snr", min_snr, "a finite number above 0", _finite(min_snr) and min_snr > 0.0),
    )
    for name, value, allowed, fits in rules:
        if not fits:
            raise InputError(
                "A parameter of the training is out of range.", where=f"--{name}", value=value, allowed=allowed,
                next_step="beambench estimators train --help",
            )  # fmt: skip


def _finite(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _write(path: Path, arrays: Mapping[str, Any]) -> None:
    """An .npz whose members carry no time of writing, unlike numpy's own. Whole or not at all: what stood there before
    stays until the new file is on disk."""
    whole = io.BytesIO()
    with zipfile.ZipFile(whole, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, array in arrays.items():
            buffer = io.BytesIO()
            np.lib.format.write_array(buffer, np.asarray(array), allow_pickle=False)
            archive.writestr(zipfile.ZipInfo(f"{name}.npy"), buffer.getvalue(), zipfile.ZIP_DEFLATED)
    partial = path.with_name(path.name + ".partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with open(partial, "wb") as file:
            file.write(whole.getvalue())
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise InputError(
            "The weights cannot be written there.", where=str(path), value=error.strerror or str(error),
            next_step="choose another place with --out, or make room",
        ) from error  # fmt: skip
