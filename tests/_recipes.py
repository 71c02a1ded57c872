"""One procedural shape of each recipe, as plain data."""

from __future__ import annotations

from typing import Any

__all__ = ["RECIPES", "shape_of"]

_GROUND: dict[str, Any] = {"ground_rms_m": 0.02, "ground_scale_m": 0.5}
RECIPES: dict[str, dict[str, Any]] = {
    "rocks": {"rocks": 10, "diameter_m": [0.2, 0.8], "roughness": 0.35, **_GROUND},
    "pipes": {
        "pipes": 2,
        "diameter_m": [0.2, 0.4],
        "bends": 2,
        "bend_radius_m": 0.5,
        "flange_spacing_m": 0.9,
        **_GROUND,
    },
    "terraces": {"steps": 8, "rise_m": [0.05, 0.2], "blocks": 12, "block_m": [0.1, 0.4]},
    "vegetation": {"plants": 16, "height_m": [0.4, 0.9], "blade_width_m": 0.05, "lean_deg": 40.0, **_GROUND},
    "wreck": {"pieces": 14, "piece_m": [0.3, 0.9], **_GROUND},
}
_BOX: dict[str, Any] = {
    "center_m": [0.0, 0.0, 4.0],
    "size_m": [3.0, 2.5, 1.2],
    "rotation_deg": [-30.0, 10.0, 5.0],
    "part": "all",
}


def shape_of(kind: str, seed: int, **changes: Any) -> dict[str, Any]:
    """The shape of a recipe and a seed."""
    return {"kind": kind, "seed": seed, **_BOX, **RECIPES[kind], **changes}
