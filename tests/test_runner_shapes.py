"""Answers whose vectors have another number of components than their quantity are invalid."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from beambench.benchmarks.runner.protocol import misshapen
from beambench.captures.layouts import stage_of
from beambench.estimators.result import check_result
from beambench.scenes.errors import InputError


@pytest.mark.parametrize("axes", [1, 4])
def test_a_spot_has_two_axes(axes: int) -> None:
    """Answers of four were "ok", and their first two were scored."""
    sizes = {"frame": 2}
    assert not misshapen("spot", ("frame", "lenslet", "axis"), (2, 9, 2), dict(sizes))
    assert "axis" in misshapen("spot", ("frame", "lenslet", "axis"), (2, 9, axes), sizes)
    shape = (2, 9, axes)
    answer = xr.Dataset({
        "spot": (("frame", "lenslet", "axis"), np.ones(shape)), "sigma": (("frame", "lenslet", "axis"), np.ones(shape)),
        "valid": (("frame", "lenslet"), np.ones(shape[:2], bool)),
    })  # fmt: skip
    capture = xr.Dataset({"counts": (("frame", "row", "col"), np.zeros((2, 3, 3)))})
    with pytest.raises(InputError, match="wrong shape"):
        check_result(answer, capture, "planted", stage_of("centroid"))
