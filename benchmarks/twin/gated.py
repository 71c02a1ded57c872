"""The clauses of a range-gated camera."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...estimators.calibration.gated_delay_scan import ScanValues, delay_scan_values, known_range
from ...estimators.calibration.gated_noise import dark_statistics, noise_statistics
from ...estimators.calibration.gated_scan import DelayScan, read_scan, scan_half
from ...estimators.calibration.gated_single import fit_one_echo
from ...estimators.calibration.gated_survey import surveyed_delay
from ...estimators.calibration.gated_widths import delays_before, fit_response, lit_pixels, time_bound_s
from ...estimators.response import correlate_samples
from ...estimators.rig import DeclaredRig
from ...optics.constants import C_M_PER_S
from ...scenes.declared import declared_rig
from ...scenes.rigs.gated import gated_rig
from ...scenes.scene import Scene
from .clause import Ask, Evidence, TwinKind
from .gated_clauses import CLAUSES
from .gated_curves import curves_of, ranking_evidence
from .gated_measure import MAIN, Frame, Ranges, estimated, range_statistics, signal_statistics
from .gated_render import GatedTwin, rendered_twin, settings_of
from .gated_rig import stretched, twin_scene, uncertain_of
from .rig_file import TwinRig

__all__ = ["TWIN", "calibrated_half", "frame_of", "measure", "prepared_twin", "read_with_rig_of", "unbiased"]

Float = npt.NDArray[np.float64]

#: Estimators are run on up to this many repeats.
_RUNS = 4


def calibrated_half(first: DelayScan, range_m: Float | None, base: Scene) -> tuple[TwinRig, ScanValues]:
    """The rig of a twin from one half of a recording; what a scan does not tell stays as in `base`."""
    found = delay_scan_values(first, range_m)
    values: dict[str, Any] = {path: one.value for path, one in found.numbers.items()}
    sigmas = {path: one.sigma for path, one in found.numbers.items() if math.isfinite(one.sigma)}
    rig = gated_rig(base).model_dump(mode="json")
    for path, shape, one in (
        ("rig.laser.pulse", rig["laser"]["pulse"], found.pulse), ("rig.gates.0", rig["gates"][0], found.gate),
    ):  # fmt: skip
        values[path] = stretched(shape, one.value)
        key = next(key for key, value in shape.items() if key.endswith("_s") and value)
        sigmas[f"{path}.{key}"] = abs(values[path][key]) * one.sigma / one.value
    return TwinRig(values, sigmas, "the first half of the recording"), found


def prepared_twin(capture: xr.Dataset, first: DelayScan, ask: Ask, range_m: Float | None) -> tuple[GatedTwin, TwinRig]:
    """The twin that stands for the recording: its rig from the user or from the first half, its target from a scene or a
    fitted map."""
    settings = settings_of(first)
    rig = ask.rig
    if rig is None:
        base = twin_scene(capture, ask.scene, {}, settings)
        rig, _ = calibrated_half(read_with_rig_of(base, first), range_m, base)
        if ask.scene is not None and range_m is not None:
            scene = twin_scene(capture, ask.scene, rig.values, settings)
            draft = rendered_twin(scene, first, uncertain_of(scene, {}), None, ask.fidelity, True)
            rig = unbiased(rig, draft, first, range_m)
    scene = twin_scene(capture, ask.scene, rig.values, settings)
    uncertain = uncertain_of(scene, rig.sigmas)
    fitted = None
    if ask.scene is None:
        bare = read_with_rig_of(scene, first)
        fitted = fit_one_echo(bare, known_s=None if range_m is None else surveyed_delay(bare, range_m))
    return rendered_twin(scene, first, uncertain, fitted, ask.fidelity, range_m is not None), rig


def unbiased(rig: TwinRig, draft: GatedTwin, first: DelayScan, range_m: Float) -> TwinRig:
    """The calibrated rig without the bias of its calibration, which takes the echo to be R and nothing else.

    In water the light that is scattered forward comes later, and what is scattered back lies under the echo. The generator's
    own expectation of a draft of the twin is therefore fitted as the recording was; what this finds beside the draft's values
    is bias, and is taken off: θ = θ̂ − (T(θ̂) − θ̂), one step of indirect inference (C. Gouriéroux et al., J. Appl.
    Econometrics 8:S85, 1993).
    """
    scan = draft.read_with(first)
    known = surveyed_delay(scan, range_m)
    single = fit_one_echo(scan, known_s=known).single
    fit = fit_response(scan, known_s=known, light=draft.expected_dn(), single=single)
    values = dict(rig.values)
    whole = fit.response.value
    for path, one in (("rig.laser.pulse", fit.pulse), ("rig.gates.0", fit.gate)):
        values[path] = stretched(values[path], 1.0 / (one.value if math.isfinite(one.value) else whole))
    if math.isfinite(fit.shift_s.value) and "rig.t0_s" in values:
        values["rig.t0_s"] += fit.shift_s.value
    return replace(rig, values=values)


def read_with_rig_of(scene: Scene, scan: DelayScan) -> DelayScan:
    """A scan as it is read with the rig of a scene."""
    values = declared_rig(scene)
    rig = DeclaredRig(json.dumps(values, allow_nan=False), values)
    return replace(scan, delay_s=settings_of(scan) + gated_rig(scene).t0_s, rig=rig)


def frame_of(twin: GatedTwin, first: DelayScan, range_m: Float | None) -> Frame:
    """What the twin expects of the judged half."""
    rig = gated_rig(twin.scene)
    detector, tube = rig.detector, rig.detector.intensifier
    gain, excess = (1.0, 1.0) if tube is None else (tube.gain, tube.excess_noise_factor)
    k = detector.gain_dn_per_e
    slope = k * gain * excess
    dark = detector.dark_current_e_per_s * detector.exposure_s
    scan = twin.read_with(first)
    step, gate = scan.rig.samples("gates.0")[1:]
    ambient = rig.ambient_e_per_s * rig.pulses_per_slice * step * float(gate.sum())
    floor = k**2 * (detector.read_noise_e**2 + dark) + slope * k * gain * ambient + 1.0 / 12.0
    scene_range = twin.truth.get("truth_range")
    ranges = range_m if range_m is not None else None if scene_range is None else np.asarray(scene_range, np.float64)
    if ranges is not None and not np.isfinite(ranges).all():
        ranges = None
    known = None if ranges is None else surveyed_delay(scan, ranges)
    tau = known if known is not None else np.asarray(twin.light.returns.tau)
    shown = fit_one_echo(scan, known_s=known)
    extra: dict[str, Any] = {}
    if "truth_mixed" in twin.truth:
        extra |= {"mixed": _told_apart(twin, scan)} | {
            f"{end}_m": np.asarray(twin.truth[f"truth_{end}"], np.float64).ravel() for end in ("first", "last")
        }
    return Frame(
        twin.expected_dn(), slope, floor, known, delays_before(scan, tau), k * gain, twin.spread is not None,
        shown.single, lit_pixels(shown),
        None if ranges is None else ranges.ravel(), **extra,
    )  # fmt: skip


def _told_apart(twin: GatedTwin, scan: DelayScan) -> npt.NDArray[np.bool_]:
    """Pixels that see two surfaces: mixed, and by more than the standard deviation of the response (a steep surface is one
    surface)."""
    first, last = (np.asarray(twin.truth[f"truth_{end}"], np.float64).ravel() for end in ("first", "last"))
    n_g = scan.rig.number("medium.group_index", above=0)
    width = correlate_samples(scan.rig.samples("pulse"), scan.rig.samples("gates.0")).variance_s2
    mixed = np.asarray(twin.truth["truth_mixed"], bool).ravel()
    return np.asarray(mixed & (last - first > 0.5 * C_M_PER_S / n_g * math.sqrt(width)))


def measure(capture: xr.Dataset, ask: Ask) -> Evidence:
    """Calibrate on one half, render the other, and measure both alike. Raises InputError as `read_scan` and `twin_scene`."""
    scan = read_scan(capture)
    first, second = scan_half(scan, 0), scan_half(scan, 1)
    range_m = known_range(capture)
    twin, rig = prepared_twin(capture, first, ask, range_m)
    frame = frame_of(twin, first, range_m)
    labels = tuple(dict.fromkeys((MAIN, *ask.estimators)))
    two = frame.mixed is not None and bool(frame.mixed.any())
    judged = twin.read_with(second)
    real, fit = signal_statistics(judged, frame)
    answers = estimated(judged, labels, _RUNS, two=two)
    real |= range_statistics(answers, frame)
    twins: list[dict[str, float]] = []
    drawn: list[Ranges] = []
    shown: list[DelayScan] = []
    for number in range(ask.draws):
        one = twin.draw(ask.seed + number, second.repeats, len(second.dark))
        statistics, _ = signal_statistics(one, frame)
        drawn.append(estimated(one, tuple(answers.range_m), _RUNS, two=two))
        twins.append(statistics | range_statistics(drawn[-1], frame))
        shown = shown or [one]
    ranking = ranking_evidence(answers, drawn, frame)
    for one_twin, tau in zip(twins, ranking.twins, strict=True):
        one_twin["ranking"] = tau
    bounds = _bounds(judged, frame, fit, answers)
    if math.isfinite(ranking.real):
        real["ranking"] = ranking.real
        bounds["ranking"] = 1.0
    return Evidence(
        real, twins, bounds, {**_why_not(real, frame, ask), **ranking.why_not}, curves_of(judged, shown[0], twin, frame, fit),
        _about(scan, second, rig, ask, frame, answers), ranking.interval, frame.coverage,
    )  # fmt: skip


def _bounds(judged: DelayScan, frame: Frame, fit: Any, answers: Ranges) -> dict[str, float]:
    """Least standard errors: from the Fisher information of the moment form for times and widths, from the numbers of samples
    for the noise; the Cramér-Rao bound of one repeat for the precision."""
    pixels, dark = judged.counts.shape[2], len(judged.dark)
    noise, off = noise_statistics(judged), dark_statistics(judged)
    n_g = judged.rig.number("medium.group_index", above=0)
    half = 0.5 * C_M_PER_S / n_g
    times = time_bound_s(judged, fit)
    good = np.isfinite(times) & lit_pixels(fit) & frame.single
    bound = float(np.sqrt((times[good] ** 2).mean())) * half if good.any() else math.nan
    return {
        "gain": noise["slope"].sigma, "excess": noise["skewness"].sigma, "fluctuation": noise["fluctuation"].sigma,
        "offset": off["noise"].value / math.sqrt(pixels * dark),
        "read-noise": off["noise"].value / math.sqrt(2.0 * pixels * (dark - 1)),
        "dsnu": off["pattern"].sigma, "pulse": fit.pulse.sigma, "gate": fit.gate.sigma, "response": fit.response.sigma,
        "t0": fit.shift_s.sigma, "residual": math.sqrt(2.0 / (int(frame.judged.sum()) * (len(judged.delay_s) - 1))),
        "precision": bound, "trueness": bound / math.sqrt(pixels * min(_RUNS, judged.repeats)),
        "backscatter": math.sqrt(frame.floor / max(pixels * judged.repeats * int(frame.before.sum()), 1)) / frame.dn_per_e,
    }  # fmt: skip


def _why_not(real: Mapping[str, float], frame: Frame, ask: Ask) -> dict[str, str]:
    unknown = "the target's range is not known: record a surveyed target, or name the scene with --scene"
    no_edge = "the scene holds no pixel that sees two surfaces" if ask.scene is not None else (
        "without a scene it is not known where two surfaces meet: name it with --scene"
    )  # fmt: skip
    why = {
        "t0": unknown, "trueness": unknown, "flying": no_edge, "separability": no_edge,
        "backscatter": "no delay lies before the echo: begin the scan earlier by the length of the response",
        "pulse": "the scan does not tell pulse from gate: see the response as a whole",
        "gate": "the scan does not tell pulse from gate: see the response as a whole",
        "response": "pulse and gate are told apart: see these two",
        "prnu": "the light's pattern is fitted to the recording, the pixels' own is part of it: name the scene with --scene",
        "excess": "the third cumulant needs three repeats, and delays with few electrons",
    }  # fmt: skip
    return {name: text for name, text in why.items() if not math.isfinite(real.get(name, math.nan))}


def _about(scan: DelayScan, second: DelayScan, rig: TwinRig, ask: Ask, frame: Frame, answers: Ranges) -> list[str]:
    target = f"the scene {ask.scene!s}, its light scaled by one factor to the first half."
    if ask.scene is None:
        known = frame.known_s is not None
        target = "one echo in each pixel, its light " + (
            "fitted to the first half at the surveyed range." if known else "and time fitted to the first half."
        )
    lines = [
        f"The recording: {len(scan.delay_s)} delays × {scan.repeats} repeats, {len(scan.dark)} frames with the laser off, "
        f"{scan.shape[0]} × {scan.shape[1]} pixels. Every other repeat calibrates (first half); the others are judged "
        f"(second half, {second.repeats} repeats).",
        f"The twin's rig: {rig.source}, with {len(rig.sigmas)} uncertain values, which each of {ask.draws} draws of the twin "
        "draws anew.",
        f"The twin's target: {target}",
    ]
    lines.append(_one_echo(frame))
    return lines + [f"No answer from {label}: {why}" for label, why in answers.failed.items()]


def _one_echo(frame: Frame) -> str:
    """What is said of pixels with more than one echo."""
    lit, one = int(frame.lit.sum()), int((frame.single & frame.lit).sum())
    if one == lit:
        return f"All {lit} pixels with light show one echo in the first half."
    there = "pulse, gate, time zero, ranges and residuals" if frame.map else "pulse, gate and time zero"
    return (
        f"{one} of {lit} pixels with light ({100 * one / max(lit, 1):.1f} %) show one echo in the first half. The others see two "
        f"surfaces or a steep one, or differ in gate or noise. Clauses about {there} are judged in the pixels with one echo, and "
        "say nothing about the others."
    )


TWIN = TwinKind(CLAUSES, measure)
