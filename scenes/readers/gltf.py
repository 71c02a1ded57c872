"""glTF 2.0 and GLB: the triangles of the default scene, each node at its place (Khronos, glTF 2.0 specification, section 3)."""

from __future__ import annotations

from typing import Any

import numpy as np

from .gltf_data import GltfData
from .surface import EACH_PART, Budget, Fetch, Surface, joined

__all__ = ["read_gltf"]

#: Required extensions under which the triangles are those of the core specification: looks, lights, integer positions.
_KNOWN = ("KHR_mesh_quantization", "KHR_lights_punctual", "KHR_xmp_json_ld", "KHR_texture_basisu", "EXT_texture_webp")
_LOOKS = "KHR_materials_"
_DEEPEST = 256


def read_gltf(content: bytes, fetch: Fetch) -> Surface:
    """All triangles, strips and fans of the scene that the file shows; points and lines are left. Morph targets stand at the
    weights of the file; animations are left.

    ValueError for a damaged file, an extension that is required and not known, and a skin.
    """
    data = GltfData(content, fetch)
    required = data.document.get("extensionsRequired", [])
    for name in required if isinstance(required, list) else [required]:
        if name not in _KNOWN and not str(name).startswith(_LOOKS):
            raise ValueError(f"it requires the extension {name}, which is not read")
    parts: list[Surface] = []
    budget = Budget()
    for node in _roots(data):
        parts += _node(data, node, np.eye(4), 0, budget)
    return joined(parts)


def _roots(data: GltfData) -> list[Any]:
    document = data.document
    if document.get("scenes"):
        return list(data.item("scenes", document.get("scene", 0)).get("nodes", []))
    nodes = document.get("nodes") or []
    children = {child for node in nodes for child in node.get("children", [])}
    return [index for index in range(len(nodes)) if index not in children]


def _node(data: GltfData, index: Any, above: np.ndarray, depth: int, budget: Budget) -> list[Surface]:
    if depth > _DEEPEST:
        raise ValueError("a node is part of itself")
    node = data.item("nodes", index)
    place = above @ _transform(node)
    budget.spend(EACH_PART)
    parts = []
    if "mesh" in node:
        if "skin" in node:
            raise ValueError(f"node {index} is bent by a skin, which is not read")
        mesh = data.item("meshes", node["mesh"])
        weights = node.get("weights", mesh.get("weights", []))
        for primitive in mesh.get("primitives", []):
            part = _primitive(data, primitive, weights)
            if part is not None:
                budget.spend(len(part.vertices) + len(part.faces))
                parts.append(_moved(part, place))
    return parts + [p for child in node.get("children", []) for p in _node(data, child, place, depth + 1, budget)]


def _moved(part: Surface, place: np.ndarray) -> Surface:
    """A part at its place; a mirror image keeps its outside out."""
    faces = part.faces[:, ::-1] if np.linalg.det(place[:3, :3]) < 0 else part.faces
    return Surface(part.vertices @ place[:3, :3].T + place[:3, 3], faces, part.uv)


def _transform(node: dict[str, Any]) -> np.ndarray:
    """A node's matrix: as given, column by column, or translation · rotation (x, y, z, w) · scale."""
    if "matrix" in node:
        return np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
    whole = np.eye(4)
    x, y, z, w = np.array(node.get("rotation", [0, 0, 0, 1]), dtype=np.float64)
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    whole[:3, :3] = turn * np.array(node.get("scale", [1, 1, 1]), dtype=np.float64)
    whole[:3, 3] = node.get("translation", [0, 0, 0])
    return whole


def _primitive(data: GltfData, primitive: dict[str, Any], weights: Any) -> Surface | None:
    """The triangles of a primitive; None where it has none."""
    mode, attributes = primitive.get("mode", 4), primitive.get("attributes", {})
    if mode not in (4, 5, 6) or "POSITION" not in attributes:
        return None
    points = data.accessor(attributes["POSITION"]).astype(np.float64)
    for weight, target in zip(weights, primitive.get("targets", []), strict=False):
        if weight and "POSITION" in target:
            points = points + float(weight) * data.accessor(target["POSITION"])
    if "indices" in primitive:
        corner = data.accessor(primitive["indices"])[:, 0].astype(np.int64)
    else:
        corner = np.arange(len(points), dtype=np.int64)
    if corner.size and corner.max() >= len(points):
        raise ValueError("a triangle names a vertex that its primitive does not have")
    uv = None
    if "TEXCOORD_0" in attributes:
        uv = data.accessor(attributes["TEXCOORD_0"]).astype(np.float64)
        if uv.shape != (len(points), 2):
            raise ValueError("a primitive has another number of texture coordinates than of vertices")
    return Surface(points, _faces(corner, mode), uv)


def _faces(corner: np.ndarray, mode: int) -> np.ndarray:
    """Triangles (m, 3): a list (4), a strip in which every second is turned (5), or a fan about the first corner (6)."""
    if mode == 4:
        if corner.size % 3:
            raise ValueError(f"{corner.size} corners make no whole number of triangles")
        return corner.reshape(-1, 3)
    count = max(corner.size - 2, 0)
    i = np.arange(count)
    if mode == 5:
        return np.stack([corner[i], corner[i + 1 + i % 2], corner[i + 2 - i % 2]], axis=1).reshape(count, 3)
    return np.stack([corner[i + 1], corner[i + 2], np.full(count, corner[0] if corner.size else 0)], axis=1).reshape(
        count, 3
    )
