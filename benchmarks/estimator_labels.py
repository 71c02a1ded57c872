"""The estimators of a suite, checked before anything runs: known names, known parameters, no two alike."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from ..scenes.errors import InputError

__all__ = ["Chosen", "check_estimators"]


@dataclass(frozen=True)
class Chosen:
    """An estimator of a suite: its name, its parameters as `key=value,...` (keys sorted), and both as one label."""

    name: str
    params: str
    label: str


def check_estimators(labels: Iterable[str]) -> list[Chosen]:
    """Parse and check labels; keys are sorted.

    Parameters of built-ins are checked here. A plug-in's code is never imported by the parent, which holds the truth:
    its parameters are checked by its child, and a bad one is the status of its rows.

    Raises:
        InputError: unknown name (with near matches), bad syntax, unknown or bad parameter, the same label twice.
    """
    import difflib

    from ..estimators import BUILTIN
    from ..estimators.labels import check_parameters, format_label, parse_label
    from ..estimators.registry import get_estimator, list_estimators

    known = set(list_estimators())
    chosen: list[Chosen] = []
    for label in labels:
        name, params = parse_label(label)
        if name not in known:
            near = difflib.get_close_matches(name, sorted(known), n=3)
            raise InputError(
                "There is no such estimator.",
                where="estimators",
                value=name,
                allowed=", ".join(sorted(known)),
                next_step=f"did you mean {' or '.join(near)}?" if near else "beambench estimators list",
            )
        if name in BUILTIN:
            check_parameters(get_estimator(name).function, params, where=name)
        full = format_label(name, params)
        if any(other.label == full for other in chosen):
            raise InputError("An estimator is listed twice.", where="estimators", value=full)
        inside = full[len(name) + 1 : -1] if params else ""
        chosen.append(Chosen(name, inside, full))
    return chosen
