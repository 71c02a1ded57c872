"""3MF: the objects that a build puts together (3MF Consortium, Core Specification 1.3)."""

from __future__ import annotations

import io
import posixpath
import zipfile
import zlib
from typing import Any
from xml.etree import ElementTree

import numpy as np

from .surface import EACH_PART, Budget, Fetch, Surface, joined

__all__ = ["read_3mf"]

_CORE = "{http://schemas.microsoft.com/3dmanufacturing/core/2015/02}"
_MODEL_RELATION = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
#: Required extensions that change nothing of the triangles: colours and materials.
_LOOKS = {"http://schemas.microsoft.com/3dmanufacturing/material/2015/02"}
_USUAL = "3D/3dmodel.model"
#: Most bytes of a part: XML takes some thirty times as much memory. More where it is packed by less than this factor.
_MOST_BYTES, _FACTOR = 2**26, 64
_DEEPEST = 64


def read_3mf(content: bytes, fetch: Fetch) -> Surface:
    """All items of the build, each moved to its place. ValueError for a damaged package, and for extensions that are required
    and not known, such as those that keep objects in other parts or as beams."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as package:
            model, spaces = _model(package)
    except (zipfile.BadZipFile, zlib.error, KeyError, OSError, EOFError, NotImplementedError, RuntimeError) as error:
        raise ValueError(f"no 3MF package: {error}") from error
    for prefix in model.get("requiredextensions", "").split():
        if spaces.get(prefix) not in _LOOKS:
            raise ValueError(f"it requires the extension {spaces.get(prefix, prefix)}, which is not read")
    objects = {item.get("id", ""): item for item in model.iterfind(f"{_CORE}resources/{_CORE}object")}
    parts: list[Surface] = []
    budget = Budget()
    for item in model.iterfind(f"{_CORE}build/{_CORE}item"):
        parts += _parts(objects, item, np.eye(4), 0, budget)
    return joined(parts)


def _model(package: zipfile.ZipFile) -> tuple[Any, dict[str, str]]:
    """The root of the model's XML and its namespaces by prefix."""
    relations = ElementTree.fromstring(_plain(package, "_rels/.rels"))
    targets = [item.get("Target", "") for item in relations if item.get("Type") == _MODEL_RELATION]
    # Some writers leave the relation out; the model's usual name is then the only one that it can have.
    named = targets[0] if targets else _USUAL
    if posixpath.normpath(named).lstrip("/") not in package.namelist():
        raise ValueError(
            f"the package names no model, and holds no {_USUAL}" if not targets else f"it lacks its model {named}"
        )
    text = _plain(package, posixpath.normpath(named).lstrip("/"))
    try:
        spaces = dict(value for _, value in ElementTree.iterparse(io.BytesIO(text), events=["start-ns"]))
        return ElementTree.fromstring(text), {str(k): str(v) for k, v in spaces.items()}
    except ElementTree.ParseError as error:
        raise ValueError(f"its model is no XML: {error}") from error


def _plain(package: zipfile.ZipFile, name: str) -> bytes:
    told = package.getinfo(name)
    if told.file_size > max(_MOST_BYTES, min(_FACTOR * told.compress_size, 2**29)):
        raise ValueError(f"the {told.compress_size:,} bytes of {name} unpack to {told.file_size:,}")
    text = package.read(name)
    if b"<!DOCTYPE" in text or b"<!ENTITY" in text:
        raise ValueError(f"{name} declares entities, which 3MF forbids")
    return text


def _parts(objects: dict[str, Any], item: Any, place: np.ndarray, depth: int, budget: Budget) -> list[Surface]:
    """The meshes of an item or component, moved by the rows-times-matrix transforms on the way to it."""
    place = _transform(item.get("transform")) @ place
    budget.spend(EACH_PART)
    found = objects.get(item.get("objectid", ""))
    if found is None or depth > _DEEPEST:
        raise ValueError(f"object {item.get('objectid')!r} is not in the file, or made of itself")
    if any(name.endswith("}path") for name in item.attrib):
        raise ValueError("an object lies in another part of the package, which is not read")
    mesh = found.find(f"{_CORE}mesh")
    if mesh is None:
        components = found.findall(f"{_CORE}components/{_CORE}component")
        return [part for one in components for part in _parts(objects, one, place, depth + 1, budget)]
    try:
        rows = [[float(v.attrib[k]) for k in "xyz"] for v in mesh.iterfind(f"{_CORE}vertices/{_CORE}vertex")]
        faces = [
            [int(t.attrib[k]) for k in ("v1", "v2", "v3")] for t in mesh.iterfind(f"{_CORE}triangles/{_CORE}triangle")
        ]
    except (KeyError, ValueError) as error:
        raise ValueError(f"a vertex or triangle of object {item.get('objectid')} is incomplete: {error}") from error
    budget.spend(len(rows) + len(faces))
    vertices = np.array(rows, dtype=np.float64).reshape(-1, 3) @ place[:3, :3] + place[3, :3]
    index = np.array(faces, dtype=np.int64).reshape(-1, 3)
    return [Surface(vertices, index[:, ::-1] if np.linalg.det(place[:3, :3]) < 0 else index)]


def _transform(text: str | None) -> np.ndarray:
    """The 4 × 4 matrix of twelve numbers, which multiplies rows from the right."""
    whole = np.eye(4)
    if text is not None:
        numbers = [float(word) for word in text.split()]
        if len(numbers) != 12:
            raise ValueError("a transform needs twelve numbers")
        whole[:, :3] = np.array(numbers).reshape(4, 3)
    return whole
