"""LeCroy .trc: the WAVEDESC block of the template LECROY_2_3, 8 or 16 bit, single records and sequences.

    V = VERTICAL_GAIN·code − VERTICAL_OFFSET
    t_i = HORIZ_INTERVAL·i + HORIZ_OFFSET          of a sequence's segment k its own offset: TRIGTIME pairs (trigger time, offset)

t = 0 is the trigger. Two public readers differ from each other by one sample at the end: lecroyscope has this t_i; lecroyparser
spreads N samples over N intervals, first and last included (`linspace`), so that its step is N/(N − 1) of the interval and its last
sample one interval late. Source: LeCroy, Remote Control Manual, appendix "Waveform structure", template LECROY_2_3.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np

from .recording import MOST_BYTES, Array, Recording, check_bytes

__all__ = ["read_trc"]

#: Where WAVEDESC begins at the latest: behind the length of an IEEE 488.2 block.
_WITHIN = 50
#: name -> (place in the block, code).
_FIELDS = {
    "wave_descriptor": (36, "i"), "user_text": (40, "i"), "res_desc1": (44, "i"), "trig_time": (48, "i"),
    "ris_time": (52, "i"), "res_array1": (56, "i"), "wave_array1": (60, "i"), "count": (116, "i"), "first_valid": (124, "i"),
    "last_valid": (128, "i"), "segments": (144, "i"), "gain": (156, "f"), "offset": (160, "f"), "bits": (172, "h"),
    "interval": (176, "f"), "horizontal_offset": (180, "d"),
}  # fmt: skip


def read_trc(path: Path) -> Recording:
    """signal (segment, sample) in the vertical unit, time (sample) [s], start (segment): to be added to time [s].

    Raises ValueError and struct.error for a damaged file.
    """
    if path.stat().st_size > MOST_BYTES:
        raise ValueError("the file is too large")
    content = path.read_bytes()
    begin = content[: _WITHIN + 8].find(b"WAVEDESC")
    if begin < 0:
        raise ValueError("it has no block WAVEDESC")
    order = "<" if content[begin + 34 : begin + 36] == b"\1\0" else ">"

    def field(name: str) -> Any:
        at, code = _FIELDS[name]
        return struct.unpack_from(order + code, content, begin + at)[0]

    wide = bool(struct.unpack_from(order + "h", content, begin + 32)[0])
    dtype = np.dtype(order + ("i2" if wide else "i1"))
    sizes = [
        int(field(name))
        for name in ("wave_descriptor", "user_text", "res_desc1", "trig_time", "ris_time", "res_array1")
    ]
    count, segments = int(field("count")), max(int(field("segments")), 1)
    if min(*sizes, count) < 0 or count == 0 or count % segments or int(field("wave_array1")) < count * dtype.itemsize:
        raise ValueError(f"{count} samples in {segments} segments do not fit its {field('wave_array1')} bytes")
    check_bytes((count,), 8)
    place = begin + sum(sizes)
    if place + count * dtype.itemsize > len(content):
        raise ValueError(f"it ends early: {count} samples begin at byte {place} of {len(content)}")
    interval, gain = float(field("interval")), float(field("gain"))
    if not interval > 0 or not np.isfinite([interval, gain, field("offset"), field("horizontal_offset")]).all():
        raise ValueError(f"an interval of {interval:g} s, a gain of {gain:g}")
    codes = np.frombuffer(content, dtype, count, place).reshape(segments, -1)
    trigger, offset = _triggers(
        content, begin + sum(sizes[:3]), sizes[3], segments, order, float(field("horizontal_offset"))
    )
    arrays: dict[str, Array] = {
        "signal": gain * codes.astype(np.float64) - float(field("offset")),
        "time": offset[0] + interval * np.arange(codes.shape[1]),
        "start": offset - offset[0],
        "trigger_time": trigger,
    }
    header: dict[str, float | int | str] = {
        "interval_s": interval, "horizontal_offset_s": float(field("horizontal_offset")), "segments": segments,
        "bits": int(field("bits")), "gain_v": gain, "instrument": _text(content, begin + 76, 16),
        "date": _date(content, begin + 296, order), "vertical_unit": _text(content, begin + 196, 48),
    }  # fmt: skip
    units = {"signal": str(header["vertical_unit"]) or "V", "time": "s", "start": "s", "trigger_time": "s"}
    return Recording(arrays, ("shot", "sample"), header, units)


def _triggers(content: bytes, place: int, size: int, segments: int, order: str, alone_s: float) -> tuple[Array, Array]:
    """Time of each segment's trigger after the first one, and of its first sample after its own trigger, s."""
    if size < 16 * segments:
        return np.zeros(segments), np.full(segments, alone_s)
    pairs = np.frombuffer(content, order + "f8", 2 * segments, place).reshape(segments, 2).astype(np.float64)
    if not np.isfinite(pairs).all():
        raise ValueError("a trigger's time is no number")
    return pairs[:, 0], pairs[:, 1]


def _text(content: bytes, at: int, size: int) -> str:
    return content[at : at + size].split(b"\0")[0].decode("latin-1").strip()


def _date(content: bytes, at: int, order: str) -> str:
    second, minute, hour, day, month, year = struct.unpack_from(order + "dbbbbh", content, at)
    return f"{year:04d}-{month:02d}-{day:02d} {hour:02d}:{minute:02d}:{second:09.6f}"
