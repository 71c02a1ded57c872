"""The rig of a twin: values by their paths, and their standard errors, as a calibration finds them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

__all__ = ["TwinRig"]


@dataclass(frozen=True)
class TwinRig:
    """Values {path of a scene: value}, and standard errors {path: 1 σ}. `source`: in a word, where they come from."""

    values: Mapping[str, Any]
    sigmas: Mapping[str, float] = field(default_factory=dict)
    source: str = "a rig file"
