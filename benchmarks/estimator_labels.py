"""The estimators of a suite, checked before anything runs: known names, known parameters, no two alike."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from ..scenes.errors import InputError

__all__ = ["Chosen", "check_estimators", "missing_package"]


@dataclass(frozen=True)
class Chosen:
    """An estimator of a suite: its name, its parameters as `key=value,...` (keys sorted), and both as one label."""

    name: str
    params: str
    label: str


def missing_package(error: BaseException | None, home: str = "") -> str:
    """The package that an import did not find, "" where that is not what went wrong.

    A missing module of ours, of the estimator's own package (`home`: its "module:function"), or inside a package that
    is installed, is a bug of theirs and no missing extra.
    """
    from importlib.util import find_spec

    while error is not None and not isinstance(error, ModuleNotFoundError):
        error = error.__cause__
    top = (error.name or "").partition(".")[0] if error is not None else ""
    own = {"beambench", home.partition(":")[0].partition(".")[0]}
    return top if top and top not in own and find_spec(top) is None else ""


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
            try:
                check_parameters(get_estimator(name).function, params, where=name)
            except InputError as error:
                if not missing_package(error, BUILTIN[name]):  # else its child is skipped, with that reason
                    raise
        full = format_label(name, params)
        if any(other.label == full for other in chosen):
            raise InputError("An estimator is listed twice.", where="estimators", value=full)
        inside = full[len(name) + 1 : -1] if params else ""
        chosen.append(Chosen(name, inside, full))
    return chosen
