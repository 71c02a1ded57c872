"""A scene of a suite may have a rung of its own: run, sweep and data sets render it so, and an impossible one is refused first."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

import beambench.generator.generate as generating
from beambench.benchmarks.datasets.items import items_of
from beambench.benchmarks.run import run_suite
from beambench.benchmarks.search.sweep import sweep_suite
from beambench.benchmarks.suites.suite import cells_of, load_suite
from beambench.captures import open_captures
from beambench.scenes.errors import InputError

TINY = {
    "rig.turbulence": {"kind": "none"}, "rig.lenslets.across": 4, "rig.pupil.diameter_m": 0.6e-3, "rig.pupil.modes": 4,
    "rig.camera.rows": 44, "rig.camera.cols": 44, "rig.frames.count": 1, "rig.frames.reference_exposures": 2,
    "rig.pupil.samples": 4,
}  # fmt: skip
FIELDS = {"scene": "gated-turbulence", "name": "fields", "overrides": TINY, "fidelity": "coherent"}
SPOTS = {"scene": "gated-turbulence", "name": "spots", "overrides": TINY}


def suite(*scenes: dict[str, Any], **changes: Any) -> dict[str, Any]:
    data: dict[str, Any] = {
        "suite": "two-rungs", "scenes": list(scenes), "seeds": {"test": [2]}, "estimators": ["spot-centroid"],
        "fidelity": "geometric", "limits": {"time_s": 30.0, "memory_bytes": 2**31},
    }  # fmt: skip
    return data | changes


def test_a_scene_without_a_rung_has_the_suites() -> None:
    cells = cells_of(load_suite(suite(FIELDS, SPOTS, stresses=[{"axis": "photons", "values": [1.0, 0.5]}])))
    assert {(cell.scene_name, cell.fidelity) for cell in cells} == {("fields", "coherent"), ("spots", "geometric")}
    other = cells_of(load_suite(suite(FIELDS, SPOTS), {"fidelity": "isolated"}))
    assert [cell.fidelity for cell in other] == ["coherent", "isolated"]


def test_the_hash_holds_a_rung_only_where_there_is_one() -> None:
    plain = load_suite(suite(SPOTS))
    assert load_suite(suite(SPOTS | {"fidelity": None})).hash == plain.hash
    assert load_suite(suite(SPOTS | {"fidelity": "geometric"})).hash != plain.hash
    assert "fidelity" not in plain.suite.model_dump(mode="json")["scenes"][0]


def test_a_run_renders_each_scene_at_its_rung(tmp_path: Path) -> None:
    run_suite(suite(FIELDS, SPOTS), tmp_path / "run", report=False)
    rungs = {}
    for store in (tmp_path / "run" / "captures").glob("*.zarr"):
        rungs[store.name.split("__")[0]] = json.loads(open_captures(store)[0].attrs["fidelity"])["rung"]
    assert rungs == {"fields": "coherent", "spots": "geometric"}


def test_a_sweep_renders_each_scene_at_its_rung(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []
    real = generating.generate

    def spy(scene: Any, **given: Any) -> Any:
        asked.append(given["fidelity"])
        return real(scene, **given)

    monkeypatch.setattr(generating, "generate", spy)
    stresses = [{"axis": "photons", "values": [1.0, 0.9]}]
    sweep_suite(suite(FIELDS, SPOTS, stresses=stresses), tmp_path / "sweep", budget=2, report=False)
    # As written and at two levels; the bounds at the calm level are those of one more capture of the first scene.
    assert (asked.count("coherent"), asked.count("geometric"), len(asked)) == (4, 3, 7)


def test_a_data_set_renders_each_scene_at_its_rung_unless_one_is_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "two.json"
    path.write_text(json.dumps(suite(FIELDS, SPOTS)))
    groups = items_of(str(path), {}, None, None, None, False, False)
    assert {name: [item.fidelity for item in items] for name, items in groups.items()} == {
        "fields": ["coherent"], "spots": ["geometric"],
    }  # fmt: skip
    groups = items_of(str(path), {}, None, "isolated", None, False, False)
    assert {item.fidelity for items in groups.values() for item in items} == {"isolated"}


@pytest.mark.parametrize("verb", [run_suite, sweep_suite])
def test_a_rung_of_another_modality_is_refused_before_anything_is_made(verb: Any, tmp_path: Path) -> None:
    stresses = [{"axis": "photons", "values": [1.0, 0.5]}]
    with pytest.raises(InputError, match="not built for wavefront"):
        verb(suite(SPOTS, FIELDS | {"fidelity": "direct"}, stresses=stresses), tmp_path / "out")
    assert not (tmp_path / "out").exists()
    with pytest.raises(InputError, match="fidelity"):
        load_suite(suite(FIELDS | {"fidelity": "finest"}))
