"""Many captures in one process: what several of them share is made once, and each is the one that `generate` makes."""

from __future__ import annotations

import hashlib
import json
from collections import OrderedDict
from collections.abc import Hashable
from typing import TYPE_CHECKING, Any

from ..scenes.declared import declared_rig
from ..scenes.scene import Scene
from .checked import checked
from .generate import Made, drawn_of, expected_of
from .random import drawn_from

if TYPE_CHECKING:
    import xarray as xr

    from .choice import Rtol
    from .rays.trace import Tracer
    from .request import Fidelity

__all__ = ["Workshop"]

#: Targets, and declared rigs, that are kept.
_TARGETS, _RIGS = 8, 64
#: Bytes of first hits that a target keeps.
_HITS_BYTES = 2**27


class Workshop:
    """Makes captures one after the other, and keeps what the next one may need.

    - of scenes with the same shapes and textures: meshes, Mitsuba's scene, and first hits along equal rays;
    - of scenes with equal rig and medium: the rig as declared;
    - of the same scene: the expectation, if no random number went into it, so that another draw of the noise costs that alone.

    Memory does not grow with the number of captures.
    """

    def __init__(self) -> None:
        self._tracers: OrderedDict[str, Tracer] = OrderedDict()
        self._rigs: OrderedDict[str, dict[str, Any]] = OrderedDict()
        self._last: tuple[Hashable, Made] | None = None

    def make(
        self,
        scene: Scene,
        *,
        seed: int,
        capture_key: int,
        fidelity: Fidelity,
        rtol: Rtol,
        truth_electrons: bool = False,
        truth_components: bool = False,
        truth_instances: bool = False,
    ) -> xr.Dataset:
        """One capture, as `generate` makes it of the same arguments: equal bits. Raises and warns as `generate`."""
        request = checked(
            scene, seed=seed, capture_key=capture_key, fidelity=fidelity, rtol=rtol, truth_electrons=truth_electrons,
            truth_components=truth_components, truth_instances=truth_instances, tracer=self._tracer(scene),
        )  # fmt: skip
        text = scene.model_dump_json()
        name = (text, fidelity, rtol, truth_electrons, truth_components, truth_instances)
        if self._last is not None and self._last[0] == name:
            made = self._last[1]
        else:
            self._last = None  # what it holds is not needed while the next is made
            before = drawn_from()
            made = expected_of(scene, request)
            if drawn_from() == before:
                self._last = (name, made)
        return drawn_of(scene, made, request, self._declared(scene))

    def _tracer(self, scene: Scene) -> Tracer | None:
        if not scene.target:
            return None
        from .rays.kept import KeptTracer

        parts = [item.model_dump(mode="json", exclude={"name", "material"}) for item in scene.target]
        name = json.dumps(parts)
        tracer = self._tracers.get(name)
        if tracer is None:
            tracer = KeptTracer(scene, _HITS_BYTES // _TARGETS)
            self._tracers[name] = tracer
            if len(self._tracers) > _TARGETS:
                self._tracers.popitem(last=False)
        else:
            tracer.check(scene)
            self._tracers.move_to_end(name)
        return tracer

    def _declared(self, scene: Scene) -> dict[str, Any]:
        held = scene.model_dump_json(include={"rig", "medium", "declared"})
        name = hashlib.sha256(held.encode()).hexdigest()
        found = self._rigs.get(name)
        if found is None:
            found = declared_rig(scene)
            self._rigs[name] = found
            if len(self._rigs) > _RIGS:
                self._rigs.popitem(last=False)
        return found
