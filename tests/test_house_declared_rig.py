"""docs/declared-rig.md: its tables are those of the readers, its examples run word for word; a rig that lacks values lists all."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beambench.benchmarks.laws.check import fed, maker_of
from beambench.benchmarks.laws.maker import Maker
from beambench.estimators import get_estimator, list_estimators, run_estimator
from beambench.estimators.rig import DeclaredRig
from beambench.scenes.errors import InputError

from ._rig_page import TABLES, example, section, table

#: Ranges that the examples hold, m, and their tolerance: five stated standard errors, or a tenth of a step of the counts.
ANSWERS = {
    "gated": (26.2e-9 / 2, 5e-4),
    "waveform": (40.3e-9 / 2, 5e-3),
    "amcw": (np.linspace(4.0, 5.0, 16) / 299792458.0, 2e-2),
}


@pytest.mark.parametrize("modality", sorted(TABLES))
def test_the_table_is_that_of_the_reader(project: Path, modality: str) -> None:
    assert table(TABLES[modality]) in section(project, modality)


@pytest.mark.parametrize("modality", sorted(ANSWERS))
def test_the_example_runs(project: Path, modality: str) -> None:
    code = example(project, modality)
    assert len([line for line in code.splitlines() if line]) <= 17
    names: dict[str, Any] = {}
    exec(code, names)
    found = names["found"]
    time, tolerance = ANSWERS[modality]
    assert found["valid"].values.all()
    np.testing.assert_allclose(found["range"].values, 299792458.0 * time, atol=tolerance)
    assert (found["sigma"].values > 0).all()


def test_the_example_of_a_line_runs(project: Path) -> None:
    code = example(project, "laser_line")
    assert len([line for line in code.splitlines() if line]) <= 21
    names: dict[str, Any] = {}
    exec(code, names)
    lines, points = names["lines"], names["points"]
    assert lines["valid"].values.all() and points["valid"].values.all()
    z = (lines["column"].values[0, :, 0] - np.linspace(100, 140, 64)) / lines["sigma"].values[0, :, 0]
    assert np.abs(z).max() < 5 and np.sqrt((z**2).mean()) < 1.5
    # A laser .2 m beside the pupil whose sheet looks along z: z = .2 m · f/(c − c0)/pitch.
    exact = 0.2 * 8e-3 / ((np.linspace(100, 140, 64) - 31.5) * 1e-5)
    np.testing.assert_allclose(points["point"].values[0, :, 0, 2], exact, rtol=2e-3)


@pytest.mark.parametrize("name", list_estimators())
def test_every_value_that_is_read_is_in_the_table(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The rig records what is asked of it; it has a name of its own, so that nothing comes from a cache."""
    one = get_estimator(name)
    maker = Maker(maker_of(one.stage.word).laws, one.stage, one.unfit)
    capture = maker.clean().assign_attrs(rig=json.dumps(maker.rig | {"name": f"recorded {name}"}))
    asked: set[str] = set()
    for method in ("need", "get", "unknown"):
        plain = getattr(DeclaredRig, method)

        def record(self: DeclaredRig, path: str, plain: Any = plain) -> Any:
            asked.add(re.sub(r"\.\d+$", ".*", path))
            return plain(self, path)

        monkeypatch.setattr(DeclaredRig, method, record)
    run_estimator(fed(name), capture)
    keys = TABLES[one.modality]
    known = {key.path for key in keys} | {key.path.removesuffix(".*") for key in keys} | {key.within for key in keys}
    assert len(asked) > 5
    assert asked - known == {"kind", "schema"}


@pytest.mark.parametrize("name", ["peak", "waveform-average", "amcw-phase", "line-ml", "spot-ml"])
def test_all_that_is_wrong_is_listed_at_once(name: str) -> None:
    one = get_estimator(name)
    maker = Maker(maker_of(one.stage.word).laws, one.stage, one.unfit)
    bare = {"schema": 1, "kind": maker.rig["kind"]}
    with pytest.raises(InputError) as caught:
        run_estimator(name, maker.clean().assign_attrs(rig=json.dumps(bare)))
    needed = [k for k in TABLES[one.modality] if not (k.optional or k.within or k.case)]
    assert len(needed) >= 4
    for key in needed:
        place = key.path.removesuffix(".*")
        assert place in caught.value.where
        assert f"{place}: {key.limits}" in caught.value.allowed
    assert "docs/declared-rig.md" in caught.value.next_step
    assert "\n  allowed: " in str(caught.value)


def test_a_wrong_value_stands_beside_a_missing_one() -> None:
    one = get_estimator("peak")
    maker = Maker(maker_of(one.stage.word).laws, one.stage, one.unfit)
    rig = json.loads(json.dumps(maker.rig))
    rig["gates"], rig["detector"]["adc_bits"] = [], 0.5
    del rig["medium"]["group_index"]
    with pytest.raises(InputError, match="Several values") as caught:
        run_estimator("peak", maker.clean().assign_attrs(rig=json.dumps(rig)))
    for place in ("gates", "detector.adc_bits", "medium.group_index"):
        assert place in caught.value.where
    assert caught.value.value == {"gates": [], "detector.adc_bits": 0.5}


def test_the_example_of_a_wavefront_runs(project: Path) -> None:
    """A plane wave that moves spots by (.6, −.3) px: coefficients k s D/4, within five standard errors; the rest is zero."""
    code = example(project, "wavefront")
    assert len([line for line in code.splitlines() if line]) <= 27
    names: dict[str, Any] = {}
    exec(code, names)
    found = names["found"]
    exact = np.zeros(5)
    exact[:2] = 2 * np.pi / 532e-9 * np.array([0.6, -0.3]) * 2e-5 / 5e-3 * 1.2e-3 / 4
    assert found["valid"].values.all()
    assert np.abs((found["zernike"].values[0] - exact) / found["sigma"].values[0]).max() < 5
