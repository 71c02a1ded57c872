"""The package that `beambench estimators new` writes: a working estimator, its entry point and its test."""

from __future__ import annotations

import keyword
import re
from pathlib import Path

from ..scenes.errors import InputError
from .registry import list_estimators

__all__ = ["check_name", "is_package", "template_of", "write_package"]

_TEMPLATES = Path(__file__).parent / "templates"


def check_name(name: str) -> None:
    """Refuse a name that cannot be used, or that an installed estimator has. Raises InputError."""
    module = name.replace("-", "_")
    if not re.fullmatch(r"[a-z][a-z0-9]*(-[a-z0-9]+)*", name) or keyword.iskeyword(module) or len(name) > 60:
        raise InputError(
            "The name cannot be used.",
            where="name",
            value=name,
            allowed="lower-case letters, digits and single dashes, as my-median",
        )
    if name in list_estimators():
        raise InputError(
            "An estimator of this name is installed.", where="name", value=name, next_step="beambench estimators list"
        )


def template_of(stage: str | None) -> str:
    """The text of the module: of a range from a stack where no stage is given, else that of `templates/<stage>.txt`. Raises
    InputError for a stage without one."""
    if stage is None:
        return _MODULE
    known = sorted(path.stem for path in _TEMPLATES.glob("*.txt"))
    if stage not in known:
        raise InputError(
            "There is no template of an estimator of this stage.", where="stage", value=stage,
            allowed=", ".join(known), next_step="leave it out: the template reads a stack of gated images",
        )  # fmt: skip
    return (_TEMPLATES / f"{stage}.txt").read_text(encoding="utf-8")


def write_package(folder: Path, name: str, template: str) -> None:
    """Write the package of the estimator `name` (see `check_name`) with the module `template` (see `template_of`) into `folder`.
    Raises InputError if that fails."""
    module = name.replace("-", "_")
    package = f"beambench_{module}"
    files = {
        "pyproject.toml": _PYPROJECT.format(name=name, package=package, module=module),
        f"{package}.py": template.format(name=name, module=module),
        f"test_{package}.py": _TEST.format(name=name),
    }
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for file, text in files.items():
            (folder / file).write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(
            "The output cannot be written there.", where=str(folder), value=error.strerror or str(error)
        ) from error


def is_package(path: Path) -> bool:
    """Whether `beambench estimators new` wrote a folder, by its pyproject.toml."""
    try:
        text = (path / "pyproject.toml").read_text(encoding="utf-8")
    except (OSError, ValueError):
        return False
    return 'name = "beambench-' in text and '[project.entry-points."beambench.estimators"]' in text


_PYPROJECT = """[build-system]
requires = ["setuptools>=77"]
build-backend = "setuptools.build_meta"

[project]
name = "beambench-{name}"
version = "0.1.0"
dependencies = ["beambench"]

[project.entry-points."beambench.estimators"]
"{name}" = "{package}:{module}"

[tool.setuptools]
py-modules = ["{package}"]
"""

_MODULE = '''"""The estimator {name}: the delay at which the stack above its background has half its sum."""

from __future__ import annotations

import json

import numpy as np
import xarray as xr

from beambench.estimators import estimator
from beambench.optics.constants import C_M_PER_S


@estimator("gated", cites="describe here where your algorithm comes from")
def {module}(capture: xr.Dataset, *, threshold: float = 0.05) -> xr.Dataset:
    """Range of the echo's median. Replace the body with your algorithm; keep the three variables.

    A pixel whose echo rises less than `threshold` of its largest count above the background is called invalid.
    """
    rig = json.loads(capture.attrs["rig"])
    used = capture["valid"].values & capture["laser_on"].values
    order = np.argsort(capture["delay"].values[used], kind="stable")
    delay = capture["delay"].values[used][order]
    counts = capture["counts"].values[used][order].astype(float)
    signal = counts - np.median(counts, axis=0)
    strong = signal.max(axis=0) > np.maximum(threshold * counts.max(axis=0), 1.0)
    signal = np.clip(signal, 0.0, None)
    # Up to the middle of each slice: the light of a slice lies half before and half after its delay.
    share = (np.cumsum(signal, axis=0) - signal / 2) / np.maximum(signal.sum(axis=0), 1e-12)
    after = np.clip((share < 0.5).sum(axis=0), 1, len(delay) - 1)
    high = np.take_along_axis(share, after[None], 0)[0]
    low = np.take_along_axis(share, after[None] - 1, 0)[0]
    part = np.clip((0.5 - low) / np.maximum(high - low, 1e-12), 0.0, 1.0)
    median = delay[after - 1] + part * (delay[after] - delay[after - 1])
    # A gate that opens at the delay t and closes a width w later is centred on light that arrives at t + w/2.
    gate = rig["gates"][0]
    value = np.asarray(gate["value"], float)
    centre = gate["start_s"] + gate["step_s"] * (np.arange(value.size) * value).sum() / value.sum()
    range_m = C_M_PER_S * (median + centre) / (2.0 * rig["medium"]["group_index"])
    step_m = C_M_PER_S * np.median(np.diff(delay)) / (2.0 * rig["medium"]["group_index"])
    # Samples far below the offset or at the end of the converter are no measurement: their pixels have no answer.
    offset, top = rig["detector"]["offset_dn"], 2 ** rig["detector"]["adc_bits"] - 1
    sound = (counts >= offset / 2) & (counts < top)
    valid = strong & sound.all(axis=0) & np.isfinite(range_m) & (range_m > 0)
    dims = ("row", "col")
    return xr.Dataset(
        {{
            "range": (dims, np.where(valid, range_m, np.nan)),
            "sigma": (dims, np.where(valid, step_m, np.nan)),
            "valid": (dims, valid),
        }}
    )
'''

_TEST = '''"""The laws that every estimator keeps."""

import beambench


def test_keeps_the_laws() -> None:
    broken = [result for result in beambench.estimators_check("{name}") if not result.holds]
    assert not broken, broken
'''
