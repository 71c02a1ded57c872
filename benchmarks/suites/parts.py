"""Parts: a suite that joins others, each scene read by the estimators of its own part.

    suite = "full"
    parts = ["gated", "waveform", "amcw"]

Scenes, draws and stresses follow one another; a scene keeps its part's rung and conditions, and lists its part's estimators. What
a suite has once (seeds, rtol, calibration, limits) is that of the joint suite where it is stated there; otherwise the parts must
agree on it. `stresses = []` leaves out those of the parts.

Parts are only a notation, as variants are: the suite that is run, recorded and hashed has them written out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from ...scenes.errors import InputError
from ...scenes.validate import validate_spec
from .spec import Suite

__all__ = ["without_parts"]

#: Keys that a joint suite has once.
_ONCE = ("seeds", "rtol", "limits", "failure_at", "new_child")
#: Keys that a joint suite with parts has of its own.
_OWN = (
    "schema_version",
    "suite",
    "version",
    "title",
    "conditions",
    "calibration",
    "mismatch",
    "parts",
    "stresses",
    *_ONCE,
)
_MOST = 20


def without_parts(data: Mapping[str, Any], where: str, read: Callable[[str], Mapping[str, Any]]) -> dict[str, Any]:
    """A suite's data with its parts written out; data without `parts` are returned as they are.

    Main arguments:
        data: data of the suite. where: the suite, for messages. read: name of a part -> its data, without variants.

    Raises:
        InputError: a part is no suite or has parts itself, two parts have a scene of one name or disagree on what a suite has once,
            or the joint suite lists scenes or estimators of its own.
    """
    if "parts" not in data:
        return dict(data)
    names = data["parts"]
    if not isinstance(names, list | tuple) or not names or not all(isinstance(name, str) for name in names):
        raise InputError("The parts of a suite must be a list of suites.", where=f"{where}: parts", value=names,
                         allowed='parts = ["first", "second"], each the name of a suite or its file')  # fmt: skip
    if len(names) > _MOST or len(set(names)) != len(names):
        raise InputError("Each part is given once.", where=f"{where}: parts", value=names, allowed=f"up to {_MOST}")
    if more := sorted(set(data) - set(_OWN)):
        raise InputError(
            "A suite with parts has no scenes, estimators, draws or stresses of its own.", where=f"{where}: {more[0]}",
            allowed=", ".join(_OWN), next_step="write them into a suite of their own, and name it among the parts",
        )  # fmt: skip
    parts = {name: dict(read(name)) for name in names}
    for name, part in parts.items():
        if "parts" in part:
            raise InputError("A part of a suite has no parts itself.", where=f"{where}: parts", value=name)
        # A part is a whole suite but for what the joint suite states. Unknown keys of it would be lost in silence below.
        validate_spec(Suite, {key: data[key] for key in (*_ONCE, "calibration") if key in data} | part, name)
    if data.get("stresses"):
        raise InputError("A suite with parts has no stresses of its own.", where=f"{where}: stresses",
                         allowed="stresses = [], which leaves out those of the parts")  # fmt: skip
    result = {key: value for key, value in data.items() if key != "parts"}
    missing = [key for key in _ONCE if key not in data and any(key in part for part in parts.values())]
    result |= {key: _agreed(key, parts, where) for key in missing}
    result.setdefault("conditions", list(dict.fromkeys(one for part in parts.values() for one in _conditions(part))))
    own = data.get("calibration", {})
    calibration = _calibration(parts, where) | dict(own) if isinstance(own, Mapping) else own
    result |= {"calibration": calibration} if calibration else {}
    result["scenes"] = [entry for part in parts.values() for entry in _scenes(part)]
    result["estimators"] = list(dict.fromkeys(label for part in parts.values() for label in part["estimators"]))
    for key in ("draws", "stresses"):
        found = [_limited(item, part) for part in parts.values() for item in part.get(key, ())]
        if found and key not in data:
            result[key] = found
    return result


def _agreed(key: str, parts: Mapping[str, Mapping[str, Any]], where: str) -> Any:
    """The value of a key, the same in every part."""
    values = {name: part.get(key) for name, part in parts.items()}
    first = next(iter(values.values()))
    if any(value != first for value in values.values()):
        raise InputError("The parts of a suite disagree.", where=f"{where}: {key}", value=values,
                         next_step=f"state {key} in {where}, or make it the same in every part")  # fmt: skip
    return first


def _calibration(parts: Mapping[str, Mapping[str, Any]], where: str) -> dict[str, Any]:
    """The calibrations of all parts in one; instruments of different kinds read different keys of it."""
    result: dict[str, Any] = {}
    for name, part in parts.items():
        held = dict(part.get("calibration", {}))
        for key, value in ({"seed": 0} | held if held else held).items():
            if result.setdefault(key, value) != value:
                raise InputError("The parts of a suite disagree.", where=f"{where}: calibration.{key}", value=value,
                                 allowed=f"{result[key]}, as in the parts before {name}",
                                 next_step=f"state [calibration] {key} the same in every part")  # fmt: skip
    return result


def _conditions(part: Mapping[str, Any]) -> list[Any]:
    return list(part.get("conditions", ("matched",)))


def _scenes(part: Mapping[str, Any]) -> list[Any]:
    """The entries of a part, with its rung and its estimators where an entry has none of its own."""
    common = {"estimators": list(part["estimators"]), "conditions": _conditions(part)}
    common |= {"fidelity": part["fidelity"]} if "fidelity" in part else {}
    return [{**common, **({"scene": item} if isinstance(item, str) else item)} for item in part["scenes"]]


def _limited(item: Mapping[str, Any], part: Mapping[str, Any]) -> dict[str, Any]:
    """A draw or a stress of a part, which is for its scenes only."""
    names: Sequence[str] = item.get("scenes", ()) or [
        item if isinstance(item, str) else item.get("name", item["scene"]) for item in part["scenes"]
    ]
    return {**item, "scenes": list(names)}
