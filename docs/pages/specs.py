"""Reference of the files that a user writes: every table and field of scenes, suites and data sets, from their typed specs."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import BaseModel

from .text import markdown, table

__all__ = ["UNITS", "documents", "fields_of", "page", "schema_of", "unit_of"]

#: Endings of names, the longest first, and the unit that they state.
UNITS = {
    "_e_per_s": "electrons/s", "_dn_per_e": "DN/electron", "_m_per_s": "m/s", "_w_per_m2": "W/m²", "_per_m": "1/m", "_per_s": "1/s",
    "_rad_per_s": "rad/s", "_s2": "s²", "_m2": "m²", "_m": "m", "_s": "s", "_j": "J", "_w": "W", "_hz": "Hz", "_rad": "rad",
    "_deg": "degree", "_e": "electrons", "_dn": "DN", "_px": "pixel", "_pa": "Pa", "_c": "°C", "_k": "K", "_a": "A", "_v": "V",
    "_ohm": "ohm", "_bytes": "byte", "_nm": "nm", "_psu": "psu", "_f": "F", "_a_per_w": "A/W", "_v_per_a": "V/A",
}  # fmt: skip


def unit_of(name: str) -> str:
    """The unit that a name states, "" for a number without one."""
    for ending in sorted(UNITS, key=len, reverse=True):
        if name.endswith(ending):
            return UNITS[ending]
    return ""


def documents() -> dict[str, tuple[str, type[BaseModel]]]:
    """Page -> (title, spec) of every kind of file."""
    from beambench.benchmarks.suites.spec import Suite
    from beambench.scenes.datasets.spec import Dataset
    from beambench.scenes.scene import Scene

    return {
        "scene-files": ("Scene files", Scene),
        "suite-files": ("Suite files", Suite),
        "data-set-files": ("Data-set files", Dataset),
    }


def schema_of(spec: type[BaseModel]) -> dict[str, Any]:
    """The JSON Schema of a spec, for editors and for the page."""
    return spec.model_json_schema(by_alias=True, mode="validation")


def fields_of(schema: Mapping[str, Any]) -> Iterator[tuple[str, str, Mapping[str, Any], bool]]:
    """(table, field, its schema, whether it is required) of every table of a schema."""
    tables = {str(schema.get("title")): schema, **schema.get("$defs", {})}
    for name, one in tables.items():
        for field, own in one.get("properties", {}).items():
            yield name, field, own, field in one.get("required", ())


def page(title: str, spec: type[BaseModel], name: str) -> str:
    """The page of a kind of file."""
    schema = schema_of(spec)
    tables = {str(schema.get("title")): schema, **schema.get("$defs", {})}
    parts = [
        f"# {title}",
        f"Every key that such a file may have. Keys that are not listed are errors; a key without a default must be written. "
        f"Names state their units. The same as JSON Schema, for editors: {{download}}`{name}.schema.json`.",
    ]
    for label, one in tables.items():
        parts.append(f"(spec-{name}-{label.lower()})=\n## {label}")
        if one.get("description"):
            parts.append(markdown(one["description"]))
        rows = []
        for field, own in one.get("properties", {}).items():
            needed = field in one.get("required", ())
            rows.append((f"`{field}`", _kind(own, name), _range(own), unit_of(field) or "–", _default(own, needed)))
        if rows:
            parts.append(table(("key", "kind", "allowed", "unit", "default"), rows))
    return "\n\n".join(parts) + "\n"


def _kind(own: Mapping[str, Any], page: str) -> str:
    if "$ref" in own:
        return str(own["$ref"]).rsplit("/", 1)[-1]
    if "const" in own:
        return json.dumps(own["const"])
    if "enum" in own:
        return ", ".join(json.dumps(value) for value in own["enum"])
    for key in ("anyOf", "oneOf"):
        if key in own:
            return " or ".join(dict.fromkeys(_kind(one, page) for one in own[key] if one.get("type") != "null"))
    kind = own.get("type")
    if kind == "array":
        inner = own.get("prefixItems") or ([own["items"]] if isinstance(own.get("items"), dict) else [])
        names = [_kind(one, page) for one in inner]
        if "prefixItems" in own and len(set(names)) == 1:
            return f"{len(names)} × {names[0]}"
        return "list of " + (", ".join(names) or "values")
    if kind == "object":
        more = own.get("additionalProperties")
        return f"table of {_kind(more, page)}" if isinstance(more, dict) and more else "table"
    return {"number": "number", "integer": "whole number", "string": "text", "boolean": "true or false"}.get(
        str(kind), "any value"
    )


def _range(own: Mapping[str, Any]) -> str:
    """Limits of a field, of its alternatives or of its items."""
    signs = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}
    found = [f"{sign} {own[key]:g}" for key, sign in signs.items() if key in own]
    found += [f"{text} {own[key]}" for key, text in (("minItems", "at least"), ("maxItems", "at most")) if key in own]
    if "pattern" in own:
        found.append(f"`{own['pattern']}`")
    inner = [*own.get("anyOf", ()), *own.get("oneOf", ()), *own.get("prefixItems", ())[:1]]
    inner += [own["items"]] if isinstance(own.get("items"), dict) else []
    found += [text for one in inner if (text := _range(one)) != "–"]
    return ", ".join(dict.fromkeys(found)) or "–"


def _default(own: Mapping[str, Any], needed: bool) -> str:
    if needed:
        return "required"
    if "default" not in own:
        return "empty"
    return "absent" if own["default"] is None else f"`{json.dumps(own['default'], ensure_ascii=False)}`"
