"""A request: all that `generate` is given beside the scene, after it was checked."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

from .choice import Choice, Rtol

if TYPE_CHECKING:
    from .rays.trace import Tracer

__all__ = ["Fidelity", "Request"]

Fidelity = Literal["direct", "scatter", "full", "geometric", "isolated", "coherent", "auto"]


@dataclass(frozen=True)
class Request:
    """Main arguments as those of `generate`; `choice`: the rung that was chosen where `fidelity` is "auto"."""

    seed: int
    capture_key: int
    fidelity: Fidelity
    rtol: Rtol
    truth_electrons: bool = False
    truth_components: bool = False
    truth_instances: bool = False
    tracer: Tracer | None = None
    choice: Choice | None = None

    def taking(self, choice: Choice) -> Request:
        """The same request for the rung of a choice."""
        return replace(self, choice=choice)

    @property
    def rung(self) -> str:
        """The rung to render; "auto" as long as none is chosen."""
        return self.fidelity if self.choice is None else self.choice.rung

    @property
    def error(self) -> float:
        """Relative error of the expectation that the rung is rendered to."""
        rtol = self.rtol if self.choice is None else self.choice.rendered
        assert not isinstance(rtol, str)  # "noise" is refused unless a rung is chosen by it
        return rtol

    def arguments(self) -> dict[str, Any]:
        """What the capture's provenance keeps: enough to repeat the call with the same scene."""
        kept = {
            "seed": self.seed, "capture_key": self.capture_key, "fidelity": self.fidelity, "rtol": self.rtol,
            "truth_electrons": self.truth_electrons,
        }  # fmt: skip
        asked = {"truth_components": self.truth_components, "truth_instances": self.truth_instances}
        return kept | {name: True for name, value in asked.items() if value}
