"""The procedure "delay-scan": values of a gated rig from a scan of delays, each with its standard error.

Input: one capture of a target that fills the image, every delay repeated, with frames of the laser off. Pixels that see two
surfaces are left out of pulse, gate and t0 (`gated_single`); a flat wall has none. It gives

    gain × F²       slope of the photon transfer            F²              third cumulant over variance² (`gated_noise`)
    offset, read noise, DSNU, energy fluctuation            frames with the laser off, and whole frames
    pulse, gate     stretches of the declared samples       t0              if the target's range is surveyed (`gated_widths`)
    backscatter     light at delays before the echo         gate map        a surveyed target's echoes, pixel by pixel
                                                                             (`gated_gate_map`)
 Photon transfer alone gives gain × F² of an intensified camera. Where the third cumulant tells F² to 10 %, it is used and
stated; otherwise the declared F² is kept. The standard error of the gain is that of gain × F². Where the scan does not tell
pulse from gate, both are stretched as the response as a whole is, and a note says so.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...scenes.errors import InputError
from .gated_gate_map import GateTiming, declared_map_s, gate_timing
from .gated_noise import Found, dark_statistics, noise_statistics
from .gated_scan import DelayScan, read_scan
from .gated_single import fit_one_echo
from .gated_survey import is_flat, surveyed_delay
from .gated_widths import ResponseFit, delays_before, lit_pixels
from .procedure import Calibrated, Figure, Procedure

__all__ = ["DELAY_SCAN", "ScanValues", "delay_scan_values", "known_range"]

Float = npt.NDArray[np.float64]

#: Relative standard error of F² up to which the third cumulant's value is used.
_EXCESS_TOLD = 0.1


@dataclass(frozen=True, eq=False)
class ScanValues:
    """What a scan tells of a rig.

    Main arguments:
        numbers: {path: value and standard error}. pulse, gate: stretches of the declared shapes. told: whether these are told
        apart. fit: of the response. backscatter_e: mean light before the echo, electrons; NaN where no delay is before it.
        slope: K G F². timing: of the gates of single pixels; None without a surveyed, flat target.
    """

    numbers: Mapping[str, Found]
    pulse: Found
    gate: Found
    told: bool
    fit: ResponseFit
    backscatter_e: Found
    slope: Found
    excess: Found
    timing: GateTiming | None


def known_range(capture: xr.Dataset) -> Float | None:
    """The target's ranges (row, col), m, if the capture states where they come from and holds any; None otherwise."""
    if "truth_range" not in capture or capture.attrs.get("truth_kind", "none") == "none":
        return None
    held = np.asarray(capture["truth_range"].values, np.float64)
    return held if np.isfinite(held).all() else None


def delay_scan_values(scan: DelayScan, range_m: Float | None = None, *, mapped: bool = False) -> ScanValues:
    """Calibrate a rig from a scan, with what is declared as the start.

    Main arguments:
        scan: of a target that fills the image. range_m: its surveyed ranges (row, col), None if unknown.
    Other arguments:
        mapped: find the gates of single pixels, too, if the target is surveyed and flat; time zero is then that of the middle.

    Raises:
        InputError: as `fit_one_echo`; a declared rig without detector.
    """
    rig = scan.rig
    noise, dark = noise_statistics(scan), dark_statistics(scan)
    known_s = None if range_m is None else surveyed_delay(scan, range_m)
    timing = None
    if mapped and range_m is not None and known_s is not None and is_flat(scan, range_m):
        timing = gate_timing(scan, known_s)
    fit = fit_one_echo(scan, known_s=None if known_s is None else known_s - _later(scan, timing))
    tube = rig.amplifier("detector.intensifier")
    slope, excess = noise["slope"], noise["excess"]
    told = rig.get("detector.intensifier") is not None and excess.sigma < _EXCESS_TOLD * excess.value
    f2 = max(excess.value, 1.0) if told else tube.excess
    gain = Found(slope.value / (tube.gain * f2), slope.sigma / (tube.gain * f2))
    numbers = {"rig.detector.gain_dn_per_e": gain} | _dark_values(scan, dark, gain.value, slope.value)
    if told:
        numbers["rig.detector.intensifier.excess_noise_factor"] = Found(f2, excess.sigma)
    varies = noise["fluctuation"]
    if math.isfinite(varies.value):
        numbers["rig.laser.energy_fluctuation"] = Found(max(varies.value, 0.0), varies.sigma)
    if math.isfinite(fit.shift_s.value):
        # The echo seems later by δ where the gate opens earlier than declared.
        declared = float(rig.get("t0_s") or 0.0)
        numbers["rig.t0_s"] = Found(declared - fit.shift_s.value, fit.shift_s.sigma)
    apart = math.isfinite(fit.pulse.value)
    pulse, gate = (fit.pulse, fit.gate) if apart else (fit.response, fit.response)
    return ScanValues(
        numbers, pulse, gate, apart, fit, _before(scan, fit, gain.value * tube.gain), slope, excess, timing
    )


def _later(scan: DelayScan, timing: GateTiming | None) -> Float | float:
    """How much later the gate of each pixel opens (pixel), s: as found, or as declared where it cannot be told."""
    if timing is not None and timing.told:
        return timing.offset_s
    declared = declared_map_s(scan)
    return 0.0 if declared is None else declared


def _dark_values(scan: DelayScan, dark: Mapping[str, Found], gain: float, slope: float) -> dict[str, Found]:
    """Offset, read noise and DSNU; the declared dark current and ambient light are taken off."""
    rig = scan.rig
    tube = rig.amplifier("detector.intensifier")
    electrons = float(rig.get("detector.dark_current_e_per_s") or 0.0) * float(rig.get("detector.exposure_s") or 0.0)
    step, gate = rig.samples("gates.0")[1:]
    pulses = float(rig.get("pulses_per_slice") or 0.0)
    ambient = float(rig.get("ambient_e_per_s") or 0.0) * pulses * step * float(gate.sum())
    level, noise, pattern = dark["level"], dark["noise"], dark["pattern"]
    offset = level.value - gain * (electrons + tube.gain * ambient)
    square = (noise.value**2 - 1.0 / 12.0 - slope * gain * tube.gain * ambient) / gain**2 - electrons
    read = math.sqrt(max(square, 0.0))
    error = noise.value * noise.sigma / gain**2
    return {
        "rig.detector.offset_dn": Found(offset, level.sigma),
        "rig.detector.read_noise_e": Found(read, error / max(read, math.sqrt(error))),
        "rig.detector.dsnu_e": Found(max(pattern.value, 0.0) / gain, pattern.sigma / gain),
    }


def _before(scan: DelayScan, fit: ResponseFit, dn_per_e: float) -> Found:
    """Mean light at the delays before the echo of every pixel, electrons."""
    before = delays_before(scan, fit.tau_s)
    if not before.any():
        return Found(math.nan, math.nan)
    light = scan.counts[before].astype(np.float64).mean(axis=2) - float(scan.dark.mean())
    error = math.sqrt(
        float(light.var(ddof=1)) / light.size + float(scan.dark.mean(axis=1).var(ddof=1)) / len(scan.dark)
    )
    return Found(float(light.mean()) / dn_per_e, error / dn_per_e)


def _lacking(captures: Sequence[xr.Dataset]) -> str:
    try:
        if len(captures) != 1 or str(captures[0].attrs.get("modality")) != "gated":
            return "one capture of a gated camera: a scan of delays over a target that fills the image"
        read_scan(captures[0])
    except InputError as error:
        return f"a scan of delays: {str(error).splitlines()[0]}"
    return ""


def _run(captures: Sequence[xr.Dataset]) -> Calibrated:
    capture = captures[0]
    scan = read_scan(capture)
    found = delay_scan_values(scan, known_range(capture), mapped=True)
    figures = [
        Figure(path.rpartition(".")[2], _unit(path), one.value, one.sigma, path, _NOTES.get(path, ""))
        for path, one in found.numbers.items()
    ]
    lit = lit_pixels(found.fit)
    used_pixels = lit & found.fit.single
    note = "" if found.told else "pulse and gate are not told apart: both are stretched as the response is"
    nan = math.nan
    figures += [
        Figure("pulse stretch", "1", found.pulse.value, found.pulse.sigma, "", note),
        Figure("gate stretch", "1", found.gate.value, found.gate.sigma, "", note),
        Figure("gain × F²", "DN/electron", found.slope.value, found.slope.sigma, "", "slope of the photon transfer"),
        Figure("F²", "1", found.excess.value, found.excess.sigma, "", "by the third cumulant"),
        Figure(
            "backscatter",
            "electron",
            found.backscatter_e.value,
            found.backscatter_e.sigma,
            "",
            "mean of the delays before the echo",
        ),
        Figure(
            "one echo",
            "1",
            float(used_pixels.sum()) / max(int(lit.sum()), 1),
            nan,
            "",
            "share of the lit pixels that one echo explains; pulse, gate and time zero are from these",
        ),
        Figure(
            "χ²/dof",
            "1",
            float(np.mean(found.fit.chi2[used_pixels])) / max(found.fit.dof, 1),
            nan,
            "",
            "of the fit of the response to these pixels; 1 where it explains the scan",
        ),
    ]
    values, sigmas = _shapes(scan, found)
    if found.timing is not None:
        figures += _of_timing(found.timing)
        if found.timing.told:
            skew = [found.timing.skew_x.value, found.timing.skew_y.value]
            values["rig.gate_map"] = {"iris_s": found.timing.iris.value, "skew_s": skew}
    used = {
        "delays": len(scan.delay_s),
        "repeats": scan.repeats,
        "laser_off": len(scan.dark),
        "pixels": scan.counts.shape[2],
        "lit_pixels": int(lit.sum()),
        "lit_pixels_with_one_echo": int(used_pixels.sum()),
    }
    return Calibrated(tuple(figures), values, sigmas, used)


def _of_timing(timing: GateTiming) -> list[Figure]:
    """Figures of the gate map; the rig file holds one that is told."""
    even = "an even gate, as far as the scan tells, or light that water scatters, which looks alike: no map is written"
    note = "" if timing.told else even
    rows = (
        ("iris", timing.iris, "iris_s"),
        ("skew along x", timing.skew_x, "skew_s.0"),
        ("skew along y", timing.skew_y, "skew_s.1"),
    )
    return [
        *(
            Figure(f"gate, {name}", "s", one.value, one.sigma, f"rig.gate_map.{path}" if timing.told else "", note)
            for name, one, path in rows
        ),
        Figure("gate, single pixels", "s", timing.scatter_s, math.nan, "", "rms about the map beyond their noise"),
    ]


def _shapes(scan: DelayScan, found: ScanValues) -> tuple[dict[str, Any], dict[str, float]]:
    """The stretched pulse and gate as samples, and the standard errors of their steps."""
    pulse, gate = scan.rig.samples("pulse"), scan.rig.samples("gates.0")
    p, g = found.pulse.value, found.gate.value
    values: dict[str, Any] = {
        "rig.laser.pulse": {"kind": "sampled", "step_s": pulse.step_s * p, "value": [float(v) for v in pulse.value]},
        "rig.gates": [
            {
                "kind": "sampled",
                "start_s": gate.start_s * g,
                "step_s": gate.step_s * g,
                "value": [float(v) for v in gate.value],
            }
        ],
    }
    return values, {
        "rig.laser.pulse.step_s": pulse.step_s * found.pulse.sigma,
        "rig.gates.0.step_s": gate.step_s * found.gate.sigma,
    }


def _unit(path: str) -> str:
    name = path.rpartition(".")[2]
    ends = {"_dn_per_e": "DN/electron", "_dn": "DN", "_e": "electron", "_s": "s"}
    return next((unit for end, unit in ends.items() if name.endswith(end)), "1")


_NOTES = {
    "rig.detector.gain_dn_per_e": "its error is that of gain × F²",
    "rig.detector.offset_dn": "the declared dark current and ambient light are taken off",
    "rig.detector.read_noise_e": "the declared dark current and ambient light are taken off",
    "rig.t0_s": "from the surveyed range of the target",
}

DELAY_SCAN = Procedure(
    name="delay-scan",
    line="gain, noise, offset, pulse, gate and time zero of a gated camera, from a scan of delays with repeats",
    lacking=_lacking,
    run=_run,
)
