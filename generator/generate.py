"""Scene in, capture out: the forward model reads as captured(read(expect(scene)))."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..scenes.forks import refuse_forked
from ..scenes.scene import Scene
from .captured import captured
from .checked import checked
from .choice import Choice, Rtol
from .effect import Effect, GenerationWarning, sized, warn
from .model import Expected
from .models import first_rung, model_of
from .request import Fidelity, Request

if TYPE_CHECKING:
    import xarray as xr

    from .rays.trace import Tracer

__all__ = ["GenerationWarning", "Made", "capture_key_of", "drawn_of", "expected_of", "generate"]


def capture_key_of(*parts: Any) -> int:
    """A 63-bit key from (scene, stress, level): the same everywhere, whatever the order of the run."""
    text = json.dumps(parts, sort_keys=True, default=lambda o: o.model_dump(mode="json"))
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big") >> 1


def generate(
    scene: Scene,
    *,
    seed: int,
    capture_key: int | None = None,
    fidelity: Fidelity | None = None,
    rtol: Rtol = 3e-3,
    truth_electrons: bool = False,
    truth_components: bool = False,
    truth_instances: bool = False,
    tracer: Tracer | None = None,
) -> xr.Dataset:
    """Generate one capture with its truth.

    Main arguments:
        scene: target, medium, the rig, and what the rig is declared to be.
        seed: with `capture_key`, names every random number.
    Other arguments:
        capture_key: index in a data set; by default the hash of the scene.
        fidelity: the rung of the ladder, by default the cheapest of the modality; "direct" is one bounce without scattered
            light, "scatter" adds what the water scatters forward and back, "full" adds all that "direct" leaves out by
            tracing paths, "auto" takes the cheapest rung whose predicted error is below rtol.
        rtol: relative error of the expected stack aimed at by sub-pixel sampling, and by the number of paths; with "auto"
            also "noise": one standard deviation of the detector's noise.
        truth_electrons: also keep the noise-free expectation of every sample.
        truth_components: also keep what the light is the sum of: truth_direct; truth_scattered with the scatter rung, or
            truth_interreflection, truth_single (scattered once) and truth_multiple with the full rung; and truth_ambient.
        truth_instances: also keep the number of the piece of the target that is seen, truth_instance.
        tracer: reuse a tracer of the same target.

    Raises:
        InputError: an impossible scene, an unreadable mesh, an unknown rung; a process forked after use.
    Warns:
        GenerationWarning: the target lies outside every gate; scattered light that the rung leaves out is not small.
    """
    refuse_forked()
    key = capture_key_of(scene) if capture_key is None else capture_key
    fidelity = fidelity or first_rung(scene)
    request = checked(
        scene, seed=seed, capture_key=key, fidelity=fidelity, rtol=rtol, truth_electrons=truth_electrons,
        truth_components=truth_components, truth_instances=truth_instances, tracer=tracer,
    )  # fmt: skip
    made = expected_of(scene, request)
    return drawn_of(scene, made, request)


@dataclass(frozen=True, eq=False)
class Made:
    """What a capture is drawn from: the expectation, the effects, and the rung that was chosen."""

    expected: Expected[Any]
    effects: list[Effect]
    choice: Choice | None


def expected_of(scene: Scene, request: Request) -> Made:
    """The expectation of a checked request, and every catalogued effect."""
    model = model_of(scene.modality)
    choice = model.choose(scene, request) if request.fidelity == "auto" else None
    request = request if choice is None else request.taking(choice)
    expected = model.expect(scene, request)
    return Made(expected, sized(model.effects(scene, expected, request.rung), request.choice), choice)


def drawn_of(scene: Scene, made: Made, request: Request, declared: Mapping[str, Any] | None = None) -> xr.Dataset:
    """The capture of an expectation: the detector draws. `declared`: the rig as declared, where it is known."""
    model = model_of(scene.modality)
    request = request if made.choice is None else request.taking(made.choice)
    measured = model.read(scene, made.expected, request)
    warn(scene, made.expected.warnings, made.effects, request.rung)
    return captured(scene, model, measured, made.expected, made.effects, request, declared)
