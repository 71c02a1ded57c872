"""The typed spec of a suite file: scenes, stresses, seeds, conditions, estimators and limits."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, get_args

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from ...scenes.base import Positive, Spec
from ...scenes.errors import InputError

__all__ = [
    "Calibration",
    "Condition",
    "Draw",
    "Limits",
    "Rung",
    "SceneEntry",
    "Seeds",
    "Split",
    "Stress",
    "Suite",
    "check_split",
]

Condition = Literal["matched", "calibrated", "mismatched"]
Split = Literal["dev", "test"]
Rung = Literal["direct", "scatter", "full", "geometric", "isolated", "coherent", "auto"]
Seed = Annotated[int, Field(ge=0, lt=2**63)]


def check_split(split: str) -> None:
    """Raise InputError for a split other than "dev" and "test".

    Raises:
        InputError: an unknown split.
    """
    if split not in get_args(Split):
        raise InputError("The seeds of a suite have no such split.", where="split", value=split, allowed="dev, test")


class SceneEntry(Spec):
    """A scene of the suite: a name in the library or a path, and its own overrides ({path: value}).

    `name` distinguishes two entries of one scene; it defaults to the scene's own name. `fidelity`: the rung of this scene,
    where it is not the suite's. `estimators`: which of the suite's read it; one that no scene lists reads all scenes.
    `conditions`: which of the suite's it is run under; all by default.
    """

    scene: Annotated[str, Field(min_length=1)]
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$", max_length=120)] | None = None
    overrides: dict[str, Any] = Field(default_factory=dict)
    fidelity: Rung | None = None
    estimators: tuple[str, ...] = ()
    conditions: tuple[Condition, ...] = ()

    @model_serializer(mode="wrap")
    def _without_absent_options(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        # Suites without them keep their hashes.
        unused = {
            "fidelity": self.fidelity is None,
            "estimators": not self.estimators,
            "conditions": not self.conditions,
        }
        return {name: value for name, value in handler(self).items() if not unused.get(name, False)}


class Stress(Spec):
    """A stress (`axis`: a name of `stress.AXES` or a numeric path of the scene) and its levels; with `axis2` a grid.

    A sweep refines the levels at the edge of breakdown; it needs levels that rise or fall throughout, from benign to
    breaking. `scenes`: names in the suite of the scenes under this stress; all by default.
    """

    axis: Annotated[str, Field(min_length=1)]
    values: Annotated[tuple[float, ...], Field(min_length=1)]
    axis2: Annotated[str, Field(min_length=1)] | None = None
    values2: tuple[float, ...] = ()
    scenes: tuple[str, ...] = ()

    @model_serializer(mode="wrap")
    def _without_absent_scenes(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        # Suites without them keep their hashes.
        return {name: value for name, value in handler(self).items() if name != "scenes" or self.scenes}

    @model_validator(mode="after")
    def _second_axis_has_values(self) -> Stress:
        if (self.axis2 is None) != (not self.values2):
            raise ValueError("axis2 and values2 are given together")
        if len(set(self.values)) != len(self.values) or len(set(self.values2)) != len(self.values2):
            raise ValueError("each level is given once")
        return self


class Draw(Spec):
    """What differs from seed to seed, so that no estimator knows the truth from the rig: the level of a stress, uniform from
    `low` to `high`. Each scene and seed has its own, the same in every run. `scenes`: names in the suite of the scenes that
    are drawn; all by default.
    """

    axis: Annotated[str, Field(min_length=1)]
    low: float
    high: float
    scenes: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _rises(self) -> Draw:
        if not self.low < self.high:
            raise ValueError("low must be below high")
        return self


class Seeds(Spec):
    """Random seeds for tuning (`dev`) and for scores (`test`). They must not overlap."""

    dev: tuple[Seed, ...] = ()
    test: Annotated[tuple[Seed, ...], Field(min_length=1)]

    @model_validator(mode="after")
    def _apart(self) -> Seeds:
        if shared := set(self.dev) & set(self.test):
            raise ValueError(f"dev and test seeds must be apart; both hold {sorted(shared)}")
        if len(set(self.test)) != len(self.test) or len(set(self.dev)) != len(self.dev):
            raise ValueError("each seed is given once")
        return self


class Limits(Spec):
    """Limits on one estimator's child process, per capture.

    Main arguments:
        time_s: wall time of a timed call, s.
        memory_bytes: total resident memory of the child and its descendants, measured by the parent.
    Other arguments:
        warmup_s: wall time of start and warm-up, including compilation, s.
        output_bytes: size of the printed output.
        give_up_after: number of consecutive captures over a limit of time or memory after which the rest is skipped.
    """

    example: ClassVar[str] = "beambench estimate --help"

    time_s: Positive
    memory_bytes: Annotated[int, Field(ge=2**20)]
    warmup_s: Positive = 120.0
    output_bytes: Annotated[int, Field(ge=0)] = 2**20
    give_up_after: Annotated[int, Field(ge=1)] = 3


class Calibration(Spec):
    """The simulated calibration of the condition "calibrated": how well its records are measured.

    A suite states what its instruments need; the others may be left out.

    Main arguments:
        pulse_photoelectrons: total number recorded of the pulse.
        gate_photoelectrons: number recorded per delay step with the gate open.
        corner_sigma_px, line_sigma_px: standard errors of a corner of a board, and of a laser line on it.
        spot_photoelectrons: number recorded of each spot of a reference, all its exposures together.
    Other arguments:
        seed: random seed of the calibration noise, in addition to the seed of the capture: each scene and seed has its own
        calibration, and another value here changes all of them.
    """

    pulse_photoelectrons: Positive | None = None
    gate_photoelectrons: Positive | None = None
    corner_sigma_px: Positive | None = None
    line_sigma_px: Positive | None = None
    spot_photoelectrons: Positive | None = None
    seed: Seed = 0

    @model_serializer(mode="wrap")
    def _without_absent_options(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {name: value for name, value in handler(self).items() if value is not None}

    def of(self, name: str) -> float:
        """A value that a calibration needs. Raises InputError where the suite does not state it."""
        value: float | None = getattr(self, name)
        if value is None:
            raise InputError(
                "The suite's calibration lacks a value that its instruments need.", where=f"calibration.{name}",
                allowed="a number above 0", next_step=f"state {name} in the table [calibration] of the suite",
            )  # fmt: skip
        return value


class Suite(Spec):
    """A suite file.

    Main arguments:
        scenes, stresses, seeds, conditions, estimators: the axes of the table.
    Other arguments:
        failure_at: |error| above which an element counts as failed, in the unit of the main quantity; None: the rule of
            `scores.truth.failure_limit`.
        fidelity, rtol: arguments of the generator; an entry of `scenes` may have a `fidelity` of its own.
        draws: what is drawn anew for every seed, before any stress.
        mismatch: the condition "mismatched": {what: amount} by which the declared rig is wrong, e.g. t0 = 2e-11 [s];
            `suites.mismatch` lists what may be wrong. What a scene's rig does not have is left as it is.
        new_child: how often an estimator gets a new process: for every condition, or for every capture, which takes a start
            and a warm-up each time, and leaves no memory of the captures before. Built-in estimators, of which a law holds
            that none remembers a capture, get one for every condition either way.
    """

    example: ClassVar[str] = f"a complete example: {Path(__file__).parent / 'library' / 'quickstart.toml'}"

    schema_version: Literal[1] = 1
    suite: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$", max_length=80)]
    version: Annotated[int, Field(ge=1)] = 1
    title: str = ""
    scenes: Annotated[tuple[SceneEntry, ...], Field(min_length=1)]
    stresses: tuple[Stress, ...] = ()
    seeds: Seeds
    conditions: Annotated[tuple[Condition, ...], Field(min_length=1)] = ("matched",)
    calibration: Calibration | None = None
    mismatch: dict[str, float] = Field(default_factory=dict)
    estimators: Annotated[tuple[str, ...], Field(min_length=1)]
    failure_at: Positive | None = None
    fidelity: Rung = "direct"
    rtol: Annotated[float, Field(ge=1e-6, le=0.5)] = 1e-3
    limits: Limits = Limits(time_s=60.0, memory_bytes=2**31)
    draws: tuple[Draw, ...] = ()
    new_child: Literal["condition", "capture"] = "condition"

    @model_serializer(mode="wrap")
    def _without_absent_options(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Options that a suite does not use are left out, so that suites from before have their hash."""
        held: dict[str, Any] = handler(self)
        unused = {"draws": not self.draws, "new_child": self.new_child == "condition", "mismatch": not self.mismatch}
        return {name: value for name, value in held.items() if not unused.get(name, False)}

    @model_validator(mode="after")
    def _consistent(self) -> Suite:
        if len(set(self.conditions)) != len(self.conditions):
            raise ValueError("each condition is given once")
        if ("calibrated" in self.conditions) and self.calibration is None:
            raise ValueError('the condition "calibrated" needs the table `calibration`')
        if ("mismatched" in self.conditions) != bool(self.mismatch):
            raise ValueError('the condition "mismatched" and the table `mismatch` need each other')
        if len(set(self.estimators)) != len(self.estimators):
            raise ValueError("each estimator is given once")
        return self
