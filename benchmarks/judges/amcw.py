"""The judge of amplitude-modulated rangers. Their rig declares no waveform, so that a calibration changes nothing."""

from __future__ import annotations

from ..bounds.amcw import amcw_bound
from ..bounds.amcw_scan import amcw_scan
from .judge import Judge
from .ranges import range_truth

__all__ = ["JUDGE"]

JUDGE = Judge(
    truth=range_truth,
    bound=lambda capture: {"range": amcw_bound(capture)},
    scan=amcw_scan,
    neighbours=("amcw-ml", "amcw-phase", "amcw-decade"),
    scenes=("amcw",),
    laws="beambench.benchmarks.laws.amcw:LAWS",
)
