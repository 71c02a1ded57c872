"""`beambench estimators check` holds every waveform and AMCW estimator to the laws, and tells who breaks one."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

import beambench
from beambench.benchmarks.laws.ranger import RANGERS, check_ranger_laws, made_up_ranger
from beambench.captures.validate import validate

NAMES = [
    row["name"] for row in beambench.estimators_list() if row["origin"] == "built-in" and row["modality"] in RANGERS
]


def test_the_registry_holds_rangers() -> None:
    assert len(NAMES) >= 11


@pytest.mark.parametrize("name", NAMES)
def test_laws_hold(name: str) -> None:
    assert [result for result in beambench.estimators_check(name) if not result.holds] == []


@pytest.mark.parametrize("modality", RANGERS)
def test_made_up_captures_are_valid_and_answered(modality: str) -> None:
    capture = made_up_ranger(modality)
    validate(capture)
    found = beambench.estimators.run_estimator(f"{modality}-ml", capture)
    # 4000 electrons of a .4 ns echo in water: 1 mm; 2·10⁴ electrons at 200 MHz: 1 mm; seven of them.
    assert found["valid"].all() and np.abs(found["range"].values - (4 + 0.1 * np.linspace(0, 1, 48))).max() < 7e-3


def test_those_who_break_a_law_are_told() -> None:
    def guess(capture: xr.Dataset) -> xr.Dataset:
        capture["signal"].values.flags.writeable = False
        shots = capture.sizes["shot"]
        one = np.arange(shots) + 1.0
        return xr.Dataset({"range": ("shot", one), "sigma": ("shot", 0 * one), "valid": ("shot", one > 0)})

    broken = {result.law for result in check_ranger_laws(guess, "waveform") if not result.holds}
    assert "shots do not depend on their order" in broken and "finite or invalid: all zero" in broken
    assert "shift: a later zero of time, farther ranges" in broken

    def crash(capture: xr.Dataset) -> xr.Dataset:
        raise RuntimeError("no")

    assert not any(result.holds for result in check_ranger_laws(crash, "amcw"))
