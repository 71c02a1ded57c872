"""Rig files: values of a rig, whole or in part, with their standard errors, as a calibration finds them.

    schema_version = 1
    kind = "gated"                       # of the scenes that it goes into

    [rig.detector]                       # as in a scene; what is not here stays as the scene has it
    gain_dn_per_e = 0.6993

    [uncertainty]                        # 1 σ, by the paths of `--set`
    "rig.detector.gain_dn_per_e" = 0.0008

    [[calibration]]                      # where the values come from
    procedure = "emva1288"

A list, a table with its own `kind` (a pulse, a gate), and a table that the kind of rig names (`RigKind.whole`) replace the scene's
as a whole; of other tables the given keys do. Files of measured curves lie beside the rig file.
"""

from __future__ import annotations

import json
import os
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from .base import NonNegative, Spec
from .errors import InputError
from .load import anchored_overrides
from .rigs import RIGS, rig_kind
from .spec_files import read_spec_file
from .validate import validate_spec

__all__ = ["RigFile", "read_rig_file", "toml_of", "write_rig_file"]


class RigFile(Spec):
    """A rig file.

    Main arguments:
        kind: the kind of rig. rig: values as in a scene, nested.
    Other arguments:
        uncertainty: {path: 1 σ}. calibration: one record per procedure.
    """

    example: ClassVar[str] = "docs/calibration.md   (a complete example)"

    schema_version: Literal[1] = 1
    kind: str
    rig: Annotated[dict[str, Any], Field(min_length=1)]
    uncertainty: dict[str, NonNegative] = Field(default_factory=dict)
    calibration: tuple[dict[str, Any], ...] = ()

    def overrides(self) -> dict[str, Any]:
        """Its values by the paths of `--set`, for a scene whose rig is of this kind."""
        return dict(_paths("rig", self.rig, rig_kind(self.kind).whole))

    def updated(
        self, values: Mapping[str, Any], uncertainty: Mapping[str, float], record: Mapping[str, Any]
    ) -> RigFile:
        """The file with values {path: value} set, their standard errors, and one more record.

        A value that is replaced loses its old standard error, and a list those of its elements. A path may end in the index of a
        list that the file holds.
        """
        rig = json.loads(json.dumps(self.rig))
        kept = {
            path: sigma
            for path, sigma in self.uncertainty.items()
            if not any(f"{path}.".startswith(f"{new}.") for new in values)
        }
        for path, value in values.items():
            node: dict[str, Any] = {"rig": rig}
            *folders, last = path.split(".")
            for key in folders:
                if not isinstance(node.get(key), dict | list):
                    node[key] = {}
                node = node[key]
            if isinstance(node, list):
                node[int(last)] = value
            else:
                node[last] = value
        records = (*self.calibration, dict(record))
        return RigFile(kind=self.kind, rig=rig, uncertainty={**kept, **uncertainty}, calibration=records)


def _paths(prefix: str, value: Mapping[str, Any], whole: Collection[str]) -> list[tuple[str, Any]]:
    found: list[tuple[str, Any]] = []
    for key, item in value.items():
        path = f"{prefix}.{key}"
        if isinstance(item, Mapping) and "kind" not in item and path not in whole:
            found += _paths(path, item, whole)
        else:
            found.append((path, item))
    return found


def read_rig_file(path: str | Path, kind: str | None = None) -> RigFile:
    """Read a rig file.

    Main arguments:
        path: a .toml or .json file. kind: the kind of rig that it must be of.

    Raises:
        InputError: absent, not well formed, an unknown key, or of another kind.
    """
    place = Path(path).expanduser()
    held = read_spec_file(place)
    if isinstance(held.get("rig"), dict):
        held["rig"] = anchored_overrides(held["rig"], place.parent)
    found = validate_spec(RigFile, held, str(path))
    if found.kind not in RIGS or kind not in (None, found.kind):
        raise InputError(
            "The rig file is of another kind of rig.", where=f"{path}: kind", value=found.kind,
            allowed=kind or ", ".join(RIGS),
        )  # fmt: skip
    return found


def write_rig_file(path: Path, file: RigFile) -> None:
    """Write a rig file; it has its name only when all of it is on disk. Raises InputError where it cannot be written."""
    data = file.model_dump(mode="json")
    head = "# Written by `beambench calibrate`. A scene takes it by: beambench generate SCENE --rig FILE\n"
    text = head + toml_of(
        {name: data[name] for name in ("schema_version", "kind", "rig", "uncertainty", "calibration")}
    )
    part = path.with_name(f"{path.name}.partial")
    try:
        with open(part, "w", encoding="utf-8") as stream:
            stream.write(text)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(part, path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise InputError("The rig file cannot be written.", where=str(path), value=str(error)) from error


def toml_of(data: Mapping[str, Any], prefix: str = "") -> str:
    """Plain data as TOML; keys whose value is null are left out.

    Tables stand under headers, lists of tables under double ones, and everything else on one line.
    """
    plain, rest = [], []
    for key, value in data.items():
        name = f"{prefix}{_key(key)}"
        if isinstance(value, Mapping) and "kind" not in value:
            inside = toml_of(value, f"{name}.")
            bare = inside.startswith("\n") and not any(
                not isinstance(v, Mapping | list | tuple) for v in value.values()
            )
            rest.append(inside if bare else f"\n[{name}]\n{inside}")
        elif isinstance(value, list | tuple) and value and all(isinstance(item, Mapping) for item in value):
            if all(not isinstance(v, Mapping) for item in value for v in item.values()):
                rest += [f"\n[[{name}]]\n{toml_of(item, f'{name}.')}" for item in value]
            else:
                plain.append(f"{_key(key)} = {_inline(value)}\n")
        elif value is not None:
            plain.append(f"{_key(key)} = {_inline(value)}\n")
    return "".join(plain + rest)


def _key(key: str) -> str:
    return (
        key
        if key.replace("_", "").replace("-", "").isalnum() and key.isascii()
        else json.dumps(key, ensure_ascii=False)
    )


def _inline(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(k)} = {_inline(v)}" for k, v in value.items() if v is not None) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_inline(item) for item in value) + "]"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return repr(value)
    return json.dumps(value, ensure_ascii=False)
