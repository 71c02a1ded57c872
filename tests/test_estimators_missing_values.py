"""A declared rig that lacks a value: an error that names its place, or an answer that does not need it; never another error."""

from __future__ import annotations

import json
from typing import Any

import pytest

from beambench.benchmarks.laws.check import fed, maker_of
from beambench.benchmarks.laws.maker import Maker
from beambench.estimators import get_estimator, list_estimators, run_estimator
from beambench.scenes.errors import InputError


def _places(node: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Paths of all values of a rig, those within objects only."""
    if not isinstance(node, dict):
        return []
    return [(*path, key) for key in node] + [p for key in node for p in _places(node[key], (*path, key))]


def _without(rig: dict[str, Any], path: tuple[Any, ...]) -> str:
    copy = json.loads(json.dumps(rig))
    node = copy
    for key in path[:-1]:
        node = node[key]
    del node[path[-1]]
    return json.dumps(copy)


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=pytest.mark.slow) if name == "spectrum-reml" else name for name in list_estimators()],
)
def test_a_missing_value_is_named(name: str, request: pytest.FixtureRequest) -> None:
    if name == "spectrum-reml":  # it takes two minutes, and reads the rig as the other spectra do
        request.getfixturevalue("long_run")
    found = get_estimator(name)
    maker = Maker(maker_of(found.stage.word).laws, found.stage, found.unfit)
    capture, refused = maker.clean(), []
    for path in _places(maker.rig):
        # The part that holds the converter or counter, and all of its values; of the rest one value of each object.
        if path[0] not in ("detector", "kind", "schema", "medium"):
            continue
        try:
            run_estimator(fed(name), capture.assign_attrs(rig=_without(maker.rig, path)))
        except InputError as error:
            refused.append(path)
            # The place is the value's, or that of the first value that is read within a part that is gone.
            assert path[-1] in error.where + error.what or ".".join(map(str, path)) in error.where, (path, error)
    part = maker.laws.converter(maker.rig)
    # Times need the group index, refraction the phase index; slopes on a camera neither.
    assert ("kind",) in refused
    without = found.stage.modality == "wavefront"
    assert without or {("medium", "group_index"), ("medium", "phase_index")} & set(refused)
    if part is not None:
        gone = {path[-1] for path in refused}
        assert {"gain_dn_per_e", "offset_dn", "read_noise_e", "full_well_e", "adc_bits"} <= gone
