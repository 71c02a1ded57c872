"""The laws of `beambench estimators check` for one-detector rangers (waveform, amcw), on small made-up captures.

Shot i sees a point at range r_i: a waveform's samples are Poisson(α R(τ_i − t_k + Δ/2) + b) on the rig of the scene
"counter", AMCW samples Poisson(A(1 + C cos(ωτ_i − φ)) + b) on that of "amcw". No renderer is needed.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .gated import LawResult, Report, judged

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["RANGERS", "RANGER_LAWS", "check_ranger_laws", "made_up_ranger"]

RANGERS = ("waveform", "amcw")
_SHOTS = 48
_C_M_PER_S = 299_792_458.0
_DATA = {"waveform": "signal", "amcw": "samples"}

Run = Callable[["xr.Dataset"], "xr.Dataset"]
Change = Callable[[NDArray[Any]], NDArray[Any]]


def made_up_ranger(
    modality: str, *, seed: int = 1, t0_shift_s: float = 0.0, change: Change | None = None, counting: bool = False
) -> xr.Dataset:
    """A capture without truth; `change` alters the data of the seed's draw, `t0_shift_s` the declared zero of time.

    `counting`: a waveform of single photons, on the rig of the scene "single-photon" without dead time, of so many pulses
    that counts hide none after them.
    """
    from ...captures.build import make_capture
    from ...optics import amcw
    from ...optics.correlation.response import correlation
    from ...optics.correlation.waveforms import RectangularGate
    from ...scenes.declared import declared_rig
    from ...scenes.load import load_scene
    from ...scenes.rigs.amcw import amcw_rig
    from ...scenes.rigs.waveform import shown_pulse, waveform_rig

    ranges = 4.0 + 0.1 * np.linspace(0, 1, _SHOTS)
    rng = np.random.default_rng(seed)
    if modality == "waveform":
        changes: dict[str, Any] = {"rig.record.shots": _SHOTS}
        if counting:
            changes |= {"rig.pulses_per_shot": 65535, "rig.detector.readout.dead_time_s": 0.0}
        scene = load_scene("single-photon" if counting else "counter", changes)
        rig = declared_rig(scene)
        tau = 2 * rig["medium"]["group_index"] * ranges / _C_M_PER_S
        if counting:  # its record begins where its own target is
            tau += waveform_rig(scene).record.start_s + 4e-9 - tau[0]
        record, (pulse, delay) = waveform_rig(scene).record, shown_pulse(waveform_rig(scene))
        time = record.start_s + record.step_s * np.arange(record.samples)
        u = tau[:, None] + delay - time + 0.5 * record.step_s
        share = np.clip(correlation(pulse, RectangularGate(record.step_s, 1.0), u), 0, None)
        values = (0 if counting else 40) + rng.poisson(4000 * share + 4)
        coords = {"time": time + t0_shift_s}
    else:
        scene = load_scene("amcw", {"rig.shots": _SHOTS})
        rig = declared_rig(scene)
        modulation = amcw_rig(scene).modulation
        tau = 2 * rig["medium"]["group_index"] * ranges / _C_M_PER_S
        phase = 2 * np.pi * np.arange(modulation.phase_steps) / modulation.phase_steps
        frequency = np.asarray(modulation.frequencies_hz)
        mean = amcw.correlation_sample(2e4, 0.36, tau[:, None, None], frequency[:, None], phase)
        values = 100 + np.rint(0.5 * rng.poisson(mean + 3))
        coords = {"frequency": frequency, "phase": phase}
        rig["t0_s"] += t0_shift_s
    data = np.clip(values, 0, 65535).astype(np.uint16)
    return make_capture(
        modality,
        data={_DATA[modality]: data if change is None else change(data)},
        coords=coords | {"laser_on": True, "valid": True},
        truth={},
        attrs={"rig": json.dumps(rig), "truth_kind": "none"},
    )


def check_ranger_laws(
    run: Run, modality: str, report: Report | None = None, *, counting: bool = False
) -> list[LawResult]:
    """Hold an estimator, given as a function of a capture, to every law; as `estimator_laws.check_laws`. `counting`: of an
    estimator that reads waveforms of single photons only."""
    from ...captures.hide import hide_truth

    def made(**options: Any) -> xr.Dataset:
        return hide_truth(made_up_ranger(modality, counting=counting, **options))

    return judged({name: partial(law, run, made) for name, law in RANGER_LAWS.items()}, report)


def _repeats(run: Run, made: Callable[..., xr.Dataset]) -> str:
    first, second = run(made()), run(made())
    return "" if first.equals(second) else "two calls on one capture differ"


def _leaves_input(run: Run, made: Callable[..., xr.Dataset]) -> str:
    capture = made()
    before = capture.copy(deep=True)
    run(capture)
    return "" if capture.identical(before) else "the capture was changed"


def _shift(run: Run, made: Callable[..., xr.Dataset]) -> str:
    # A whole cycle of a 1 GHz counter, and a fraction of every modulation's.
    delay = 1e-9
    capture = made()
    per_s = _C_M_PER_S / (2 * float(json.loads(capture.attrs["rig"])["medium"]["group_index"]))
    base, moved = run(capture), run(made(t0_shift_s=delay))
    both = base["valid"].values & moved["valid"].values
    if not both.any():
        return "" if not base["valid"].any() else "no shot is answered before and after the shift"
    error = np.abs(moved["range"].values - base["range"].values - delay * per_s)[both]
    # A phase that wraps at the window's edge may land in the next cycle: most shots must not.
    worst = float(np.quantile(error, 0.9)) / (delay * per_s)
    return "" if worst < 2e-2 else f"a zero later by 1 ns moves the range by {worst:.3g} of that too much or too little"


def _permutation(run: Run, made: Callable[..., xr.Dataset]) -> str:
    order = np.random.default_rng(3).permutation(_SHOTS)
    base, mixed = run(made()), run(made(change=lambda data: data[order]))
    same = np.allclose(base["range"].values[order], mixed["range"].values, rtol=1e-6, equal_nan=True)
    return "" if same else "shots in another order give other ranges"


def _hard(run: Run, made: Callable[..., xr.Dataset], value: int) -> str:
    result = run(made(change=lambda data: np.full_like(data, value)))
    valid = result["valid"].values
    bad = valid & ~(np.isfinite(result["range"].values) & (result["sigma"].values > 0))
    return f"{int(bad.sum())} shots are called valid without a finite range and a positive sigma" if bad.any() else ""


RANGER_LAWS: dict[str, Callable[[Run, Callable[..., xr.Dataset]], str]] = {
    "same answer twice": _repeats,
    "leaves its input alone": _leaves_input,
    "shift: a later zero of time, farther ranges": _shift,
    "shots do not depend on their order": _permutation,
    "finite or invalid: all zero": partial(_hard, value=0),
    "finite or invalid: saturated": partial(_hard, value=65535),
    "finite or invalid: constant": partial(_hard, value=100),
}
