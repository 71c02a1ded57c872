"""The estimators that a user names in place of a suite's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

__all__ = ["suite_changes"]


def suite_changes(overrides: Mapping[str, Any] | None, estimators: Sequence[str] | None) -> dict[str, Any]:
    """The overrides of a suite, with the estimators among them if any are named.

    Raises:
        InputError: One label is given in place of a list.
    """
    from ..benchmarks.runner.estimator_labels import check_estimators
    from ..estimators.labels import each_label

    changes = dict(overrides or {})
    if isinstance(estimators, str):
        check_estimators(estimators)  # refuses text, whose letters would pass for labels
    if estimators:
        changes["estimators"] = each_label(estimators)
    return changes
