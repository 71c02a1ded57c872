"""The capture of what was measured: data, coordinates, truth, and the attributes that every modality has."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from ..captures.build import make_capture
from ..captures.layouts import layout_of
from ..captures.provenance import provenance
from ..scenes.declared import declared_rig
from ..scenes.scene import Scene
from .effect import Effect
from .model import Expected, Model
from .request import Request

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["captured"]


def captured(
    scene: Scene,
    model: Model[Any],
    measured: NDArray[Any] | Mapping[str, NDArray[Any]],
    expected: Expected[Any],
    effects: list[Effect],
    request: Request,
    declared: Mapping[str, Any] | None = None,
) -> xr.Dataset:
    """The capture, with the rig as declared, the true scene, and all that is needed to repeat it.

    Other arguments:
        declared: the rig as declared, where it is known already.
    """
    declared = declared_rig(scene) if declared is None else declared
    coords = dict(expected.coords)
    if model.clock:
        coords[model.clock] = coords[model.clock] + declared["t0_s"]
    fidelity: dict[str, Any] = {"rung": request.rung, "rtol": request.error, "rays": expected.rays, **expected.traced}
    if request.choice is not None:
        fidelity["chosen"] = request.choice.record()
    return make_capture(
        model.name,
        data=measured if isinstance(measured, Mapping) else {layout_of(model.name).data: measured},
        coords=coords,
        truth=expected.truth,
        attrs={
            "rig": declared,
            "truth_scene": scene.model_dump(mode="json"),
            "truth_kind": "rendered",
            "seed": request.seed,
            "capture_key": request.capture_key,
            "fidelity": fidelity | {"effects": effects},
            "truth_materials": [item.name for item in scene.target],
            "provenance": provenance(request.arguments()),
        },
    )
