"""The laws that `beambench estimators check` holds an estimator to, on a small made-up stack (no renderer is needed).

The stack: pixel i sees one surface at range r_i, counts ~ Poisson(α R(2 n_g r_i/c − t_k) + B) on the rig of the scene
"flat-wall", reduced to a strip of pixels; R by `optics.correlation`.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["LAWS", "LawResult", "Report", "check_laws", "judged", "made_up_capture"]

_ROWS, _COLS = 4, 24
_ELECTRONS, _BACKGROUND = 4000.0, 4.0
#: A narrow view, so that corrections by the angle of a pixel, right or wrong, are below any law's tolerance.
_NARROW = {"rig.camera.focal_length_m": 1.0, "rig.laser.illumination.half_angle_rad": 1e-3}
#: By how much of a step a shift of all delays may miss: weights by range (r³/r²) drift by a few thousandths.
_SHIFT_TOLERANCE = 2e-2


@dataclass(frozen=True)
class LawResult:
    """One law: its name, whether it held, and what was seen."""

    law: str
    holds: bool
    seen: str


Report = Callable[[str, "LawResult | None"], bool]


def made_up_capture(
    *, seed: int = 1, delay_shift_s: float = 0.0, counts: Callable[[NDArray[Any]], NDArray[Any]] | None = None
) -> xr.Dataset:
    """A gated capture without truth; `counts` changes the counts (slice, row, col) of the seed's draw."""
    import json

    from ...captures.build import make_capture
    from ...optics.correlation.response import correlation
    from ...scenes.declared import declared_rig
    from ...scenes.load import load_scene
    from ...scenes.medium_index import group_index
    from ...scenes.rigs.gated import gated_rig
    from ...scenes.sampling import optics_gate, optics_pulse

    scene = load_scene("flat-wall", {"rig.camera.rows": _ROWS, "rig.camera.cols": _COLS, **_NARROW})
    rig = gated_rig(scene)
    delays = rig.delays.start_s + rig.delays.step_s * np.arange(rig.delays.count)
    index = group_index(scene.medium, rig.laser.wavelength_m)
    middle = delays[len(delays) // 2] * 299792458.0 / (2 * index)
    ranges = middle + 0.02 * np.linspace(-1, 1, _ROWS * _COLS).reshape(_ROWS, _COLS)
    arrival = 2 * index * ranges / 299792458.0
    response = correlation(
        optics_pulse(rig.laser.pulse), optics_gate(rig.gates[0]), arrival[None] - delays[:, None, None]
    )
    draw = np.random.default_rng(seed).poisson(_ELECTRONS * np.clip(response, 0, None) + _BACKGROUND)
    values = np.clip(draw * rig.detector.gain_dn_per_e + rig.detector.offset_dn, 0, 65535).astype(np.uint16)
    return make_capture(
        "gated",
        data={"counts": values if counts is None else counts(values)},
        coords={
            "delay": delays + delay_shift_s,
            "gate": 0,
            "pulses": rig.pulses_per_slice,
            "laser_on": True,
            "time": 0.0,
            "valid": True,
        },
        truth={},
        attrs={"rig": json.dumps(declared_rig(scene)), "truth_kind": "none"},
    )


def check_laws(run: Callable[[xr.Dataset], xr.Dataset], report: Report | None = None) -> list[LawResult]:
    """Hold an estimator, given as a function of a capture, to every law. What it raises breaks the law, and so does an
    attempt to leave by `sys.exit`; a user's interrupt ends the check. `report`: as in `judged`."""
    return judged({name: partial(law, run) for name, law in LAWS.items()}, report)


def judged(laws: Mapping[str, Callable[[], str]], report: Report | None = None) -> list[LawResult]:
    """Try laws, given as functions that return what is wrong, "" for nothing.

    `report` is told of each law as it begins (name, None), and of its result (name, result); a law of which it returns
    False as it begins is left out.
    """
    results = []
    for name, law in laws.items():
        if report is not None and not report(name, None):
            continue
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                problem = law()
        except (Exception, SystemExit) as error:  # an estimator is a stranger's code: whatever it raises is a result
            problem = f"{type(error).__name__}: {error}"
        results.append(LawResult(name, not problem, problem or "holds"))
        if report is not None:
            report(name, results[-1])
    return results


def _seen(capture: xr.Dataset) -> xr.Dataset:
    from ...captures.hide import hide_truth

    return hide_truth(capture)


def _answers(run: Callable[[xr.Dataset], xr.Dataset]) -> str:
    result = run(_seen(made_up_capture()))
    share = float(result["valid"].mean())
    return "" if share > 0.5 else f"answers only {share:.0%} of a bright, clean stack"


def _repeats(run: Callable[[xr.Dataset], xr.Dataset]) -> str:
    first, second = run(_seen(made_up_capture())), run(_seen(made_up_capture()))
    same = all(
        np.array_equal(first[n].values, second[n].values, equal_nan=n != "valid") for n in ("range", "sigma", "valid")
    )
    return "" if same else "two calls on one capture differ"


def _leaves_input(run: Callable[[xr.Dataset], xr.Dataset]) -> str:
    capture = made_up_capture()
    before = capture.copy(deep=True)
    run(capture)
    return "" if capture.identical(before) else "the capture was changed"


def _shift(run: Callable[[xr.Dataset], xr.Dataset]) -> str:
    import json

    capture = made_up_capture()
    step = float(np.diff(capture["delay"].values[:2])[0])
    index = float(json.loads(capture.attrs["rig"])["medium"]["group_index"])
    per_s = 299792458.0 / (2 * index)
    base, moved = run(_seen(capture)), run(_seen(made_up_capture(delay_shift_s=7 * step)))
    both = base["valid"].values & moved["valid"].values
    if not both.any():
        return "no pixel is answered before and after the shift"
    error = np.abs(moved["range"].values - base["range"].values - 7 * step * per_s)[both].max() / (step * per_s)
    return (
        ""
        if error < _SHIFT_TOLERANCE
        else f"delays later by 7 steps move the range by {error:.3g} steps too much or too little"
    )


def _permutation(run: Callable[[xr.Dataset], xr.Dataset]) -> str:
    order = np.random.default_rng(3).permutation(_ROWS * _COLS)

    def shuffled(counts: NDArray[Any]) -> NDArray[Any]:
        return counts.reshape(len(counts), -1)[:, order].reshape(counts.shape)

    base, mixed = run(_seen(made_up_capture())), run(_seen(made_up_capture(counts=shuffled)))
    same = np.allclose(base["range"].values.ravel()[order], mixed["range"].values.ravel(), rtol=1e-6, equal_nan=True)
    return "" if same else "pixels in another order give other ranges"


def _hard(change: Callable[[NDArray[Any]], NDArray[Any]]) -> Callable[[Callable[[xr.Dataset], xr.Dataset]], str]:
    def law(run: Callable[[xr.Dataset], xr.Dataset]) -> str:
        result = run(_seen(made_up_capture(counts=change)))
        valid = result["valid"].values
        bad = valid & ~(np.isfinite(result["range"].values) & (result["sigma"].values > 0))
        return (
            f"{int(bad.sum())} pixels are called valid without a finite range and a positive sigma" if bad.any() else ""
        )

    return law


def _constant(value: int) -> Callable[[NDArray[Any]], NDArray[Any]]:
    return lambda counts: np.full_like(counts, value)


def _one_slice(counts: NDArray[Any]) -> NDArray[Any]:
    changed = np.full_like(counts, counts.min())
    changed[len(counts) // 2] = 65535
    return changed


LAWS: dict[str, Callable[[Callable[[xr.Dataset], xr.Dataset]], str]] = {
    "answers a bright, clean stack": _answers,
    "same answer twice": _repeats,
    "leaves its input alone": _leaves_input,
    "shift: later delays, farther ranges": _shift,
    "pixels do not depend on their order": _permutation,
    "finite or invalid: all zero": _hard(_constant(0)),
    "finite or invalid: saturated": _hard(_constant(65535)),
    "finite or invalid: constant": _hard(_constant(100)),
    "finite or invalid: light in one slice": _hard(_one_slice),
}
