"""Plans of recordings, and rig files: typed data, in TOML, that say what is recorded and with which devices. No code is run from
them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from ...scenes.base import Fraction, Spec
from ...scenes.declared import declared_rig
from ...scenes.load import load_scene
from ...scenes.overrides import apply_overrides
from ...scenes.scene import Scene
from ...scenes.spec_files import find_spec_file, read_spec_file
from ...scenes.validate import validate_spec
from .recipe import Recipe, Slot, recipe_of

__all__ = ["PLANS", "RIGS", "Emulator", "Plan", "Planned", "RigFile", "load_plan", "load_rig"]

PLANS = Path(__file__).parent / "library" / "plans"
RIGS = Path(__file__).parent / "library" / "rigs"

_Name = Annotated[str, Field(min_length=1, max_length=120, pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$")]
_Seconds = Annotated[float, Field(gt=0, le=1e5)]


class Plan(Spec):
    """What is recorded.

    `instrument`: a scene, by name or file, whose rig is the instrument as it is known, and whose medium is what the light goes
    through; its objects are not used. `changes`: {path: value} over it. `scan`: the shots, as the modality's recipe has them.
    """

    example: ClassVar[str] = "beambench record gated-demo --rig emulator --plan   (a complete example)"

    schema_version: Literal[1]
    plan: _Name
    title: str
    instrument: str
    changes: dict[str, Any] = Field(default_factory=dict)
    scan: dict[str, Any]


class Emulator(Spec):
    """An emulated rig that is started for the recording: seeds of its noise and of its hidden values, share of lost packets and
    of silent shots."""

    seed: Annotated[int, Field(ge=0)]
    hidden: Annotated[int, Field(ge=0)]
    loss: Fraction
    stall: Fraction


class RigFile(Spec):
    """Which devices there are.

    `devices`: {role: {driver = NAME, options of the driver}}; `also` of a device lists further roles that it takes.
    `settings`: {role: {setting: value}} for the whole recording. `trigger`: the role that fires a shot. `shot_timeout_s`: how
    long a reading may take; `give_up_s`: how long nothing may succeed before the recording ends with what it has.
    """

    example: ClassVar[str] = "docs/recording.md   (a complete example)"

    schema_version: Literal[1]
    rig: _Name
    title: str
    trigger: str
    shot_timeout_s: _Seconds
    give_up_s: _Seconds
    devices: dict[str, dict[str, Any]]
    settings: dict[str, dict[str, Any]] = Field(default_factory=dict)
    emulator: Emulator | None = None


@dataclass(frozen=True)
class Planned:
    """A plan with all that follows from it: the instrument, the recipe, the scan, the slots."""

    plan: Plan
    scene: Scene
    recipe: Recipe
    scan: Spec

    @cached_property
    def slots(self) -> list[Slot]:
        """The shots, in order."""
        return self.recipe.slots(self.scan, self.scene)

    @cached_property
    def fixed(self) -> dict[str, dict[str, Any]]:
        """{role: settings} for the whole recording."""
        return self.recipe.fixed(self.scan, self.scene)

    @cached_property
    def shape(self) -> tuple[int, ...]:
        """Shape of one reading."""
        return self.recipe.shape(self.scan, self.scene)

    @cached_property
    def declared(self) -> dict[str, Any]:
        """The rig as the capture declares it."""
        return declared_rig(self.scene)

    @property
    def elements(self) -> int:
        """Number of slices, frames or shots of the capture."""
        return self.slots[-1].group + 1


def load_plan(source: str | Path | Mapping[str, Any], overrides: Mapping[str, Any] | None = None) -> Planned:
    """A plan by name, file or data. Raises InputError: unknown, wrong, or impossible for its instrument."""
    if isinstance(source, Mapping):
        data, where = dict(source), "plan"
    else:
        path = find_spec_file(
            str(source), PLANS, kind="plan", next_step="beambench record gated-demo --rig emulator --plan"
        )
        data, where = read_spec_file(path), str(source)
    plan = validate_spec(Plan, apply_overrides(data, overrides or {}), where)
    scene = load_scene(plan.instrument, plan.changes)
    recipe = recipe_of(scene.modality)
    scan = validate_spec(recipe.spec, plan.scan, f"{where}: scan", example=lambda: Plan.example)
    planned = Planned(plan, scene, recipe, scan)
    planned.slots  # noqa: B018 - raises what is impossible
    return planned


def load_rig(source: str | Path | Mapping[str, Any]) -> RigFile:
    """A rig file by name, file or data. Raises InputError."""
    if isinstance(source, Mapping):
        return validate_spec(RigFile, dict(source), "rig")
    path = find_spec_file(str(source), RIGS, kind="rig file", next_step="write one as docs/recording.md shows")
    return validate_spec(RigFile, read_spec_file(path), str(source))
