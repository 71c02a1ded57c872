"""A gated scan: dark frames and reference frames first, then delays × repeats × averages."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
from pydantic import Field, model_validator

from ...scenes.base import Spec
from ...scenes.errors import InputError
from ...scenes.quantities import MomentTime, StepTime
from ...scenes.rigs.gated import gated_rig
from ...scenes.scene import Scene
from .recipe import Built, Recipe, Slot, Taken, mean_of

__all__ = ["RECIPE", "GatedScan"]

_Count = Annotated[int, Field(ge=0, le=65536)]
_Times = Annotated[int, Field(ge=1, le=65536)]


class GatedScan(Spec):
    """Delays as set on the delay generator: `start_s` + `step_s`·k for `count`, or `values_s` one by one.

    All delays are scanned once, then again, `repeats` times, so that a drift shows between repeats; each slice is the mean of
    `averages` frames. Before them come `dark` frames without the laser's light, and `reference` frames at `reference_delay_s`,
    which must be one of the delays: they show later whether light and delay were steady.
    """

    start_s: MomentTime | None = None
    step_s: StepTime | None = None
    count: _Times | None = None
    values_s: Annotated[tuple[MomentTime, ...], Field(min_length=1, max_length=65536)] | None = None
    repeats: _Times
    averages: _Times
    dark: _Count
    reference: _Count
    reference_delay_s: MomentTime | None = None

    @model_validator(mode="after")
    def _delays_are_given_once(self) -> GatedScan:
        even = (self.start_s, self.step_s, self.count)
        if (self.values_s is None) == any(one is None for one in even) or (
            self.values_s and any(one is not None for one in even)
        ):
            raise ValueError("the delays are given by start_s, step_s and count, or by values_s")
        if (self.reference > 0) != (self.reference_delay_s is not None):
            raise ValueError("reference_delay_s is given where there are reference frames, and only there")
        if self.reference_delay_s is not None and np.abs(self.delays_s() - self.reference_delay_s).min() > 1e-12:
            raise ValueError("reference_delay_s should be one of the delays")
        return self

    def delays_s(self) -> np.ndarray[Any, np.dtype[np.float64]]:
        """The delays, s."""
        if self.values_s is not None:
            return np.array(self.values_s, np.float64)
        assert self.start_s is not None and self.step_s is not None and self.count is not None
        return np.asarray(self.start_s + self.step_s * np.arange(self.count), np.float64)


def _slots(scan: GatedScan, scene: Scene) -> list[Slot]:
    rig = gated_rig(scene)
    if len(rig.gates) > 1:
        raise InputError(
            "A scan is recorded with one gate.", where=f"{scene.name}: rig.gates", value=len(rig.gates), allowed="1",
            next_step="record one plan for each gate",
        )  # fmt: skip
    delays = [float(f"{delay:.12f}") for delay in scan.delays_s()]  # the digits that are sent
    slots: list[Slot] = []

    def add(part: str, delay_s: float, laser_on: bool) -> None:
        group = slots[-1].group + 1 if slots else 0
        settings = {"delay": {"delay_s": delay_s, "laser_on": laser_on, "pulses": rig.pulses_per_slice}}
        slots.extend([Slot(part, group, settings)] * scan.averages)

    for _ in range(scan.dark):
        add("dark", delays[0], False)
    for _ in range(scan.reference):
        assert scan.reference_delay_s is not None
        add("reference", float(f"{scan.reference_delay_s:.12f}"), True)
    for _ in range(scan.repeats):
        for delay in delays:
            add("scan", delay, True)
    return slots


def _fixed(scan: GatedScan, scene: Scene) -> dict[str, dict[str, Any]]:
    return {"camera": {"exposure_s": gated_rig(scene).detector.exposure_s}}


def _shape(scan: GatedScan, scene: Scene) -> tuple[int, ...]:
    camera = gated_rig(scene).camera
    return camera.rows, camera.cols


def _build(scan: GatedScan, scene: Scene, taken: Taken, declared: Mapping[str, Any]) -> Built:
    groups = taken.of_group()
    first = [int(group[0]) for group in groups]
    told = {name: [taken.told(slot, "delay", name) for slot in first] for name in ("delay_s", "laser_on", "pulses")}
    times = taken.times_s()
    with np.errstate(all="ignore"):
        when = np.array([np.nanmin(times[group]) if taken.valid[group].any() else np.nan for group in groups])
    coords = {
        "delay": np.array(told["delay_s"], np.float64) + float(declared["t0_s"]),
        "gate": np.zeros(len(groups), np.int32),
        "pulses": np.array(told["pulses"], np.int32),
        "laser_on": np.array(told["laser_on"], bool),
        "time": when,
        # A mean of fewer frames than asked for has another noise than its neighbours.
        "valid": np.array([bool(taken.valid[group].all()) for group in groups]),
    }
    return Built({"counts": mean_of(taken, groups)}, coords, averaged=scan.averages > 1)


RECIPE = Recipe("gated", GatedScan, ("camera", "delay"), _slots, _fixed, _shape, _build)
