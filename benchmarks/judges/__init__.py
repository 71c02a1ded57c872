"""Judges: the comparison of each modality's estimates with truth and bound."""

from __future__ import annotations

from functools import lru_cache
from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .judge import Judge

__all__ = ["JUDGES", "judge_of"]

#: modality -> "module:object"
JUDGES: dict[str, str] = {
    "gated": "beambench.benchmarks.judges.gated:JUDGE",
    "waveform": "beambench.benchmarks.judges.waveform:JUDGE",
    "amcw": "beambench.benchmarks.judges.amcw:JUDGE",
}


@lru_cache(maxsize=64)
def judge_of(modality: object) -> Judge:
    """The judge of a modality. Raises InputError for a modality that is not scored."""
    from ...scenes.errors import InputError

    if not isinstance(modality, str) or modality not in JUDGES:
        raise InputError(
            "This version does not score such captures.", where="modality", value=modality, allowed=", ".join(JUDGES)
        )
    module, _, name = JUDGES[modality].partition(":")
    judge: Judge = getattr(import_module(module), name)
    return judge
