"""The record of a modality on the floor of benchmarks: how its captures are judged."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from ...scenes.scene import Scene
from ..bounds.scan import Elements, Scan
from ..scores.truth import Bound, Truth
from ..suites.spec import Calibration

__all__ = ["Draw", "Judge"]

#: (what is recorded, number of the record) -> random generator of one record of a calibration.
Draw = Callable[[int, int], np.random.Generator]


@dataclass(frozen=True)
class Judge:
    """How the captures of a modality are judged.

    Main arguments:
        truth: capture -> truth by the name of the quantity.
        bound: capture -> bound by the name of the quantity: Cramér-Rao, kind "none" where the capture has no bound.
        neighbours: labels of estimators that `break` compares a new one with.
        scenes: of the library, in which `break` searches by default.
    Other arguments:
        scan: (capture, true scene) -> mean signals over a window of delays, from which thresholds follow; None where no
            threshold is known, so that the Cramér-Rao bound stands.
        calibrate: (scene, declared rig, photons of the calibration, random generators) -> the rig as a simulated, noisy
            calibration leaves it; None where the rig declares nothing that a calibration would recover.
        laws: "module:object" of the record `benchmarks.laws.maker.Laws`, by which estimators are checked; "" where the
            modality has no laws.
    """

    truth: Callable[[xr.Dataset], Mapping[str, Truth]]
    bound: Callable[[xr.Dataset], Mapping[str, Bound]]
    neighbours: tuple[str, ...]
    scenes: tuple[str, ...]
    scan: Callable[[xr.Dataset, Scene], tuple[Scan, Elements]] | None = None
    calibrate: Callable[[Scene, dict[str, Any], Calibration, Draw], dict[str, Any]] | None = None
    laws: str = ""
