"""Estimators with a known fault, for the checks of the search and of the failure maps. They are not in the registry.

`planted` answers as `poisson-ml`, but is wrong by thirty of its stated errors where the levels of some stresses, as given
by the declared rig, all lie in a region. `fading` loses elements at a rate that depends on the ambient light in a known
way. `registered` makes both known to this process and its children, as a plug-in would be.
"""

from __future__ import annotations

import json
import math
import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path

import numpy as np
import xarray as xr

from ...estimators.gated.poisson_ml import poisson_ml
from ...estimators.gated.weighted_average import weighted_average
from ...estimators.registry import estimator
from ...scenes.load import load_scene
from ...scenes.rigs.gated import gated_rig
from ..runner.jail import OFF
from ..search.space import SPACE, Dimension

__all__ = ["DIMENSIONS", "READABLE", "fading", "fading_rate", "inside", "planted", "region_text", "registered"]

#: Region of a fault: for some axes, the interval of positions 0 … 1; all must be met at once.
Region = dict[str, tuple[float, float]]

DIMENSIONS: dict[str, Dimension] = {dimension.axis: dimension for dimension in SPACE}
_BASE = "flat-wall"
_SIGMAS = 30.0

#: Axes whose level an estimator can read from the declared rig, and the path of the value.
READABLE = {
    "photons": ("laser", "pulse_energy_j"), "background": ("ambient_e_per_s",), "jitter": ("laser", "jitter_frame_s"),
    "shot-jitter": ("laser", "jitter_shot_s"), "fluctuation": ("laser", "energy_fluctuation"),
    "read-noise": ("detector", "read_noise_e"), "gain": ("detector", "gain_dn_per_e"),
}  # fmt: skip


def region_text(region: Region) -> str:
    """A region as the parameter of an estimator's label: `photons:0:0.33+background:0.67:1`."""
    return "+".join(f"{axis}:{low:.9g}:{high:.9g}" for axis, (low, high) in sorted(region.items()))


def inside(region: str, rig: dict[str, object]) -> bool:
    """Whether the levels given by a declared rig lie in a region."""
    for part in region.split("+"):
        axis, low, high = part.split(":")
        value: object = rig
        for key in READABLE[axis]:
            assert isinstance(value, dict)
            value = value[key]
        assert isinstance(value, int | float)
        level = float(value) / _energy() if axis == "photons" else float(value)
        # Levels have two digits: rounding is far below the tolerance, which is far below the size of any region.
        if not float(low) - 1e-6 <= DIMENSIONS[axis].position(level) <= float(high) + 1e-6:
            return False
    return True


@lru_cache(maxsize=1)
def _energy() -> float:
    return float(gated_rig(load_scene(_BASE)).laser.pulse_energy_j)


@estimator("gated", cites="deliberate fault: not an algorithm, a check of the search")
def planted(capture: xr.Dataset, *, region: str) -> xr.Dataset:
    """`poisson-ml`, wrong by thirty of its stated errors inside `region` (see `region_text`), on `flat-wall`."""
    result = poisson_ml(capture)
    if inside(region, json.loads(str(capture.attrs["rig"]))):
        result = result.assign(range=result["range"] + _SIGMAS * result["sigma"])
    return result


def fading_rate(level: float, level10: float, level50: float) -> float:
    """Share of elements lost: a logistic function of the logarithm of the level, 10 % at `level10` and 50 % at `level50`;
    a jump where the two are equal."""
    if level10 == level50:
        return float(level >= level50)
    slope = math.log(9.0) / math.log(level50 / level10)
    return 1.0 / (1.0 + math.exp(-slope * math.log(level / level50)))


@estimator("gated", cites="deliberate fault: not an algorithm, a check of the failure maps")
def fading(capture: xr.Dataset, *, level10: float, level50: float) -> xr.Dataset:
    """`weighted-average` that gives no answer for a random share of the elements, `fading_rate` of the ambient light."""
    result = weighted_average(capture, background="outside")
    rig = json.loads(str(capture.attrs["rig"]))
    counts = np.asarray(capture["counts"].values, np.int64)
    rng = np.random.default_rng(
        int(counts.sum())
    )  # a different draw for every capture, always the same for one capture
    rate = fading_rate(float(rig["ambient_e_per_s"]), level10, level50)
    kept = xr.DataArray(rng.random(counts.shape[1:]) >= rate, dims=("row", "col"))
    valid = result["valid"] & kept
    return result.assign(range=result["range"].where(valid), sigma=result["sigma"].where(valid), valid=valid)


@contextmanager
def registered() -> Iterator[None]:
    """Within the block, `planted` and `fading` are registered estimators in this process and its children."""
    with tempfile.TemporaryDirectory(prefix="beambench-planted-") as folder:
        info = Path(folder) / "beambench_planted-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: beambench_planted\nVersion: 1.0\n")
        lines = [f"{name} = beambench.benchmarks.checks.gated_planted:{name}" for name in ("planted", "fading")]
        (info / "entry_points.txt").write_text("\n".join(["[beambench.estimators]", *lines, ""]))
        sys.path.insert(0, folder)
        # They know the scene in which they are to break, and so read its file, which the jail keeps from estimators.
        before = os.environ.get(OFF)
        os.environ[OFF] = "none"
        try:
            yield
        finally:
            sys.path.remove(folder)
            del os.environ[OFF]
            if before is not None:
                os.environ[OFF] = before
