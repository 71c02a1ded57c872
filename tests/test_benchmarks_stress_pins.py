"""Stress axes and suites keep their meaning: every axis on every library scene, and every built-in suite.

The two pinned tables were written by these functions from the code before kinds of rig said what a stress means on them
and before suites had variants (commit fb3cdd1). They change only with a deliberate change of what a name means.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import pytest

from beambench.benchmarks.suites.stress import AXES, axis_overrides
from beambench.benchmarks.suites.suite import cells_of, list_suites, load_suite
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene
from beambench.scenes.rigs import RIGS

AXES_PINNED = Path(__file__).parent / "pinned_stress_axes.json"
SUITES_PINNED = Path(__file__).parent / "pinned_suites.json"

#: Scenes that are not in the library, with options and shapes that some axes need.
VARIANTS: dict[str, tuple[str, dict[str, Any]]] = {
    "flat-wall+intensifier": ("flat-wall", {"rig.detector.intensifier": {
        "gain": 50.0, "excess_noise_factor": 2.0, "phosphor_sigma_px": 0.5}}),
    "flat-wall+screen": ("flat-wall", {"rig.screen": {"distance_m": 4.7, "coverage": 0.5, "albedo": 0.5}}),
    "flat-wall+motion": ("flat-wall", {"rig.motion_m_per_s": [0.1, 0.0, 0.0]}),
    "flat-wall+declared": ("flat-wall", {"declared": {
        "t0_s": 1e-10, "medium.index.pressure_pa": 9.5e4, "laser.pulse.fwhm_s": 2e-9, "gates.0.width_s": 2e-9}}),
    "flat-wall+rectangular-pulse": ("flat-wall", {"rig.laser.pulse": {"kind": "rectangular", "width_s": 2e-9}}),
    "flat-wall+trapezoidal-pulse": ("flat-wall", {"rig.laser.pulse": {
        "kind": "trapezoidal", "rise_s": 1e-9, "top_s": 1e-9, "fall_s": 1e-9}}),
    "flat-wall+exponential-pulse": ("flat-wall", {"rig.laser.pulse": {
        "kind": "exponential", "fwhm_s": 1e-9, "tail_s": 1e-9}}),
    "flat-wall+gaussian-gate": ("flat-wall", {"rig.gates.0": {
        "kind": "gaussian", "fwhm_s": 2e-9, "transmission": 1.0}}),
    "flat-wall+sampled-gate": ("flat-wall", {"rig.gates.0": {
        "kind": "sampled", "start_s": 0.0, "step_s": 1e-9, "value": [0.0, 1.0, 1.0, 0.0]}}),
    "counter+short-record": ("counter", {"rig.record.samples": 6}),
    "amcw+murky": ("amcw", {"medium.phase_function": {"kind": "henyey-greenstein", "g": 0.9}}),
    "flat-wall+few-delays": ("flat-wall", {"rig.delays.count": 2}),
}  # fmt: skip

#: Two levels of every axis; 0.5 and 2 where none is given.
LEVELS = {
    "background": (0.0, 1e6), "incidence": (-20.0, 30.0), "distance": (-0.1, 0.3), "delay-step": (0.5, 3.0),
    "window-start": (-1e-9, 2e-9), "jitter": (0.0, 1e-10), "shot-jitter": (0.0, 1e-10), "fluctuation": (0.0, 0.05),
    "wrong-index": (0.0, 0.01), "wrong-t0": (0.0, 1e-10), "wrong-pulse": (-0.2, 0.2), "wrong-gate": (-0.2, 0.2),
    "motion": (-1.0, 2.0), "screen-gap": (0.2, 100.0), "screen-coverage": (0.1, 0.7), "specular": (0.0, 0.75),
}  # fmt: skip


#: Scenes of the library when the table was written, and `harbour-wall-7ns`, whose lines were added when it was; what is added
#: later has no past.
LIBRARY = (
    "amcw", "coastal-relief", "counter", "flat-wall", "harbour-wall", "harbour-wall-7ns", "object1", "object2", "panel",
    "photodetector-5m", "relief-tank", "single-photon", "sphere", "step", "tilted-wall",
)  # fmt: skip


def _scenes() -> dict[str, tuple[str, dict[str, Any]]]:
    return {name: (name, {}) for name in LIBRARY} | VARIANTS


#: Significant digits of pinned numbers: the last few are those of a machine's own logarithms and powers.
DIGITS = 12


def _rounded(data: Any) -> Any:
    if isinstance(data, dict):
        return {key: _rounded(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_rounded(value) for value in data]
    return float(f"{data:.{DIGITS}g}") if isinstance(data, float) else data


def _short(changes: Any) -> Any:
    """Long overrides (tables of a phase function) as their hash."""
    changes = _rounded(changes)
    text = json.dumps(changes, sort_keys=True)
    return changes if len(text) <= 300 else hashlib.sha256(text.encode()).hexdigest()[:16]


def axes_table() -> dict[str, Any]:
    """axis -> level -> [[overrides (None: does not apply), names of scenes], …]: scenes of equal overrides together."""
    scenes = {name: load_scene(base, changes) for name, (base, changes) in _scenes().items()}
    table: dict[str, Any] = {}
    for axis in sorted(AXES):
        table[axis] = {}
        for level in LEVELS.get(axis, (0.5, 2.0)):
            groups: dict[str, list[str]] = {}
            for name, scene in scenes.items():
                try:
                    changes = _short(axis_overrides(scene, axis, level))
                except InputError as error:
                    assert "does not apply" in error.what and error.allowed, (axis, name)
                    changes = None
                groups.setdefault(json.dumps(changes, sort_keys=True), []).append(name)
            table[axis][repr(level)] = [[json.loads(text), names] for text, names in groups.items()]
    return table


def suites_table() -> dict[str, Any]:
    """suite -> its hash, and that of its captures: axes, levels, seeds, keys and scenes without their titles."""
    table = {}
    for name in list_suites():
        loaded = load_suite(name)
        cells = [
            [c.scene_name, c.scene.model_dump(mode="json", exclude={"title"}), c.stress, repr(c.level), c.stress2,
             repr(c.level2), c.seed, c.key]
            for c in cells_of(loaded)
        ]  # fmt: skip
        digest = hashlib.sha256(json.dumps(_rounded(cells), sort_keys=True).encode()).hexdigest()[:16]
        table[name] = {"hash": loaded.hash, "cells": len(cells), "of_cells": digest}
    return table


@pytest.mark.parametrize("axis", sorted(json.loads(AXES_PINNED.read_text(encoding="utf-8"))))
def test_an_axis_changes_what_it_always_changed(axis: str, axes: dict[str, Any]) -> None:
    pinned = json.loads(AXES_PINNED.read_text(encoding="utf-8"))[axis]
    assert axes[axis] == pinned


@pytest.fixture(scope="module")
def axes() -> dict[str, Any]:
    return axes_table()


def test_the_pins_hold_a_scene_of_every_kind_of_rig_there_was(axes: dict[str, Any]) -> None:
    assert set(json.loads(AXES_PINNED.read_text(encoding="utf-8"))) <= set(axes)
    assert {load_scene(name).modality for name in LIBRARY} == {"gated", "waveform", "amcw"} <= set(RIGS)


def test_every_suite_asks_for_the_captures_it_always_asked_for() -> None:
    pinned, now = json.loads(SUITES_PINNED.read_text(encoding="utf-8")), suites_table()
    assert {name: now.get(name) for name in pinned} == pinned
