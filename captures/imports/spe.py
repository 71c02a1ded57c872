"""Princeton Instruments .spe, versions 2 and 3: (page, row, col).

The first 4100 bytes, little-endian: width at 42 (uint16), type at 108 (int16), height at 656 (uint16), frames at 1446 (int32),
version at 1992 (float32), exposure [s] at 10 (float32, version 2), date at 20 (10 bytes, version 2). Frames follow without gaps;
behind them a file of version 3 has XML. Source: Princeton Instruments, SPE file format specification, 2.x and 3.0.
"""

from __future__ import annotations

import re
import struct
from pathlib import Path

import numpy as np

from .recording import Recording, check_bytes

__all__ = ["read_spe"]

_HEADER = 4100
_TYPES = {0: np.float32, 1: np.int32, 2: np.int16, 3: np.uint16, 5: np.float64, 6: np.uint8, 8: np.uint32}
_MOST_XML = 2**22


def read_spe(path: Path) -> Recording:
    """Frames of one region of interest. Raises ValueError."""
    with open(path, "rb") as file:
        head = file.read(_HEADER)
        if len(head) < _HEADER:
            raise ValueError("it ends within its header")
        cols, kind, rows, frames = (
            struct.unpack_from(code, head, at)[0] for code, at in (("<H", 42), ("<h", 108), ("<H", 656), ("<i", 1446))
        )
        version = struct.unpack_from("<f", head, 1992)[0]
        if kind not in _TYPES or not 0 < version < 10 or frames < 1 or rows < 1 or cols < 1:
            raise ValueError(f"type {kind}, version {version:.3g}, {frames} frames of {rows} × {cols} pixels")
        dtype = np.dtype(_TYPES[kind]).newbyteorder("<")
        check_bytes((frames, rows, cols), dtype.itemsize)
        wanted = frames * rows * cols * dtype.itemsize
        content = file.read(wanted)
        if len(content) < wanted:
            raise ValueError(f"its frames have {wanted} bytes, and {len(content)} follow the header")
        header: dict[str, float | int | str] = {"version": round(float(version), 3)}
        if version >= 3:
            header |= _regions(file.read(_MOST_XML), rows, cols)
        else:
            header["exposure_s"] = float(struct.unpack_from("<f", head, 10)[0])
            header["date"] = head[20:30].split(b"\0")[0].decode("latin-1")
    values = np.frombuffer(content, dtype).reshape(frames, rows, cols)
    return Recording(
        {"frames": values.astype(dtype.newbyteorder("="))}, ("page", "row", "col"), header, {"frames": "DN"}
    )


def _regions(xml: bytes, rows: int, cols: int) -> dict[str, float | int | str]:
    """Facts of version 3's footer; frames with several regions or with metadata between them are refused."""
    text = xml.decode("utf-8", "replace")
    regions = re.findall(r'<DataBlock type="Region"[^>]*width="(\d+)"[^>]*height="(\d+)"', text)
    stride = re.search(r'<DataBlock type="Frame"[^>]*stride="(\d+)"', text)
    size = re.search(r'<DataBlock type="Frame"[^>]*size="(\d+)"', text)
    if len(regions) > 1 or (stride and size and stride.group(1) != size.group(1)):
        raise ValueError("frames of several regions, or with metadata between them, are not read")
    found = re.search(r"<ExposureTime[^>]*>([0-9.eE+-]+)<", text)
    return {"exposure_ms": float(found.group(1))} if found else {}
