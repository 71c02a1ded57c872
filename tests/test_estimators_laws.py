"""The laws over the whole registry."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable

import numpy as np
import pytest
import xarray as xr

import beambench
from beambench.benchmarks.judges import JUDGES
from beambench.benchmarks.judges.bound import bound_of
from beambench.benchmarks.laws.check import check_laws, fed, laws_of, laws_record, maker_of
from beambench.benchmarks.laws.gated import clean_capture as gated_capture
from beambench.benchmarks.laws.maker import Maker
from beambench.benchmarks.laws.singular import SINGULARITIES
from beambench.benchmarks.laws.spoilt import SPOILT
from beambench.benchmarks.laws.suite import judged, laws_for, named
from beambench.captures.hide import hide_truth
from beambench.captures.layouts import layout_of, stage_of
from beambench.captures.validate import validate
from beambench.estimators import BUILTIN, get_estimator, list_estimators, run_estimator
from beambench.estimators.registry import Estimator
from beambench.scenes.errors import InputError

NAMES = list_estimators()


def _first(modality: str) -> str:
    """The stage of a modality that reads captures."""
    return layout_of(modality).stages[0].word


def _maker(found: Estimator) -> Maker:
    return Maker(maker_of(found.stage.word).laws, found.stage, found.unfit)


# ---------------------------------------------------------------- the registry


def test_the_registry_is_not_empty() -> None:
    assert set(BUILTIN) <= set(NAMES) and len(NAMES) >= 27
    for name in NAMES:
        found = get_estimator(name)
        assert len(found.cites) > 10 and found.function.__doc__
    for modality, least in (("gated", 15), ("waveform", 8), ("amcw", 3), ("laser_line", 10), ("wavefront", 16)):
        assert len(list_estimators(modality)) >= least


#: Estimators whose laws take long, and every which of them the default run tries.
LONG = {"spectrum-reml": 12, "deblur-tv": 4, "calibrate-board": 4}


@pytest.mark.parametrize("name", [name for name in NAMES if name not in LONG])
def test_laws_hold(name: str) -> None:
    results = beambench.estimators_check(name, compare=False).laws
    assert [result for result in results if not result.holds] == []
    assert len(results) >= 14


@pytest.mark.parametrize("name", LONG)
def test_some_laws_hold(name: str) -> None:
    found = get_estimator(fed(name))
    laws = named(found.function, Maker(laws_record(found.stage), found.stage, found.unfit, joint=found.joint))
    results = judged({law: laws[law] for law in list(laws)[:: LONG[name]]})
    assert [result for result in results if not result.holds] == []
    assert len(laws) >= 14 and len(results) >= 2


@pytest.mark.slow
@pytest.mark.parametrize("name", LONG)
def test_all_laws_hold(name: str, long_run: None) -> None:
    test_laws_hold(name)


def test_the_laws_are_the_same_for_every_modality_but_for_its_words() -> None:
    for modality in JUDGES:
        maker = maker_of(_first(modality))
        noun, names = layout_of(modality).noun, list(laws_for(maker))
        assert f"{noun}s do not depend on their order" in names and f"dead {noun}s leave the others alone" in names
        assert {"answers a bright, clean capture", "gain: twice the gain and the counts, the same answer"} <= set(names)
        assert {f"finite or invalid: {name}" for name in SINGULARITIES} <= set(names)
        assert sum(name.startswith("shift: ") for name in names) == 1
    counting, _ = laws_of("waveform-coates")
    converter = {"gain: twice the gain and the counts, the same answer"}
    converter |= {f"true or refused: {name}" for name in SPOILT if "clipped" in name or "dead" in name}
    assert set(laws_for(maker_of("waveform"))) - set(counting) == converter


def _without(capture: xr.Dataset, flag: str) -> xr.Dataset:
    """With a flag of the layout unset everywhere; where the layout has no such flag nothing is sound."""
    flag = flag if flag in capture.coords else "valid"
    return capture.assign_coords({flag: capture[flag] & False})


def _all_nan(maker: Maker) -> xr.Dataset:
    return maker.changed(lambda data: np.full_like(data, np.nan, dtype=maker.float_type))


NOTHING: dict[str, Callable[[Maker], xr.Dataset]] = {
    "all zero": lambda maker: maker.changed(np.zeros_like),
    "saturated": lambda maker: maker.changed(lambda data: np.full_like(data, maker.top)),
    "no number": _all_nan,
    "no sound data": lambda maker: _without(maker.clean(), "valid"),
    "light switched off": lambda maker: _without(maker.clean(), "laser_on"),
}


@pytest.mark.parametrize("name", NAMES)
def test_nothing_to_see_is_not_answered(name: str) -> None:
    found = get_estimator(fed(name))
    maker = _maker(found)
    for kind, make in NOTHING.items():
        answer = maker.first(found(make(maker)))
        assert not answer.valid.any(), kind
        assert np.isnan(answer.value).all() and np.isnan(answer.sigma).all(), kind


# ---------------------------------------------------------------- the captures that the laws run on


@pytest.mark.parametrize("modality", list(JUDGES))
def test_clean_captures_are_valid_and_can_be_doubled(modality: str) -> None:
    maker = maker_of(_first(modality))
    for make in maker.laws.captures:
        validate(make(1))
    name = layout_of(modality).data
    data, twice = maker.clean()[name].values, maker.doubled()
    assert twice is not None and (twice[name].values == 2 * data.astype(int)).all()
    assert twice.attrs["rig"] != maker.clean().attrs["rig"] and twice[name].dims == maker.clean()[name].dims
    assert 2 * int(data.max()) <= np.iinfo(data.dtype).max and int(data.max()) < maker.top
    assert maker.elements >= 40
    order = np.arange(maker.elements)[::-1]
    again = maker.changed(lambda values: values[:, order])
    assert not again.identical(maker.clean()) and maker.changed(lambda values: values).identical(maker.clean())


@pytest.mark.parametrize(
    ("make", "name"),
    [(gated_capture, "poisson-ml"), *((make, "waveform-ml") for make in maker_of("waveform").laws.captures),
     (maker_of("amcw").laws.captures[0], "amcw-ml")],
)  # fmt: skip
def test_maximum_likelihood_attains_the_bound_of_a_written_capture(make: Callable[[], xr.Dataset], name: str) -> None:
    capture = make(1)
    bound = bound_of(capture)
    found = run_estimator(name, hide_truth(capture))
    z = (found["range"].values - capture["truth_range"].values) / bound.sigma
    assert bound.kind == "exact"
    # Mean and variance of n standard normal errors: within 4 standard errors, 1/√n and √(2/n), of 0 and 1.
    assert found["valid"].values.all()
    assert abs(z.mean()) < 4 / np.sqrt(z.size) and abs((z**2).mean() - 1) < 4 * np.sqrt(2 / z.size)


def test_stages_without_laws_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    def none(capture: xr.Dataset) -> xr.Dataset:
        return capture

    with monkeypatch.context() as patch, pytest.raises(InputError, match="no laws for this stage"):
        patch.setattr("beambench.benchmarks.laws.check.JUDGES", {})
        check_laws(none, "centroid")
    with pytest.raises(InputError, match="no such stage"):
        check_laws(none, "echo")
    maker = maker_of("gated")
    with pytest.raises(InputError, match="no capture that this estimator can read") as raised:
        Maker(maker.laws, stage_of("gated"), lambda capture: "reads tubes only")
    assert "tubes" in str(raised.value)


def test_estimators_load_neither_generator_nor_renderer() -> None:
    code = (
        "import importlib, pkgutil, sys, beambench.estimators as e\n"
        "[importlib.import_module(m.name) for m in pkgutil.walk_packages(e.__path__, 'beambench.estimators.')]\n"
        "[e.get_estimator(n) for n in e.list_estimators()]; heavy = ('mitsuba', 'drjit', 'mitransient')\n"
        "bad = [m for m in sys.modules if m.startswith('beambench.generator') or m.split('.')[0] in heavy]\n"
        "print(bad); sys.exit(bool(bad))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
