"""`beambench estimators list|check|new|train`."""

from __future__ import annotations

import keyword
import re
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..output import check_free, claim, is_package

if TYPE_CHECKING:
    from ..benchmarks.laws.gated import LawResult, Report

__all__ = ["estimators_check", "estimators_list", "estimators_new", "estimators_train", "laws_of"]

#: The laws behind the range-gated stack; other modalities have none yet to check a plug-in with.
_CHECKED = "gated"
#: Longest import of a plug-in that a list waits for [s].
PLUGIN_IMPORT_S = 30.0


def estimators_list() -> list[dict[str, Any]]:
    """All estimators, built-in and plug-in: name, modality, parameters with defaults, source, and where it lives.

    One that cannot be imported is listed with the reason in `error`. Plug-ins are a stranger's code: each is imported in a
    process of its own, which may take `PLUGIN_IMPORT_S` seconds.
    """
    from ..estimators import BUILTIN, list_estimators

    return [_row(name) if name in BUILTIN else _row_of_plugin(name) for name in list_estimators()]


def _row(name: str, origin: str = "built-in") -> dict[str, Any]:
    import inspect

    from ..estimators import get_estimator
    from ..scenes.errors import InputError

    try:
        found = get_estimator(name)
    except InputError as error:
        return _failed(name, origin, error.what)
    parameters = {
        key: None if parameter.default is inspect.Parameter.empty else parameter.default
        for key, parameter in inspect.signature(found.function).parameters.items()
        if parameter.kind is inspect.Parameter.KEYWORD_ONLY
    }
    return {
        "name": name,
        "modality": found.modality,
        "parameters": parameters,
        "cites": found.cites,
        "origin": origin,
        "summary": (inspect.getdoc(found.function) or "").partition("\n")[0],
        "error": "",
    }


def _failed(name: str, origin: str, why: str) -> dict[str, Any]:
    return {"name": name, "modality": "", "parameters": {}, "cites": "", "origin": origin, "summary": "", "error": why}


#: What the child does: the row, on its last line, whatever the plug-in prints.
_CHILD = (
    "import json, sys; from beambench.verbs.estimators import _row; "
    "print('\\n' + json.dumps(_row(sys.argv[1], 'plug-in'), default=str))"
)


def _row_of_plugin(name: str) -> dict[str, Any]:
    import json
    import os
    import subprocess
    import sys

    environment = os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    try:
        done = subprocess.run(
            [sys.executable, "-c", _CHILD, name], capture_output=True, text=True, stdin=subprocess.DEVNULL,
            timeout=PLUGIN_IMPORT_S, env=environment, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return _failed(name, "plug-in", f"its import did not end within {PLUGIN_IMPORT_S:g} s")
    lines = done.stdout.strip().splitlines()
    try:
        row = json.loads(lines[-1]) if lines else None
    except ValueError:
        row = None
    if done.returncode or not isinstance(row, dict):
        said = (done.stderr.strip().splitlines() or ["nothing"])[-1]
        return _failed(name, "plug-in", f"its import ended the process (exit code {done.returncode}): {said[:200]}")
    return row


def estimators_check(estimator: str) -> list[LawResult]:
    """Hold an estimator to the laws of the registry on a small made-up stack.

    It repeats itself, leaves its input alone, follows a shift of the delays, does not depend on the order of pixels,
    and is finite or invalid near every singularity. A plug-in is tried in a process of its own: one that ends it, or that
    takes over `law_trial.LAW_LIMIT_S` for a law, breaks that law.

    Main arguments:
        estimator: label, `name` or `name[key=value,...]`.

    Raises:
        InputError: no such estimator or parameter, or one of a modality that has no laws here.
    """
    from ..benchmarks.laws.trial import try_laws
    from ..estimators import BUILTIN, parse_label

    name, _ = parse_label(estimator)
    if name in BUILTIN:
        _, judge = laws_of(estimator)
        return judge(None)
    return try_laws(estimator)


def laws_of(estimator: str) -> tuple[list[str], Callable[[Report | None], list[LawResult]]]:
    """The names of the laws for an estimator's modality, and the function that tries them. Imports the estimator.

    Raises InputError as `estimators_check`.
    """
    from ..benchmarks.laws.gated import LAWS, check_laws
    from ..benchmarks.laws.ranger import RANGER_LAWS, RANGERS, check_ranger_laws
    from ..benchmarks.runner.estimator_labels import check_estimators
    from ..estimators import get_estimator, parse_label
    from ..estimators.labels import check_parameters
    from ..scenes.errors import InputError

    (chosen,) = check_estimators([estimator])
    name, params = parse_label(chosen.label)
    found = get_estimator(name)
    checked = check_parameters(found.function, params, where=name)
    run = partial(found, **checked)
    if found.modality in RANGERS:
        counting = ("detector.readout.kind", "single-photon") in found.needs
        return list(RANGER_LAWS), lambda report: check_ranger_laws(run, found.modality, report, counting=counting)
    if found.modality != _CHECKED:
        raise InputError(
            "There are no laws for this modality.",
            where=name,
            value=found.modality,
            allowed=", ".join((_CHECKED, *RANGERS)),
        )
    return list(LAWS), lambda report: check_laws(run, report)


def estimators_new(name: str, *, out: str | Path | None = None, overwrite: bool = False) -> Path:
    """Write a package with a working estimator of your own, its entry point and its test; returns its folder.

    Main arguments:
        name: lower-case letters, digits and dashes, e.g. "my-median".

    Raises:
        InputError: a name that cannot be used, is taken, or an output that exists.
    """
    from ..estimators import list_estimators
    from ..scenes.errors import InputError

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
            "There is an estimator of this name.", where="name", value=name, next_step="beambench estimators list"
        )
    folder = claim(out, name, overwrite=overwrite, ours=is_package)
    package = f"beambench_{module}"
    files = {
        "pyproject.toml": _PYPROJECT.format(name=name, package=package, module=module),
        f"{package}.py": _MODULE.format(name=name, module=module),
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
    return folder


def estimators_train(
    data: str | Path | Sequence[str | Path],
    *,
    out: str | Path,
    units: int = 96,
    ridge: float = 1e-5,
    seed: int = 1,
    overwrite: bool = False,
) -> dict[str, float]:
    """Train `learned` on captures on disk and write its weights; use them as `learned[weights=FILE]`.

    Main arguments:
        data: stores of gated captures with truth, or folders that hold some.
        out: the weights, an .npz file.
    Other arguments:
        units: of the one layer. ridge: penalty of the linear solve. seed: of the layer and of the shares of the data.
        overwrite: replace what is there.

    Returns the numbers of captures and pixels, the rms error on pixels held out and that of the first guess (both in units
    of the response's standard deviation), and the size of the file.

    Raises:
        InputError: data that cannot be used, or an output that exists.
    """
    from ..estimators.gated.train import train
    from ..scenes.errors import InputError

    paths = [data] if isinstance(data, str | Path) else data
    if not isinstance(paths, Sequence) or not paths or not all(isinstance(path, str | Path) for path in paths):
        raise InputError(
            "Data to train on are given by their paths.", where="data", value=data, allowed="a path, or a list of paths",
            next_step="beambench generate learned-training -o training",
        )  # fmt: skip
    if not isinstance(out, str | Path):
        raise InputError("The weights go to a file.", where="out", value=out, allowed="a path, as w.npz")
    check_free(out, overwrite=overwrite)
    return train(paths, Path(out).expanduser(), units=units, ridge=ridge, seed=seed)


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

C_M_PER_S = 299_792_458.0


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
    valid = strong & np.isfinite(range_m) & (range_m > 0)
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
