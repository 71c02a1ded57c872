"""A name that is no estimator's is answered by few names, not by all of them."""

from __future__ import annotations

import pytest

from beambench.benchmarks.runner.estimator_labels import check_estimators
from beambench.estimators import BUILTIN
from beambench.estimators.registry import get_estimator
from beambench.scenes.errors import InputError


@pytest.mark.parametrize("call", [get_estimator, lambda name: check_estimators([name])], ids=["registry", "run"])
def test_the_few_of_its_kind(call: object) -> None:
    assert callable(call)
    with pytest.raises(InputError) as caught:
        call("line-centriod")
    told = caught.value.allowed
    names = told.partition(" and ")[0].split(", ")
    assert names[0] == "line-centroid" and 2 <= len(names) <= 8
    assert {BUILTIN[name].split(".")[2] for name in names} == {"laser_line"}
    assert "others" in told
    assert caught.value.next_step.startswith("did you mean line-centroid")
    assert caught.value.next_step.endswith("beambench estimators list")


def test_a_name_like_none() -> None:
    with pytest.raises(InputError) as caught:
        get_estimator("zzz")
    assert "beambench estimators list" in caught.value.allowed and caught.value.next_step == "beambench estimators list"
    assert len(caught.value.allowed) < 60


def test_a_withheld_name_tells_few_too() -> None:
    with pytest.raises(InputError) as caught:
        get_estimator("chua-2016")
    assert "radiometric-average" in caught.value.allowed and "spot-ml" not in caught.value.allowed
