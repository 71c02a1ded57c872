"""Andor .sif, by the package sif-parser: (page, row, col)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...scenes.errors import InputError
from .recording import MOST_BYTES, Recording, check_bytes

__all__ = ["read_sif"]

_FACTS = ("ExposureTime", "ExperimentTime", "DetectorType", "GainDAC", "GateWidth", "GateDelay", "DetectorTemperature")


def read_sif(path: Path) -> Recording:
    """The signal's frames. Raises InputError without sif-parser, and what that raises on a damaged file."""
    try:
        import sif_parser
    except ImportError as error:
        raise InputError(
            "Reading .sif needs sif-parser.", where=str(path), next_step='pip install "beambench[imports]"'
        ) from error
    if path.stat().st_size > MOST_BYTES:
        raise ValueError("the file is too large")
    frames, info = sif_parser.np_open(str(path))  # the frames are views of the file's own bytes
    values = np.asarray(frames)
    check_bytes(values.shape, values.dtype.itemsize)
    header = {name: info[name] for name in _FACTS if isinstance(info.get(name), int | float | str)}
    return Recording({"signal": values}, ("page", "row", "col"), header)
