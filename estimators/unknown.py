"""The message about a name that is no estimator's: the nearest ones, and where all are listed."""

from __future__ import annotations

import difflib
from collections.abc import Mapping

from ..scenes.errors import InputError
from ..scenes.nearest import did_you_mean

__all__ = ["ALL_NAMES", "few_of_its_kind", "unknown_estimator"]

ALL_NAMES = "beambench estimators list"
#: Names that a message tells.
_FEW = 8


def unknown_estimator(name: str, targets: Mapping[str, str]) -> InputError:
    """The error for `name`, which is not among `targets` (name -> "module:function")."""
    nearest = difflib.get_close_matches(name, list(targets), n=1)
    return InputError(
        "There is no such estimator.",
        where="estimators",
        value=name,
        allowed=few_of_its_kind(nearest[0], targets)
        if nearest
        else f"one of the {len(targets)} names of `{ALL_NAMES}`",
        next_step=f"{did_you_mean(name, targets)} All names: {ALL_NAMES}" if nearest else ALL_NAMES,
    )


def few_of_its_kind(name: str, targets: Mapping[str, str]) -> str:
    """The few names that are most like `name` among those of its folder, which is that of a modality, itself included."""
    folder = targets[name].partition(":")[0].rpartition(".")[0]
    kind = [other for other, place in targets.items() if place.partition(":")[0].rpartition(".")[0] == folder]
    few = difflib.get_close_matches(name, kind, n=_FEW, cutoff=0.0)
    left = len(kind) - len(few)
    return ", ".join(few) + (f" and {left} others" if left else "")
