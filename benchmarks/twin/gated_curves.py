"""Small charts of a gated certificate, and the ranking of estimators on rig and twin."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from ...estimators.calibration.gated_scan import DelayScan
from ...estimators.calibration.gated_widths import ResponseFit, response_profile
from .clause import Curve
from .gated_measure import Frame, Ranges
from .gated_render import GatedTwin

__all__ = ["Ranking", "curves_of", "kendall", "ranking_evidence"]

Float = npt.NDArray[np.float64]

_RESAMPLES = 400
#: Fewest estimators whose order says anything: three have six orders.
_LEAST = 4


@dataclass(frozen=True)
class Ranking:
    """Kendall's τ of the rig's order with that of the twin's mean errors; of each draw's with the same; the 95 % interval of
    the first."""

    real: float
    twins: Sequence[float]
    interval: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    why_not: Mapping[str, str] = field(default_factory=dict)


def kendall(a: Float, b: Float) -> Float:
    """τ-a = (concordant − discordant pairs)/all pairs, over the last axis; equal values count as neither. Kendall,
    Biometrika 30:81, 1938."""
    upper = np.triu_indices(a.shape[-1], 1)
    first, second = (np.sign(x[..., upper[0]] - x[..., upper[1]]) for x in (a, b))
    return np.asarray((first * second).mean(axis=-1))


def _squares(answers: Ranges, frame: Frame, labels: Sequence[str]) -> Float:
    """(label, judged pixel): mean square error over repeats; about the known range, or about the pixel's own mean. A pixel without
    an answer counts with the greatest error of any."""
    found = []
    for label in labels:
        values = answers.range_m[label][:, frame.judged]
        centre = frame.range_m[frame.judged] if frame.range_m is not None else values.mean(axis=0)
        found.append(np.where(np.isfinite(values), (values - centre) ** 2, np.nan).mean(axis=0))
    held = np.stack(found)
    worst = float(np.nanmax(held)) if np.isfinite(held).any() else 1.0
    return np.where(np.isfinite(held), held, worst)


def ranking_evidence(real: Ranges, twins: Sequence[Ranges], frame: Frame) -> Ranking:
    """Compare the order of estimators by rms error; the interval is by a bootstrap over the rig's pixels (400 resamples)."""
    labels = [label for label in real.range_m if all(label in one.range_m for one in twins)]
    nothing = [math.nan] * len(twins)
    if len(labels) < _LEAST or not twins:
        why = f"{len(labels)} estimators answered; their order says little below {_LEAST}: name more with --estimator"
        return Ranking(math.nan, nothing, {}, {"ranking": why})
    squares = _squares(real, frame, labels)
    scores = np.stack([_squares(one, frame, labels).mean(axis=1) for one in twins])
    whole = scores.mean(axis=0)
    pixels = squares.shape[1]
    pick = np.random.default_rng(0).multinomial(pixels, np.full(pixels, 1.0 / pixels), size=_RESAMPLES)
    again = kendall((pick @ squares.T) / pixels, np.broadcast_to(whole, (_RESAMPLES, whole.size)))
    value = float(kendall(squares.mean(axis=1), whole))
    low, high = (float(one) for one in np.percentile(again, [2.5, 97.5]))
    return Ranking(value, [float(kendall(one, whole)) for one in scores], {"ranking": (low, high)})


def curves_of(
    real: DelayScan, twin_scan: DelayScan, twin: GatedTwin, frame: Frame, fit: ResponseFit
) -> dict[str, Curve]:
    """Charts by clause: photon transfer, response, light before the echo, residuals."""
    level = real.dark.astype(np.float64).mean(axis=0)
    light = (real.counts.astype(np.float64).mean(axis=1) - level).mean(axis=1)
    spread = real.counts.astype(np.float64).var(axis=1, ddof=1)
    error = spread.mean(axis=1) * math.sqrt(2.0 / ((real.repeats - 1) * spread.shape[1]))
    order = np.argsort(light)
    found = {
        "gain": Curve(
            "Photon transfer of the delays", "mean above dark [DN]", "temporal variance [DN²]", light[order].tolist(),
            spread.mean(axis=1)[order].tolist(), error[order].tolist(),
            (frame.floor + frame.slope * np.maximum(light, 0.0))[order].tolist(),
        ),
    }  # fmt: skip
    profile = response_profile(real, fit)
    own = response_profile(twin_scan, fit)
    good = np.isfinite(profile["value"]) & np.isfinite(own["value"])
    found["pulse" if math.isfinite(fit.pulse.value) else "response"] = Curve(
        "Response: light against time of arrival after the gate opens", "time after the gate opens [ns]", "relative signal",
        (1e9 * profile["u_s"][good]).tolist(), profile["value"][good].tolist(), profile["sigma"][good].tolist(),
        own["value"][good].tolist(),
    )  # fmt: skip
    if frame.before.any():
        scale = 1.0 / frame.dn_per_e
        noise = np.sqrt(spread.mean(axis=1) / (real.repeats * spread.shape[1])) * scale
        found["backscatter"] = Curve(
            "Light before the echo", "delay [ns]", "mean [electron]", (1e9 * real.delay_s[frame.before]).tolist(),
            (light * scale)[frame.before].tolist(), noise[frame.before].tolist(),
            (frame.expected_dn.mean(axis=1) * scale)[frame.before].tolist(),
        )  # fmt: skip
    return found
