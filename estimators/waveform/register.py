"""The response from the records themselves: the mean record, where a recording brings no other measurement of its pulse."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...scenes.errors import InputError

__all__ = ["response_of_records"]


def response_of_records(
    data: dict[str, Any], coords: dict[str, Any], rig: dict[str, Any], parameters: dict[str, Any]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """(data, rig) with `response` = the mean record less its baseline, from `from_s` to `to_s`, 0 s at `zero_s`, never below 0.

    `lobe`: only the part about the peak where the mean stays above the baseline, for amplifiers that swing below it. The baseline,
    the median of the samples before `from_s`, becomes the declared offset. An answer relative to such a response has no absolute
    zero: it tells how records differ from their mean, and no more.

    Raises:
        InputError: parameters that are missing, or a part without light.
    """
    wanted = ("from_s", "to_s", "zero_s")
    missing = [name for name in wanted if not isinstance(parameters.get(name), int | float)]
    if missing:
        raise InputError(
            "The response of the records needs its part of the time axis.", where="rig.parameters", value=missing,
            allowed="from_s, to_s and zero_s, s",
        )  # fmt: skip
    first, last, zero = (float(parameters[name]) for name in wanted)
    signal = np.asarray(data["signal"], np.float64)
    time = np.asarray(coords["time"], np.float64)
    part = (time >= first) & (time <= last)
    before = time < first
    if part.sum() < 4 or before.sum() < 4:
        raise InputError(
            "The part of the time axis holds too few samples.", where="rig.parameters", value=[first, last],
            allowed=f"within {time[0]:g} to {time[-1]:g} s, with samples before it",
        )  # fmt: skip
    offset = float(np.median(signal[:, before]))
    mean = signal.mean(axis=0)[part] - offset
    value = np.maximum(mean, 0.0)
    if parameters.get("lobe") is True:
        dark = np.flatnonzero(value == 0.0)
        peak = int(value.argmax())
        value[: int(dark[dark < peak].max(initial=0))] = 0.0
        value[int(dark[dark > peak].min(initial=value.size)) :] = 0.0
    value[0] = value[-1] = 0.0
    if not value.sum() > 0:
        raise InputError("The mean record holds no light.", where="signal", value=float(value.sum()), allowed="> 0")
    step = float(np.median(np.diff(time)))
    response = {
        "start_s": float(time[part][0] - zero),
        "step_s": step,
        "value": (value / (value.sum() * step)).tolist(),
    }
    readout = {**rig.get("detector", {}).get("readout", {}), "offset_dn": offset}
    return data, {**rig, "response": response, "detector": {**rig.get("detector", {}), "readout": readout}}
