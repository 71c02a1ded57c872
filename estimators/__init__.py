"""Estimators: capture -> estimate. Every algorithm is one short file that sees the samples of the declared rig only.

This is what an author of an estimator imports:

    from beambench.estimators import estimator, range_result, read_stack

Names load when first used, so that importing this package loads neither xarray nor Numba.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .builtin import BUILTIN
    from .gated.tools.stack import read_stack
    from .gated.train import train
    from .labels import format_label, label_of, parse_label, split_label
    from .registry import ENTRY_POINT_GROUP, Estimator, estimator, get_estimator, list_estimators, run_estimator
    from .result import range_result, stage_result
    from .rig import read_rig

__all__ = [
    "BUILTIN", "ENTRY_POINT_GROUP", "Estimator", "estimator", "format_label", "get_estimator", "label_of",
    "list_estimators", "parse_label", "range_result", "read_rig", "read_stack", "run_estimator", "split_label", "stage_result",
    "train",
]  # fmt: skip

# No name here is that of a module: importing the module would replace it.
_HOME = {
    "BUILTIN": "builtin",
    "ENTRY_POINT_GROUP": "registry",
    "Estimator": "registry",
    "estimator": "registry",
    "format_label": "labels",
    "get_estimator": "registry",
    "label_of": "labels",
    "list_estimators": "registry",
    "parse_label": "labels",
    "range_result": "result",
    "read_rig": "rig",
    "read_stack": "gated.tools.stack",
    "run_estimator": "registry",
    "split_label": "labels",
    "stage_result": "result",
    "train": "gated.train",
}


def __getattr__(name: str) -> object:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_HOME[name]}", __name__), name)
