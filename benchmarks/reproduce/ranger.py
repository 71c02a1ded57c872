"""Figures 3, 4 and 7 again on generated waveform captures: scene `photodetector-5m`, estimator `waveform-average`.

The instrument differs from that of `photodetector.py` (a 5 ns pulse, a lens of 5 mm, 8 bits, energy fluctuation), and so
does the code: generator, detector chain and estimator. Results common to both do not depend on the choices of one.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...estimators import run_estimator
from ...generator.generate import generate
from ...scenes.load import load_scene
from .photodetector import MEASUREMENTS, Surface, surface
from .reflection import REFLECTIVITIES, ROUGH, SURFACES
from .rows import Row, judge_settings

__all__ = ["ranger_rows", "shots"]

_SCENE = "photodetector-5m"
_FREE = "rig of the scene photodetector-5m, its noise; reflectivities; slopes; share of gloss"
_WHOLE = "waveform-average[background=none,reach=0]"
#: Ambient light that makes a baseline of one grey level: 1e4 electrons in a sample of 100 ps.
_AMBIENT_E_PER_S = 1.0e14
#: Choices of ours that may reverse a direction: electronic noise of a sample (the scene has 2.5e4 electrons) for Figures 3
#: and 4, and for Figure 7 the start of the record, which puts the echo before, near or after its middle.
_NOISES_E = (2.5e3, 5.0e4)
_STARTS_S = (12.0e-9, 8.0e-9, 4.0e-9)
#: Equal surfaces differ by less: the relative standard error of a mean |error| of 30 is √(π/2 − 1)/√30; three of them.
_CLEARLY = 1.0 + 3.0 * math.sqrt(2.0 * (0.5 * math.pi - 1.0) / MEASUREMENTS)


def shots(
    target: Surface, angle_deg: float, seed: int, label: str = "waveform-average", **changes: Any
) -> NDArray[np.float64]:
    """Range errors, m, of the valid shots among 30 generated ones at a surface tilted by `angle_deg`."""
    scene = load_scene(_SCENE, {
        "target.0.material.k_s": target.k_s, "target.0.material.k_d": target.k_d, "target.0.material.slope": target.slope,
        "target.0.shape.tilt_x_deg": float(angle_deg), "rig.record.shots": MEASUREMENTS, **changes,
    })  # fmt: skip
    capture = generate(scene, seed=seed)
    found = run_estimator(label, capture)
    error = found["range"].values - capture["truth_range"].values
    return np.asarray(error[found["valid"].values], dtype=np.float64)


def ranger_rows() -> list[Row]:
    """Rows of Figures 3, 4 and 7 from generated captures."""
    return [*_figure_3(), *_figure_4(), *_figure_7()]


def _figure_3() -> list[Row]:
    ratio = {}
    for finish in ("smooth", "rough"):
        for noise in (None, *_NOISES_E):
            weak, strong = (_error(SURFACES[power, finish], 0.0, 3, noise) for power in ("weak", "strong"))
            ratio[finish, noise] = weak / strong
    return [
        Row("Figure 3", "generated: range error of the weak surface over the strong one, rough", "1", math.nan,
            ratio["rough", None], math.nan, judge_settings(r > _CLEARLY for r in ratio.values()),
            f"{MEASUREMENTS} shots of {_SCENE}, whose capture has no speckle; {min(ratio.values()):.2f} … "
            f"{max(ratio.values()):.2f} over two finishes and three noises", _FREE),
    ]  # fmt: skip


def _error(target: Surface, angle_deg: float, seed: int, noise_e: float | None = None) -> float:
    """Mean |error| of 30 shots, m."""
    changes: dict[str, Any] = {} if noise_e is None else {"rig.detector.readout.read_noise_e": noise_e}
    return float(np.abs(shots(target, angle_deg, seed, **changes)).mean())


def _figure_4() -> list[Row]:
    ratio = {}
    for rho in REFLECTIVITIES:
        target = surface(f"{100 * rho:.0f} %", rho, ROUGH)
        for noise in (None, *_NOISES_E):
            ratio[rho, noise] = _error(target, 60.0, 4, noise) / _error(target, 0.0, 4, noise)
    return [
        Row("Figure 4", "generated: range error at 60° over that at 0°, reflectivity 80 %", "1", math.nan,
            ratio[REFLECTIVITIES[0], None], math.nan, judge_settings(r > _CLEARLY for r in ratio.values()),
            f"{min(ratio.values()):.2f} … {max(ratio.values()):.2f} over four reflectivities and three noises; {MEASUREMENTS} "
            "shots each, of which those without an answer are left out", _FREE),
    ]  # fmt: skip


def _figure_7() -> list[Row]:
    target = surface("80 %", 0.8, ROUGH)
    clean = [shots(target, a, 7) for a in (0.0, 60.0)]
    found = []
    for start in _STARTS_S:
        changes: dict[str, Any] = {"rig.ambient_e_per_s": _AMBIENT_E_PER_S, "rig.record.start_s": start}
        pulled = [shots(target, a, 7, _WHOLE, **changes) for a in (0.0, 60.0)]
        found.append(([1e3 * _mean(e) for e in pulled], [1e3 * _standard_error(e) for e in pulled]))
    mean, error = found[0]
    others = "; ".join(
        f"record from {1e9 * start:g} ns: {m[1]:.0f} ± {e[1]:.0f} at 60°, {m[0]:.0f} ± {e[0]:.0f} mm at 0°"
        for start, (m, e) in zip(_STARTS_S, found, strict=True)
    )
    return [
        Row("Figure 7", "generated: deviation at 60° with a baseline of one grey level left in", "mm", math.nan, mean[1],
            math.nan, judge_settings(m[1] - m[0] > 3.0 * math.hypot(*e) for m, e in found),
            f"± {error[1]:.0f}; {others}; averaged around the peak, baseline subtracted: "
            f"{1e3 * _mean(clean[1]):.1f} ± {1e3 * _standard_error(clean[1]):.1f} and "
            f"{1e3 * _mean(clean[0]):.1f} ± {1e3 * _standard_error(clean[0]):.1f} mm",
            _FREE + "; baseline; place of the echo in the record"),
    ]  # fmt: skip


def _mean(values: NDArray[np.float64]) -> float:
    return float(values.mean())


def _standard_error(values: NDArray[np.float64]) -> float:
    return float(values.std(ddof=1)) / math.sqrt(values.size)
