"""Estimators: capture -> estimate. Every algorithm is one short file that sees the declared rig's samples only."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .labels import format_label, parse_label
from .registry import ENTRY_POINT_GROUP, Estimator, estimator, get_estimator, list_estimators, run_estimator
from .result import range_result, stage_result

if TYPE_CHECKING:
    from .gated.tools.stack import read_stack

__all__ = [
    "BUILTIN", "ENTRY_POINT_GROUP", "Estimator", "estimator", "format_label", "get_estimator", "list_estimators",
    "parse_label", "range_result", "read_stack", "run_estimator", "stage_result",
]  # fmt: skip

#: name -> "module:function"
BUILTIN: dict[str, str] = {
    "amcw-decade": "beambench.estimators.amcw.phase:amcw_decade",
    "amcw-ml": "beambench.estimators.amcw.ml:amcw_ml",
    "amcw-phase": "beambench.estimators.amcw.phase:amcw_phase",
    "chua-2016": "beambench.estimators.gated.chua_2016:chua_2016",
    "chua-2017": "beambench.estimators.gated.chua_2017:chua_2017",
    "chua-2017-orthogonal": "beambench.estimators.gated.chua_2017:chua_2017_orthogonal",
    "constant-fraction": "beambench.estimators.gated.constant_fraction:constant_fraction",
    "gaussian-least-squares": "beambench.estimators.gated.gaussian_least_squares:gaussian_least_squares",
    "learned": "beambench.estimators.gated.learned:learned",
    "log-gaussian": "beambench.estimators.gated.log_gaussian:log_gaussian",
    "matched-filter": "beambench.estimators.gated.matched_filter:matched_filter",
    "parabola": "beambench.estimators.gated.parabola:parabola",
    "peak": "beambench.estimators.gated.peak:peak",
    "poisson-ml": "beambench.estimators.gated.poisson_ml:poisson_ml",
    "poisson-ml-backscatter": "beambench.estimators.gated.poisson_ml_backscatter:poisson_ml_backscatter",
    "poisson-ml-two-returns": "beambench.estimators.gated.poisson_ml_two_returns:poisson_ml_two_returns",
    "range-intensity-correlation": "beambench.estimators.gated.range_intensity:range_intensity_correlation",
    "threshold": "beambench.estimators.gated.threshold:threshold",
    "waveform-average": "beambench.estimators.waveform.average:waveform_average",
    "waveform-coates": "beambench.estimators.waveform.average:waveform_coates",
    "waveform-constant-fraction": "beambench.estimators.waveform.edge:waveform_constant_fraction",
    "waveform-counter": "beambench.estimators.waveform.edge:waveform_counter",
    "waveform-gaussian": "beambench.estimators.waveform.gaussian:waveform_gaussian",
    "waveform-leading-edge": "beambench.estimators.waveform.edge:waveform_leading_edge",
    "waveform-matched": "beambench.estimators.waveform.ml:waveform_matched",
    "waveform-ml": "beambench.estimators.waveform.ml:waveform_ml",
    "weighted-average": "beambench.estimators.gated.weighted_average:weighted_average",
}


def __getattr__(name: str) -> Any:
    # Compiled kernels load only where a stack is read.
    if name == "read_stack":
        from .gated.tools.stack import read_stack

        return read_stack
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
