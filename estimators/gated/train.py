"""Train the learned estimator from captures on disk.

    beambench generate learned-training -o training
    beambench estimators train --data training --out weights.npz

The data are stores of gated captures with truth. From the captures of the suite `learned-training`, with the defaults, come
the weights that ship with the package. Other weights are used as `learned[weights=weights.npz]`.
"""

from __future__ import annotations

import io
import math
import os
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...captures import open_captures
from ...scenes.errors import InputError, reason
from .learned import predict, read_weights
from .tools.features import FEATURES, SIGNIFICANCE, features_of
from .tools.instrument import instrument_of
from .tools.layer import normal_sums
from .tools.stack import read_stack

__all__ = ["fit", "samples_of", "stores_of", "train"]

Float = npt.NDArray[np.float64]
#: Receives the progress: (stage, steps done, of how many, of what).
Tell = Callable[[str, int, int, str], None]
#: First guesses that err by more than this many σ_R belong to another echo: no correction of the guess can mend them.
FAR = 1.5
#: Most pixels taken from one capture, so that a large one does not outweigh the others.
MOST = 20_000
#: −E ln|z| of a normal variable: the difference of the logarithm of a standard error and the mean logarithm of errors.
LOG_NORMAL = 0.635
#: Greatest part of the first guesses at a level of light or significance that may belong to another echo.
STRAY = 1e-3


def samples_of(capture: xr.Dataset, min_snr: float, rng: np.random.Generator) -> tuple[Float, Float, Float]:
    """(features, answers, photoelectrons of the echo) of the unmixed pixels of a capture that have a truth; answer =
    (τ_true − τ₀)/σ_R. Raises InputError for a rig that is not coaxial or declares a map of gate delays."""
    stack = read_stack(capture)
    rig = stack.instrument
    if rig.gate_offset() is not None or rig.laser_m.any():
        raise InputError(
            "Training needs captures of a coaxial rig without a map of gate delays.",
            where="attribute rig: laser.position_m, gate_offset_s", allowed="[0, 0, 0], null",
        )  # fmt: skip
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


def _silent(stage: str, done: int, total: int, text: str) -> None:
    """Say nothing."""


def _sound_from(decades: Float, near: npt.NDArray[np.bool_]) -> float:
    """The tenth of a decade above which at most STRAY of the first guesses belong to another echo: below it the error has
    tails that a standard error does not describe."""
    tenth = np.floor(10 * decades).astype(np.int64)
    bad = [step for step in np.unique(tenth) if not near[tenth == step].mean() >= 1 - STRAY]
    return (max(bad) + 1) / 10 if bad else float(decades.min())


def _held(features: Float, answers: Float, light: Float) -> dict[str, Any]:
    """The limits of the samples, beyond which nothing was learned, as `Weights` holds them."""
    near = np.abs(answers) < FAR
    low, high = features[near].min(axis=0), features[near].max(axis=0)
    low[SIGNIFICANCE] = _sound_from(features[:, SIGNIFICANCE], near)
    return {"low": low, "high": high, "light": np.array([10 ** _sound_from(np.log10(light), near), light[near].max()])}


class _Solver:
    """Least squares of one layer, with the progress of all of them."""

    def __init__(self, layer: tuple[Float, Float, Float, Float], ridge: float, total: int, tell: Tell) -> None:
        self._layer, self._ridge, self._tell, self._total, self._done = layer, ridge, tell, total, 0

    def __call__(self, features: Float, targets: Float, what: str) -> Float:
        """The weights (1 + feature + unit) whose answers are nearest to the targets. Raises InputError where there are none."""
        self._tell("fit", self._done, self._total, what)
        before = self._done
        products, right = normal_sums(
            features, targets, self._layer, lambda pixels: self._tell("fit", before + pixels, self._total, what)
        )
        self._done += targets.size
        penalty = self._ridge * targets.size * np.eye(right.size)
        penalty[0, 0] = 0.0
        try:
            found = np.asarray(np.linalg.solve(products + penalty, right))
        except np.linalg.LinAlgError:
            found = np.full(right.size, np.nan)
        if not np.isfinite(found).all():
            raise InputError(
                "These captures do not determine the weights.", where="--ridge", value=self._ridge,
                allowed="a ridge above 0", next_step="leave out --ridge: its default is 1e-5",
            )  # fmt: skip
        return found


def fit(
    features: Float, answers: Float, light: Float, *, units: int, ridge: float, seed: int, excess: float = 1.0,
    tell: Tell = _silent,
) -> dict[str, Any]:  # fmt: skip
    """Weights from samples, shuffled by seed: ¾ of them fit the answer, the others its error and the calibration of it.

    Samples whose first guess belongs to another echo serve only to find where the learned range begins. excess: the greatest
    excess noise factor of the rigs. tell: receives the pixels that are fitted. Raises InputError where there are fewer than
    10 samples per unit and feature.
    """
    every, near = (features, answers, light), np.abs(answers) < FAR
    features, answers = features[near], answers[near]
    if answers.size < 10 * (units + FEATURES):
        raise InputError(
            "There are too few pixels with truth.", where="--data", value=answers.size,
            allowed=f"{10 * (units + FEATURES)} or more",
        )  # fmt: skip
    rng = np.random.default_rng([seed, 1])
    order = rng.permutation(answers.size)
    cut = 3 * answers.size // 4
    first, second, third = order[:cut], order[cut::2], order[cut + 1 :: 2]
    centre = features[first].mean(axis=0)
    scale = 1 / np.maximum(features[first].std(axis=0), 1e-6)
    hidden = rng.normal(size=(units, FEATURES)) / np.sqrt(FEATURES)
    bias = rng.normal(size=units)
    arrays = (centre, scale, hidden, bias)
    solve = _Solver(arrays, ridge, first.size + second.size, tell)
    answer = solve(features[first], answers[first], "the answer")
    value, error = np.empty(second.size), np.empty(second.size)
    predict(features[second], np.ones(second.size, dtype=bool), *arrays, answer, np.zeros_like(answer), value, error)
    miss = np.log(np.abs(value - answers[second]) + 1e-4) + LOG_NORMAL
    log_error = solve(features[second], miss, "its error")
    value, error = np.empty(third.size), np.empty(third.size)
    predict(features[third], np.ones(third.size, dtype=bool), *arrays, answer, log_error, value, error)
    factor = float(np.sqrt(np.mean(((value - answers[third]) / error) ** 2)))
    single = np.float32
    named = ("centre", "scale", "hidden", "bias", "answer", "log_error")
    weights = dict(zip(named, (a.astype(single) for a in (*arrays, answer, log_error)), strict=True))
    # In double precision: a rounded limit could leave out the sample that it comes from.
    weights |= _held(*every) | {"excess": np.float64(excess)}
    rms = float(np.sqrt(np.mean((value - answers[third]) ** 2)))
    return {**weights, "factor": single(factor), "rms_held_out": single(rms), "rms_first_guess": single(answers.std())}


def stores_of(data: Sequence[str | Path]) -> list[Path]:
    """The stores (*.zarr) that paths name: each a store, or a folder of stores, sorted by name.

    Raises InputError where a path holds no store.
    """
    found: list[Path] = []
    for given in data:
        path = Path(given).expanduser()
        inside = [path] if (path / "zarr.json").is_file() else sorted(path.glob("*.zarr"))
        if not inside:
            raise InputError(
                "The path holds no captures to train on.", where="--data", value=str(given),
                allowed="a store, or a folder of *.zarr",
                next_step="beambench generate learned-training -o training",
            )  # fmt: skip
        found += inside
    return found


def train(
    data: Sequence[str | Path], out: str | Path, *, units: int = 96, ridge: float = 1e-5, seed: int = 1,
    min_snr: float = 4.0, tell: Tell = _silent,
) -> dict[str, float]:  # fmt: skip
    """Train on the captures of all stores in `data` and write the weights to `out` (.npz, below 200 kB).

    Equal data and parameters give equal bytes on one machine. tell: receives every capture, then the pixels that are fitted.
    An older file of weights at `out` is replaced, no other file.
    Returns the numbers of captures and pixels, the rms error of held-out pixels in σ_R, that of the first guess, and bytes.
    Raises InputError for data or parameters that cannot be used.
    """
    _check(units, ridge, seed, min_snr)
    if Path(out).exists():
        read_weights(str(out))
    samples, names, excess = _read(stores_of(data), min_snr, np.random.default_rng([seed, 0]), tell)
    features, answers, light = (np.concatenate([one[i] for one in samples]) for i in range(3))
    weights = fit(features, answers, light, units=units, ridge=ridge, seed=seed, excess=excess, tell=tell)
    _write(Path(out), {**weights, "trained_on": np.array("; ".join(names))})
    return {
        "captures": len(samples), "pixels": int((np.abs(answers) < FAR).sum()), "rms_held_out": float(weights["rms_held_out"]),
        "rms_first_guess": float(weights["rms_first_guess"]), "bytes": Path(out).stat().st_size,
    }  # fmt: skip


def _read(
    stores: Sequence[Path], min_snr: float, rng: np.random.Generator, tell: Tell
) -> tuple[list[tuple[Float, Float, Float]], list[str], float]:
    """(samples of each capture, words of each store, the greatest excess noise factor); a signal ends it between two captures."""
    samples: list[tuple[Float, Float, Float]] = []
    names, excess = [], 1.0
    opened = [(path.stem, open_captures(path)) for path in stores]
    total = sum(len(captures) for _, captures in opened)
    for stem, captures in opened:
        seeds = []
        for capture in captures:
            tell("read", len(samples), total, stem)
            samples.append(samples_of(capture, min_snr, rng))
            excess = max(excess, instrument_of(capture).excess)
            seeds.append(str(capture.attrs.get("seed", "?")))
        names.append(f"{stem} {', '.join(seeds)}")
    tell("read", total, total, "")
    return samples, names, excess


def _check(units: int, ridge: float, seed: int, min_snr: float) -> None:
    """Refuse parameters out of range before any capture is read."""

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
    """Write an .npz whose members carry no time of writing, unlike those of numpy. The file is written whole or not at all:
    an old one stays until the new one is on disk."""
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
            "The weights cannot be written.", where=str(path), value=reason(error),
            next_step="choose another place with --out, or make room",
        ) from error  # fmt: skip
