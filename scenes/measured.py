"""Measured pulses and gates: a curve in a text file becomes even samples, and what was done to it is told."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from .csv_columns import read_columns
from .errors import InputError
from .meshes import resolve_file
from .validate import validate_spec
from .waveforms import MeasuredGate, MeasuredPulse

__all__ = ["MeasuredNote", "measured_samples", "with_measured"]

Float = NDArray[np.float64]

_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "ps": 1e-12}
#: Light below this many standard deviations of the baseline's noise, or this share of the peak, is none.
_SIGMAS, _LEAST = 5.0, 1e-3
#: Steps may differ by this share before the curve is laid on an even grid.
_EVEN = 1e-3
_MOST_SAMPLES = 20_000


class MeasuredNote(UserWarning):
    """What was done to a measured curve."""

    #: How a message of the command line begins.
    word: ClassVar[str] = "note"


def with_measured(data: Mapping[str, Any], where: str) -> dict[str, Any]:
    """A scene's data in which each `kind = "measured"` of rig and declared values is the `kind = "sampled"` that it gives.

    Raises:
        InputError: as `measured_samples`, or a missing or wrong key.
    Warns:
        MeasuredNote: what was done to the curve.
    """

    def walk(value: Any, place: str) -> Any:
        if isinstance(value, dict):
            last = next((part for part in reversed(place.split(".")) if not part.isdigit()), "")
            if value.get("kind") == "measured" and last in ("pulse", "gate", "gates"):
                return _sampled(value, MeasuredPulse if last == "pulse" else MeasuredGate, f"{where}: {place}")
            return {key: walk(item, f"{place}.{key}") for key, item in value.items()}
        if isinstance(value, list | tuple):
            return [walk(item, f"{place}.{index}") for index, item in enumerate(value)]
        return value

    return {key: walk(value, key) if key in ("rig", "declared") else value for key, value in data.items()}


def _sampled(table: Mapping[str, Any], kind: type[MeasuredPulse | MeasuredGate], where: str) -> dict[str, Any]:
    found = measured_samples(validate_spec(kind, table, where), where)
    warnings.warn(f"{where}: {'; '.join(found.notes)}", MeasuredNote, stacklevel=2)
    return found.data


@dataclass
class Samples:
    """A curve as data of `kind = "sampled"`, and what was done to it."""

    data: dict[str, Any]
    notes: list[str] = field(default_factory=list)


def measured_samples(spec: MeasuredPulse | MeasuredGate, where: str) -> Samples:
    """The even samples of a measured curve.

    The baseline is taken off; what lies outside of the light, or of `keep`, is set to zero, as is what lies below zero; a gate is
    divided by its level when open, multiplied by `transmission`, and what then lies above 1 is set to 1.

    Raises:
        InputError: an unusable file, times that do not increase, a baseline that cannot be found, a curve without light, or one
            that points downward.
    """
    path = resolve_file(spec.file, f"{where}.file")
    time, value = read_columns(path, (spec.time_column, spec.value_column), f"{where}.file")
    unit = _SECONDS[spec.time_unit]
    notes = [f"{path.name}, {time.size} samples"]
    time, value = _even(time, value, f"{where}.file", spec.time_unit, notes)
    level, noise = _baseline(spec, time, value, where)
    value = (level - value) if spec.inverted else (value - level)
    notes.append(f"baseline {level:.4g} taken off")
    _check_sign(value, spec, where)
    first, last = _light(spec, time, value, noise, where)
    kept = value[first : last + 1]
    notes.append(
        f"{(time[last] - time[first]):.4g} {spec.time_unit} from {time[first]:.4g} {spec.time_unit} kept, and zero outside, where "
        f"noise is up to {_outside(value, first, last):.2g} of the peak"
    )
    if (below := int((kept < 0).sum())) > 0:
        notes.append(f"{below} samples below zero set to zero")
    kept = np.concatenate([[0.0], np.maximum(kept, 0.0), [0.0]])
    step = float((time[-1] - time[0]) / (time.size - 1))
    if kept.size > _MOST_SAMPLES:
        raise InputError(
            "The curve has too many samples.", where=where, value=kept.size, allowed=f"up to {_MOST_SAMPLES:,} within its light",
            next_step="average neighbours in the file, or keep less: keep = [from, to]",
        )  # fmt: skip
    if isinstance(spec, MeasuredPulse):
        data = {"kind": "sampled", "step_s": step * unit, "value": _short(kept / kept.max())}
    else:
        data = _gate(spec, kept, step * unit, notes)
    return Samples(data, notes)


def _gate(spec: MeasuredGate, kept: Float, step_s: float, notes: list[str]) -> dict[str, Any]:
    """The gate's samples; its time zero is where it opens to half."""
    level = float(np.median(kept[kept > 0.5 * kept.max()]))
    value = kept / level * spec.transmission
    notes.append(f"open level {level:.4g} is a transmission of {spec.transmission:g}")
    if (above := int((value > 1.0).sum())) > 0:
        notes.append(f"{above} samples above 1, up to {value.max():.3g}, set to 1")
    half = int(np.argmax(kept >= 0.5 * level))
    opening = half - 1 + (0.5 * level - kept[half - 1]) / (kept[half] - kept[half - 1])
    notes.append("time zero at half of the opening edge")
    return {
        "kind": "sampled", "start_s": float(-opening * step_s), "step_s": step_s, "value": _short(np.minimum(value, 1.0)),
    }  # fmt: skip


def _short(value: Float) -> list[float]:
    return [float(f"{v:.9g}") for v in value]


def _even(time: Float, value: Float, where: str, unit: str, notes: list[str]) -> tuple[Float, Float]:
    """The curve on an even grid of its median step."""
    steps = np.diff(time)
    if steps.min() <= 0:
        at = int(np.argmax(steps <= 0)) + 1
        raise InputError(
            "The times of a curve should increase.", where=where,
            value=f"{time[at]:.9g} behind {time[at - 1]:.9g} (sample {at + 1})",
            allowed="increasing times, each once",
            next_step="write the times with more digits" if steps.min() == 0 else "is this the column of times? time_column",
        )  # fmt: skip
    step = float(np.median(steps))
    if np.abs(steps - step).max() <= _EVEN * step or np.allclose(steps, step, rtol=_EVEN, atol=1e-9 * abs(time).max()):
        return np.linspace(time[0], time[-1], time.size), value
    count = int(np.floor((time[-1] - time[0]) / step + 1e-9)) + 1
    if count > 50 * time.size:
        raise InputError(
            "The steps of a curve differ too much.", where=where, value=f"{steps.min():g} to {steps.max():g}"
        )
    grid = time[0] + step * np.arange(count)
    notes.append(f"steps of {steps.min():.4g} to {steps.max():.4g} {unit} laid on an even grid of {step:.4g} {unit}")
    return grid, np.interp(grid, time, value)


def _window(window: tuple[float, float], time: Float, where: str, least: int) -> NDArray[np.bool_]:
    inside = np.asarray((time >= window[0]) & (time <= window[1]))
    if inside.sum() < least:
        raise InputError(
            "A stretch of the curve holds too few samples.", where=where, value=list(window),
            allowed=f"[from, to] with at least {least} samples, within {time[0]:g} to {time[-1]:g} of the file",
        )  # fmt: skip
    return inside


def _baseline(spec: MeasuredPulse | MeasuredGate, time: Float, value: Float, where: str) -> tuple[float, float]:
    """(level, standard deviation of its noise) where there is no light: as given, or at both ends of the record."""
    if isinstance(spec.baseline, tuple):
        dark = value[_window(spec.baseline, time, f"{where}.baseline", 3)]
        return float(np.median(dark)), _noise(dark)
    count = max(3, value.size // 10)
    head, tail = value[:count], value[-count:]
    if spec.baseline is not None:
        return float(spec.baseline), min(_noise(head), _noise(tail))
    level, noise = float(np.median(head)), max(_noise(head), _noise(tail))
    peak = float(np.abs(value - level).max())
    # The median of n samples errs by 1.25 σ/√n.
    if abs(float(np.median(tail)) - level) > 0.02 * peak + 5.0 * noise / np.sqrt(count) or noise > 0.2 * peak:
        raise InputError(
            "The baseline is unclear: the record differs between its beginning and its end, or is noise.",
            where=f"{where}.baseline", value=f"{level:.4g} at the beginning, {float(np.median(tail)):.4g} at the end",
            allowed="a level, or [from, to] without light, in the units of the file",
            next_step=f"for example baseline = [{time[0]:g}, {time[count - 1]:g}]",
        )  # fmt: skip
    return level, noise


def _noise(value: Float) -> float:
    """Standard deviation by the median of absolute deviations, which a few samples of light do not move."""
    return 1.4826 * float(np.median(np.abs(value - np.median(value))))


def _check_sign(value: Float, spec: MeasuredPulse | MeasuredGate, where: str) -> None:
    if -value.min() > value.max():
        turn = "leave out inverted = true" if spec.inverted else "inverted = true"
        raise InputError(
            "The curve points downward.", where=where, value=f"{value.min():.4g} to {value.max():.4g} about the baseline",
            allowed="light above the baseline", next_step=turn,
        )  # fmt: skip


def _light(spec: MeasuredPulse | MeasuredGate, time: Float, value: Float, noise: float, where: str) -> tuple[int, int]:
    """First and last sample with light."""
    inside = np.ones(value.size, bool) if spec.keep is None else _window(spec.keep, time, f"{where}.keep", 3)
    peak = float(value[inside].max())
    if peak <= _SIGMAS * noise or peak <= 0:
        raise InputError(
            "The curve shows no light above its noise.", where=where, value=f"peak {peak:.3g}, noise {noise:.3g}",
            allowed=f"a peak above {_SIGMAS:g} standard deviations of the baseline",
        )  # fmt: skip
    found = np.flatnonzero(inside) if spec.keep else np.flatnonzero(value > max(_SIGMAS * noise, _LEAST * peak))
    return int(found[0]), int(found[-1])


def _outside(value: Float, first: int, last: int) -> float:
    outside = np.concatenate([value[:first], value[last + 1 :]])
    return float(np.abs(outside).max() / value[first : last + 1].max()) if outside.size else 0.0
