"""The store in one place: write, read, verify, recover. Each has a module of its own."""

from __future__ import annotations

from .reader import CaptureIndexError, CaptureSet, open_captures
from .recovery import Recovery, finalize, repair
from .verification import Damage, verify
from .writer import CaptureWriter, write

__all__ = [
    "CaptureIndexError",
    "CaptureSet",
    "CaptureWriter",
    "Damage",
    "Recovery",
    "finalize",
    "open_captures",
    "repair",
    "verify",
    "write",
]
