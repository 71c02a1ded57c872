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
    "chua-2016": "beambench.estimators.chua_2016:chua_2016",
    "chua-2017": "beambench.estimators.chua_2017:chua_2017",
    "chua-2017-orthogonal": "beambench.estimators.chua_2017:chua_2017_orthogonal",
    "parabola": "beambench.estimators.parabola:parabola",
    "peak": "beambench.estimators.peak:peak",
    "poisson-ml": "beambench.estimators.poisson_ml:poisson_ml",
    "weighted-average": "beambench.estimators.weighted_average:weighted_average",
}
