"""What a wrong value of a spec should be, in plain words: no sentence of the validating library reaches a user."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from .nearest import did_you_mean

__all__ = ["lost_table", "near_keys", "unit_hint", "wanted"]

#: Units by the ending of a key: (quantity, [(prefix of the unit, factor, endings that a user may write)]).
_UNITS: dict[str, tuple[str, tuple[tuple[str, float], ...]]] = {
    "m": ("Lengths are in metres", (("nm", 1e-9), ("um", 1e-6), ("µm", 1e-6), ("mm", 1e-3), ("cm", 1e-2), ("km", 1e3))),
    "s": ("Times are in seconds", (("fs", 1e-15), ("ps", 1e-12), ("ns", 1e-9), ("us", 1e-6), ("µs", 1e-6), ("ms", 1e-3))),
    "j": ("Energies are in joules", (("nj", 1e-9), ("uj", 1e-6), ("µj", 1e-6), ("mj", 1e-3))),
    "w": ("Powers are in watts", (("uw", 1e-6), ("µw", 1e-6), ("mw", 1e-3), ("kw", 1e3))),
    "hz": ("Frequencies are in hertz", (("khz", 1e3), ("mhz", 1e6), ("ghz", 1e9))),
    "rad": ("Angles are in radians", (("deg", math.pi / 180.0), ("urad", 1e-6), ("µrad", 1e-6), ("mrad", 1e-3))),
    "deg": ("Angles are in degrees", (("rad", 180.0 / math.pi),)),
}  # fmt: skip
#: Which units to try for a value that is far too large: the usual ones first.
_TRIED = {
    "m": ("mm", "um", "nm"),
    "s": ("ns", "ps", "us", "ms"),
    "j": ("uj", "mj"),
    "w": ("mw",),
    "rad": ("deg", "mrad"),
}
_SIMPLE = {
    "missing": "must be given; it has no default",
    "extra_forbidden": "no such key here",
    "float_type": "a number",
    "float_parsing": "a number",
    "int_type": "a whole number",
    "int_parsing": "a whole number",
    "int_from_float": "a whole number",
    "string_type": "text",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "list_type": "a list",
    "tuple_type": "a list",
    "dict_type": "a table",
    "model_type": "a table",
    "model_attributes_type": "a table",
    "mapping_type": "a table",
    "none_required": "nothing: leave the key out",
    "finite_number": "a finite number",
    "union_tag_not_found": "must say its kind",
}
_LIMITS = {
    "greater_than": ("gt", "above"),
    "greater_than_equal": ("ge", "at least"),
    "less_than": ("lt", "below"),
    "less_than_equal": ("le", "at most"),
}


def wanted(error: Mapping[str, Any]) -> str:
    """What one error of the validation asks for, in a few words."""
    kind, context = str(error["type"]), error.get("ctx", {})
    if kind in _SIMPLE:
        return _SIMPLE[kind]
    if kind in _LIMITS:
        key, word = _LIMITS[kind]
        return f"{word} {_plain(context[key])}{unit_hint(error)}"
    if kind in ("too_short", "too_long"):
        least = kind == "too_short"
        count = context["min_length" if least else "max_length"]
        return f"at {'least' if least else 'most'} {count} values; there are {context['actual_length']}"
    if kind in ("string_too_short", "string_too_long"):
        least = kind == "string_too_short"
        return (
            f"text of at {'least' if least else 'most'} {context['min_length' if least else 'max_length']} characters"
        )
    if kind == "string_pattern_mismatch":
        return f"text of the form {context['pattern']}"
    if kind == "literal_error":
        return str(context["expected"]).replace(" or ", ", ")
    if kind == "union_tag_invalid":
        return f"one of the kinds {context['expected_tags']}"
    return str(error["msg"]).removeprefix("Value error, ").removeprefix("Assertion failed, ")


def _plain(limit: Any) -> str:
    return f"{limit:g}" if isinstance(limit, float) else str(limit)


def _ending(key: str) -> str:
    return key.rpartition("_")[2]


def unit_hint(error: Mapping[str, Any]) -> str:
    """For a value beyond a limit: "; in metres 532 nm is 532e-9", where such a unit brings it within the limits that are known."""
    key, value, context = str(error["loc"][-1] if error["loc"] else ""), error.get("input"), error.get("ctx", {})
    high = context.get("lt", context.get("le"))
    unit = _ending(key)
    if high is None or not isinstance(value, int | float) or unit not in _TRIED or value < 2.0 * high:
        return ""
    quantity, units = _UNITS[unit]
    for name in _TRIED[unit]:
        factor = dict(units)[name]
        if 0 < value * factor < high:
            power = f"{value:g}e{round(math.log10(factor))}" if name != "deg" else f"{value * factor:.6g}"
            return f". {quantity}: {value:g} {name} is {power}"
    return f". {quantity}"


def near_keys(known: set[str], key: str) -> str:
    """For an unknown key: the known one that differs in its unit only, keys of the same name elsewhere, or similar ones."""
    if key in known:
        return "; this key exists elsewhere in the spec, not in this place"
    stem, _, unit = key.rpartition("_")
    for other in sorted(known):
        base, _, right = other.rpartition("_")
        if stem and base == stem and right in _UNITS:
            quantity, units = _UNITS[right]
            for name, factor in units:
                if unit.lower() == name:
                    return f"; write {other}. {quantity} (1 {unit} is {factor:.6g})"
    near = did_you_mean(key, sorted(known))
    return f"; {near}" if near else ""


def lost_table(
    schema: Mapping[str, Any], errors: Sequence[Mapping[str, Any]]
) -> tuple[Mapping[str, Any], list[str]] | None:
    """(error of a missing table, the unknown keys that belong to it), where a table's header was left out.

    Main arguments:
        schema: JSON Schema of the spec. errors: those of the validation, with `loc`, `type`.
    """
    unknown = [str(error["loc"][-1]) for error in errors if error["type"] == "extra_forbidden"]
    for error in errors:
        if error["type"] != "missing":
            continue
        for properties in _tables_named(schema, str(error["loc"][-1])):
            own = [key for key in unknown if key in properties]
            if len(own) >= 2 and len(own) * 2 >= len(unknown):
                return error, own
    return None


def _tables_named(schema: Mapping[str, Any], key: str) -> Iterator[set[str]]:
    """The keys of each table that a field of this name may hold."""
    definitions = schema.get("$defs", {})
    for table in (schema, *definitions.values()):
        todo = [table.get("properties", {}).get(key, {})]
        while todo:
            node = todo.pop()
            if isinstance(node, dict):
                if "$ref" in node:
                    yield set(definitions[str(node["$ref"]).rsplit("/", 1)[-1]].get("properties", {}))
                todo += [*node.get("anyOf", ()), *node.get("oneOf", ())]
