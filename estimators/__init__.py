"""Estimators: capture -> estimate. Every algorithm is one short file that sees the declared rig's samples only."""

from __future__ import annotations

from .labels import format_label, parse_label
from .registry import ENTRY_POINT_GROUP, Estimator, estimator, get_estimator, list_estimators, run_estimator

__all__ = [
    "BUILTIN", "ENTRY_POINT_GROUP", "Estimator", "estimator", "format_label", "get_estimator", "list_estimators",
    "parse_label", "run_estimator",
]  # fmt: skip

#: name -> "module:function"
BUILTIN: dict[str, str] = {
    "amcw-decade": "beambench.estimators.amcw_phase:amcw_decade",
    "amcw-ml": "beambench.estimators.amcw_ml:amcw_ml",
    "amcw-phase": "beambench.estimators.amcw_phase:amcw_phase",
    "chua-2016": "beambench.estimators.chua_2016:chua_2016",
    "chua-2017": "beambench.estimators.chua_2017:chua_2017",
    "chua-2017-orthogonal": "beambench.estimators.chua_2017:chua_2017_orthogonal",
    "constant-fraction": "beambench.estimators.constant_fraction:constant_fraction",
    "gaussian-least-squares": "beambench.estimators.gaussian_least_squares:gaussian_least_squares",
    "learned": "beambench.estimators.learned:learned",
    "log-gaussian": "beambench.estimators.log_gaussian:log_gaussian",
    "matched-filter": "beambench.estimators.matched_filter:matched_filter",
    "parabola": "beambench.estimators.parabola:parabola",
    "peak": "beambench.estimators.peak:peak",
    "poisson-ml": "beambench.estimators.poisson_ml:poisson_ml",
    "poisson-ml-backscatter": "beambench.estimators.poisson_ml_backscatter:poisson_ml_backscatter",
    "poisson-ml-two-returns": "beambench.estimators.poisson_ml_two_returns:poisson_ml_two_returns",
    "range-intensity-correlation": "beambench.estimators.range_intensity:range_intensity_correlation",
    "threshold": "beambench.estimators.threshold:threshold",
    "waveform-average": "beambench.estimators.waveform_average:waveform_average",
    "waveform-coates": "beambench.estimators.waveform_average:waveform_coates",
    "waveform-constant-fraction": "beambench.estimators.waveform_edge:waveform_constant_fraction",
    "waveform-counter": "beambench.estimators.waveform_edge:waveform_counter",
    "waveform-gaussian": "beambench.estimators.waveform_gaussian:waveform_gaussian",
    "waveform-leading-edge": "beambench.estimators.waveform_edge:waveform_leading_edge",
    "waveform-matched": "beambench.estimators.waveform_ml:waveform_matched",
    "waveform-ml": "beambench.estimators.waveform_ml:waveform_ml",
    "weighted-average": "beambench.estimators.weighted_average:weighted_average",
}
