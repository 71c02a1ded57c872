"""From a mapping and files to captures."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...scenes.declared import declared_rig
from ...scenes.errors import InputError
from ...scenes.load import load_scene
from ...scenes.rig_files import read_rig_file
from ..build import make_capture
from ..layouts import layout_of
from ..provenance import provenance
from .arrays import EvenValues, Files, variable_of
from .mapping import Capture, Clean, Mapping, RigSource

if TYPE_CHECKING:
    import xarray as xr

    from ..layouts.layout import Layout

__all__ = ["Register", "assembled"]

#: (data, coordinates, rig, parameters) -> (data, rig): what is found in the recording itself.
Register = Callable[
    [dict[str, Any], dict[str, Any], dict[str, Any], dict[str, Any]], tuple[dict[str, Any], dict[str, Any]]
]


def assembled(
    mapping: Mapping, given: tuple[Path, ...], register: Register | None = None, *, name: str = ""
) -> Iterator[xr.Dataset]:
    """The captures of a mapping, one by one.

    Main arguments:
        mapping: no collection. given: files, or one folder, as typed.
        register: completes rig and data, where the mapping asks for it.
    Other arguments:
        name: of the mapping, for the provenance.

    Raises:
        InputError: files, arrays, units or a rig that do not fit.
    """
    files = Files(given)
    for one in mapping.capture or (Capture(name=name or "import"),):
        yield _capture(mapping, one, files, register, name)


def _capture(mapping: Mapping, one: Capture, files: Files, register: Register | None, name: str) -> xr.Dataset:
    layout = layout_of(mapping.modality)
    groups: dict[str, dict[str, Any]] = {"data": {}, "coords": {}, "truth": {}}
    files.used.clear()
    for group, into in groups.items():
        for variable, spec in getattr(mapping, group).items():
            where = f"{group}.{variable}"
            if variable not in layout.by_name:
                allowed = [v.name for v in layout.by_name.values() if v.role == {"coords": "coord"}.get(group, group)]
                raise InputError(
                    "A capture has no such variable.", where=where, value=variable, allowed=", ".join(allowed)
                )
            if variable in one.values:
                spec = type(spec)(units=spec.units, values=one.values[variable])
            names = one.files.get(variable, ())
            into[variable] = variable_of(layout.by_name[variable], spec, files, names, where, mapping.averaged)
    _fill_even(groups, layout.by_name)
    if mapping.clean is not None:
        groups["data"]["counts"] = _cleaned(groups["data"]["counts"], mapping.clean)
    assert mapping.rig is not None
    rig = _rig(mapping.rig, mapping.modality)
    data = groups["data"]
    if register is not None:
        data, rig = register(data, groups["coords"], rig, mapping.rig.parameters)
    _check_size(data, rig, layout)
    attrs = {
        "rig": rig, "truth_kind": mapping.truth_kind, "averaged": True if mapping.averaged else None,
        "provenance": provenance({"import": _told(mapping, one, files, name)}),
    }  # fmt: skip
    return make_capture(mapping.modality, data, groups["coords"], groups["truth"], attrs)


def _check_size(data: dict[str, Any], rig: dict[str, Any], layout: Layout) -> None:
    """Refuse images of another size than that of the rig's camera, which estimators would refuse one by one."""
    camera = rig.get("camera")
    dims = layout.by_name[layout.data].dims
    if layout.data not in data or not isinstance(camera, dict) or dims[-2:] != ("row", "col"):
        return
    size, stated = np.shape(data[layout.data])[-2:], (camera.get("rows"), camera.get("cols"))
    if all(isinstance(n, int) for n in stated) and size != stated:
        raise InputError(
            "The images have another size than the rig's camera.", where=f"data.{layout.data}",
            value=" × ".join(map(str, size)), allowed=" × ".join(map(str, stated)),
            next_step='state the recorded part of the chip in the mapping: [rig.overrides] "rig.camera.rows", "rig.camera.cols"',
        )  # fmt: skip


def _told(mapping: Mapping, one: Capture, files: Files, name: str) -> dict[str, Any]:
    """What was imported: names and sha256 of the files, and what the mapping says of them."""
    hashes = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in files.used}
    words = {key: getattr(mapping, key) for key in ("title", "source", "licence", "caution")}
    return {"mapping": name, "capture": one.name, "files": hashes, **{key: text for key, text in words.items() if text}}


def _fill_even(groups: dict[str, dict[str, Any]], schema: Any) -> None:
    """Even values get their number from the other variables along their dimension."""
    import xarray as xr

    sizes: dict[str, int] = {}
    for group in groups.values():
        for name, value in group.items():
            for dims in schema[name].allowed_dims:
                if not isinstance(value, EvenValues) and 0 < len(dims) == np.ndim(value):
                    sizes |= dict(zip(dims, np.shape(value), strict=True))
                    break
    for group in groups.values():
        for name, value in group.items():
            if isinstance(value, EvenValues):
                dim = schema[name].dims[0]
                if dim not in sizes:
                    raise InputError("The number of even values is unknown.", where=name, allowed=f"data along {dim}")
                numbers = value.start + value.step * np.arange(sizes[dim])
                group[name] = xr.DataArray(numbers, attrs={"units": value.unit})


def _cleaned(counts: Any, clean: Clean) -> Any:
    """Frames less their running median, on a pedestal; never below 1 DN."""
    import xarray as xr
    from scipy.ndimage import median_filter

    values = np.asarray(counts.values, np.float64)
    flat = values.reshape(-1, *values.shape[-2:])
    made = [np.maximum(frame - median_filter(frame, clean.median_px) + clean.pedestal_dn, 1.0) for frame in flat]
    return xr.DataArray(np.stack(made).reshape(values.shape).astype(np.float32), attrs=counts.attrs)


def _rig(source: RigSource, modality: str) -> dict[str, Any]:
    if source.scene:
        given = read_rig_file(source.file, modality).overrides() if source.file else {}
        scene = load_scene(source.scene, {**given, **source.overrides} or None)
        if scene.modality != modality:
            raise InputError(
                "The scene has another kind of rig.", where="rig.scene", value=scene.modality, allowed=modality
            )
        rig = declared_rig(scene)
    else:
        rig = {"schema": 1, "kind": modality, **_copied(source.declared)}
    for path in source.unknown:
        node: Any = rig
        *folders, last = path.split(".")
        for key in folders:
            node = node.setdefault(key, {}) if isinstance(node, dict) else None
        if not isinstance(node, dict):
            raise InputError("The path of an unknown value leads nowhere.", where="rig.unknown", value=path)
        node[last] = None
    return rig


def _copied(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _copied(item) for key, item in value.items()}
    return [_copied(item) for item in value] if isinstance(value, list | tuple) else value
