"""The one place that refuses what cannot be generated: `generate` and the front door both call it."""

from __future__ import annotations

from collections.abc import Callable
from numbers import Real
from typing import TYPE_CHECKING, Any, get_args

from ..scenes.errors import InputError
from ..scenes.scene import Scene
from ..scenes.whole import check_whole
from .choice import Rtol
from .models import model_of
from .request import Fidelity, Request
from .water.phase import phase_of

if TYPE_CHECKING:
    from .rays.trace import Tracer

__all__ = ["checked"]

_RTOL = "1e-6 … 0.5"


def checked(
    scene: Scene,
    *,
    seed: int,
    capture_key: int,
    fidelity: Fidelity,
    rtol: Rtol,
    truth_electrons: bool = False,
    truth_components: bool = False,
    truth_instances: bool = False,
    tracer: Tracer | None = None,
    name: Callable[[str], str] = str,
) -> Request:
    """The request, after all that can be refused before any light is traced.

    Main arguments: as those of `generate`.
    Other arguments:
        name: what messages call an argument, e.g. "--fidelity" for "fidelity".

    Raises:
        InputError: a scene whose files cannot be used; a seed, a rung or an rtol that does not exist; a rung that is not built
            for the scene's modality, that cannot model its rig or lacks the water's phase function, or that cannot keep the
            components of light apart; a modality without instances.
    """
    if fidelity not in get_args(Fidelity):
        raise InputError(
            "There is no such rung.", where=name("fidelity"), value=fidelity, allowed=", ".join(get_args(Fidelity))
        )
    rtol = _checked_rtol(fidelity, rtol, name)
    if seed < 0:
        raise InputError("A seed is not negative.", where=name("seed"), value=seed, allowed="0, 1, 2, …")
    model = model_of(scene.modality)
    if fidelity not in (*model.rungs, "auto"):
        raise InputError(
            f"The rung {fidelity!r} is not built for {model.name} scenes.", where=f"{scene.name}: {name('fidelity')}",
            value=fidelity, allowed=", ".join(f'"{rung}"' for rung in (*model.rungs, "auto")),
        )  # fmt: skip
    if truth_components and fidelity not in model.apart:
        rungs = ", ".join(model.apart)
        raise InputError(
            f"The components of light are kept apart by {f'these rungs only: {rungs}' if rungs else 'no rung of this modality'}.",
            where=f"{scene.name}: {name('truth_components')}", value=fidelity,
            next_step=f'fidelity="{model.apart[0]}"' if rungs else f"leave out {name('truth_components')}",
        )  # fmt: skip
    if truth_instances and not model.instances:
        raise InputError(
            "Captures of this modality do not record which piece of the target they see.",
            where=f"{scene.name}: {name('truth_instances')}", value=model.name,
            next_step=f"leave out {name('truth_instances')}",
        )  # fmt: skip
    check_whole(scene)
    if fidelity in model.wet:
        phase_of(scene)
    model.check(scene, fidelity)
    return Request(seed, capture_key, fidelity, rtol, truth_electrons, truth_components, truth_instances, tracer)


def _checked_rtol(fidelity: str, rtol: Any, name: Callable[[str], str]) -> Rtol:
    if rtol == "noise":
        if fidelity != "auto":
            raise InputError(
                'The tolerance rtol "noise" chooses a rung, so it needs the fidelity "auto".', where=name("rtol"), value=rtol,
                allowed=_RTOL, next_step=f"give {name('fidelity')} auto",
            )  # fmt: skip
        return "noise"
    if isinstance(rtol, bool) or not isinstance(rtol, Real) or not 1e-6 <= float(rtol) <= 0.5:
        raise InputError(
            'The tolerance rtol must be a fraction, or "noise".', where=name("rtol"), value=rtol, allowed=_RTOL
        )
    return float(rtol)
