"""Figures 3, 4 and 7 once more on generated waveform captures: scene `photodetector-5m`, estimator `waveform-average`.

Another instrument than that of `photodetector` (a 5 ns pulse, a lens of 5 mm, 8 bits, energy fluctuation) and other code:
generator, detector chain and estimator. What both show does not hang on either's choices.
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
from .reflection import ANGLES_DEG, REFLECTIVITIES, ROUGH, SURFACES
from .rows import Row, judge_trend

__all__ = ["ranger_rows", "shots"]

_SCENE = "photodetector-5m"
_FREE = "rig of the scene photodetector-5m; reflectivities; slopes"
_WHOLE = "waveform-average[background=none,reach=0]"
#: Ambient light that makes a baseline of one grey level: 1e4 electrons in a sample of 100 ps.
_AMBIENT_E_PER_S = 1.0e14


def shots(
    target: Surface, angle_deg: float, seed: int, label: str = "waveform-average", **changes: Any
) -> NDArray[np.float64]:
    """Range errors, m, of the valid ones of 30 generated shots at a surface tilted by `angle_deg`."""
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
    error = {key: float(np.abs(shots(target, 0.0, 3)).mean()) for key, target in SURFACES.items()}
    pairs = [(("weak", f), ("strong", f)) for f in ("smooth", "rough")]
    pairs += [((p, "rough"), (p, "smooth")) for p in ("strong", "weak")]
    return [
        Row("Figure 3", f"generated: range error of the {', '.join(a)} surface over the {', '.join(b)}", "1", math.nan,
            error[a] / error[b], math.nan, judge_trend(error[a] > error[b]),
            f"{1e3 * error[a]:.1f} over {1e3 * error[b]:.1f} mm; {MEASUREMENTS} shots of {_SCENE}", _FREE)
        for a, b in pairs
    ]  # fmt: skip


def _figure_4() -> list[Row]:
    rows = []
    for rho in REFLECTIVITIES:
        target = surface(f"{100 * rho:.0f} %", rho, ROUGH)
        found = [shots(target, angle, 4) for angle in ANGLES_DEG]
        error = [float(np.abs(e).mean()) for e in found]
        order = float(np.corrcoef(np.argsort(np.argsort(error)), np.arange(len(error)))[0, 1])
        lost = 1.0 - sum(e.size for e in found) / (MEASUREMENTS * len(found))
        rows.append(
            Row("Figure 4", f"generated: range error at 60° over that at 0°, reflectivity {target.name}", "1", math.nan,
                error[-1] / error[0], math.nan, judge_trend(error[-1] > error[0], order > 0.7),
                f"{1e3 * error[-1]:.1f} over {1e3 * error[0]:.1f} mm, rank correlation with the angle {order:.2f}; "
                f"{100 * lost:.0f} % of shots without an answer", _FREE)
        )  # fmt: skip
    return rows


def _figure_7() -> list[Row]:
    target = surface("80 %", 0.8, ROUGH)
    pulled = [shots(target, a, 7, _WHOLE, **{"rig.ambient_e_per_s": _AMBIENT_E_PER_S}) for a in (0.0, 60.0)]
    clean = [shots(target, a, 7) for a in (0.0, 60.0)]
    mean, error, clean_mean, clean_error = (
        [1e3 * f(e) for e in group] for group, f in ((pulled, _mean), (pulled, _standard_error), (clean, _mean),
                                                     (clean, _standard_error))
    )  # fmt: skip
    rises = mean[1] - mean[0] > 3.0 * math.hypot(*error)
    return [
        Row("Figure 7", "generated: deviation at 60° with a baseline of one grey level left in", "mm", math.nan, mean[1],
            math.nan, judge_trend(rises),
            f"± {error[1]:.0f}; at 0° {mean[0]:.0f} ± {error[0]:.0f} mm; averaged about the peak with the baseline taken off "
            f"{clean_mean[1]:.1f} ± {clean_error[1]:.1f} and {clean_mean[0]:.1f} ± {clean_error[0]:.1f} mm",
            _FREE + "; baseline"),
    ]  # fmt: skip


def _mean(values: NDArray[np.float64]) -> float:
    return float(values.mean())


def _standard_error(values: NDArray[np.float64]) -> float:
    return float(values.std(ddof=1)) / math.sqrt(values.size)
