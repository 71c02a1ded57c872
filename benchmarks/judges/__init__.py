"""Judges: how each modality's estimates are compared with truth and bound."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .judge import Judge

__all__ = ["JUDGES", "judge_of"]

#: modality -> "module:object"
JUDGES: dict[str, str] = {
    "gated": "beambench.benchmarks.judges.gated:JUDGE",
    "waveform": "beambench.benchmarks.judges.waveform:JUDGE",
    "amcw": "beambench.benchmarks.judges.amcw:JUDGE",
    "laser_line": "beambench.benchmarks.judges.laser_line:JUDGE",
    "wavefront": "beambench.benchmarks.judges.wavefront:JUDGE",
}


def judge_of(modality: object) -> Judge:
    """The judge of a modality. Raises InputError for one that is not scored."""
    from ...scenes.records import record_of

    judge: Judge = record_of(JUDGES, modality, "This version does not score such captures.", "modality")
    return judge
