"""The record of a modality in `benchmarks`: how its captures are judged."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import xarray as xr

from ...scenes.scene import Scene
from ..bounds.scan import Elements, Scan
from ..scores.truth import Bound, Truth
from ..suites.spec import Calibration

__all__ = ["Draw", "Judge"]

#: (kind of record, its number) -> random generator of one record of a calibration.
Draw = Callable[[int, int], np.random.Generator]


@dataclass(frozen=True)
class Judge:
    """How the captures of a modality are judged.

    Main arguments:
        truth: capture -> truth by name of the quantity.
        bound: capture -> Cramér-Rao bound by name of the quantity; kind "none" if the capture has no bound.
        neighbours: labels of the estimators with which `break` compares a new one.
        scenes: names of library scenes in which `break` searches by default.
    Other arguments:
        scan: (capture, true scene) -> mean signals over a window of delays, from which thresholds follow; None if the
            threshold is unknown, so that the Cramér-Rao bound is used everywhere.
        calibrate: (scene, declared rig, photons of the calibration, random generators) -> the declared rig after a
            simulated, noisy calibration; None if the rig declares nothing that a calibration recovers.
        feeders: of stages that read the results of others, by their words: label of the estimator (or chain) before them when
            they are tried alone.
        laws: "module:object" of the record `benchmarks.laws.maker.Laws`, with which estimators are checked; "" if the
            modality has no laws.
        rungs: "module:object" of the record `benchmarks.fidelity.bench.Bench`, with which the choice between rungs is measured.
        design: "module:object" of the record `benchmarks.design.kind.Designs`, with which settings of the rig are chosen; "" if
            none are.
        twin: "module:object" of the record `benchmarks.twin.clause.TwinKind`, the clauses of a certificate; "" if there are none.
    """

    truth: Callable[[xr.Dataset], Mapping[str, Truth]]
    bound: Callable[[xr.Dataset], Mapping[str, Bound]]
    neighbours: tuple[str, ...]
    scenes: tuple[str, ...]
    scan: Callable[[xr.Dataset, Scene], tuple[Scan, Elements]] | None = None
    calibrate: Callable[[Scene, dict[str, Any], Calibration, Draw], dict[str, Any]] | None = None
    feeders: Mapping[str, str] = field(default_factory=dict)
    laws: str = ""
    rungs: str = ""
    design: str = ""
    twin: str = ""
