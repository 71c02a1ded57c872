"""Figures 3 and 4: range error of a photodetector's pulse against reflectivity, roughness and incidence."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from typing import Any

import numpy as np

from .photodetector import (
    MEASUREMENTS,
    Setup,
    Surface,
    closed_form_std,
    largest_load_ohm,
    mean_signal,
    measure,
    possible,
    speckle_cells,
    surface,
    thermal_noise_v,
)
from .rows import Row, judge_settings

__all__ = [
    "ANGLES_DEG", "FREE", "REFLECTIVITIES", "ROUGH", "SLOPES", "SURFACES", "exponent", "figure_3_points", "figure_4_points",
    "reflection_rows", "setups", "share_in_order",
]  # fmt: skip

#: rms slopes of a smooth and a rough surface, and reflectivities of a strong and a weak one.
SMOOTH, ROUGH, _STRONG, _WEAK = 0.15, 0.5, 0.8, 0.2
REFLECTIVITIES = (0.8, 0.5, 0.3, 0.15)
ANGLES_DEG = tuple(range(0, 61, 10))
_REPEATS = 400
FREE = "pulse width; pulse energy; electronic noise; quantum efficiency; reflectivities; slopes; share of gloss"

#: Parameters that the document does not give, each over values that are possible with those that it gives. The first noise is
#: the thermal noise of 50 Ω; with the printed rise time no larger usual load is possible.
NOISES_V = (0.031e-3, 0.05e-3, 0.1e-3, 0.2e-3, 0.5e-3)
LOAD_OHM = 50.0
_PULSES_S = (0.5e-9, 1e-9, 3e-9)
_ENERGIES_J = (0.3e-3, 1e-3)
#: Also slopes above 1/√3, whose Eq. 4 is not greatest at θ = 0 (Figure 2): the text excludes none.
SLOPES = (SMOOTH, 0.3, ROUGH, 0.7, 0.9)
_SHARES = (0.1, 0.3, 0.6)
#: Half angles of the beam, rad, which set the number of speckles on the detector.
_BEAMS_RAD = (0.5e-3, 1e-3, 3e-3, 10e-3)

SURFACES = {
    (power, finish): surface(f"{power}, {finish}", rho, slope)
    for power, rho in (("strong", _STRONG), ("weak", _WEAK))
    for finish, slope in (("smooth", SMOOTH), ("rough", ROUGH))
}


def _rng(*key: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(0, spawn_key=key))


def _mean_abs(setup: Setup, target: Surface, angle_deg: float, rng: np.random.Generator, repeats: int) -> np.ndarray:
    """Mean |error| of each of `repeats` experiments of 30 measurements, m."""
    signal = mean_signal(setup, target, math.radians(angle_deg))
    errors = measure(setup, signal, rng, count=repeats * MEASUREMENTS)
    return np.asarray(np.abs(errors).reshape(repeats, MEASUREMENTS).mean(axis=1))


def figure_3_points() -> list[dict[str, Any]]:
    """The chart of Figure 3: one experiment of 30 measurements per surface, and the closed form, mm."""
    setup = Setup()
    points = []
    for number, ((power, finish), target) in enumerate(SURFACES.items()):
        error = _mean_abs(setup, target, 0.0, _rng(3, number), 1)[0]
        std = closed_form_std(setup, mean_signal(setup, target, 0.0))
        points.append(
            {"surface": target.name, "power": power, "finish": finish, "error": 1e3 * float(error),
             "expected": 1e3 * std * math.sqrt(2.0 / math.pi)}
        )  # fmt: skip
    return points


def figure_4_points() -> list[dict[str, Any]]:
    """The chart of Figure 4: mean |error| of 30 measurements against angle for four reflectivities, mm."""
    setup = Setup()
    points = []
    for s, rho in enumerate(REFLECTIVITIES):
        target = surface(f"{100 * rho:.0f} %", rho, ROUGH)
        for a, angle in enumerate(ANGLES_DEG):
            error = _mean_abs(setup, target, angle, _rng(4, s, a), 1)[0]
            std = closed_form_std(setup, mean_signal(setup, target, math.radians(angle)))
            points.append(
                {"surface": target.name, "angle": angle, "error": 1e3 * float(error),
                 "expected": 1e3 * std * math.sqrt(2.0 / math.pi)}
            )  # fmt: skip
    return points


def reflection_rows() -> list[Row]:
    """Rows of Figures 3 and 4."""
    return [*_figure_3(), *_figure_4()]


def exponent(setup: Setup) -> float:
    """d ln(error)/d ln(reflectivity) between the weak and the strong surface of one roughness, closed form."""
    strong, weak = (
        closed_form_std(setup, mean_signal(setup, SURFACES[power, "rough"], 0.0)) for power in ("strong", "weak")
    )
    return math.log(weak / strong) / math.log(_WEAK / _STRONG)


def setups() -> list[Setup]:
    """Our set-up and its variants, all of them possible with the printed values."""
    plain = Setup()
    parts = itertools.product((NOISES_V[0], NOISES_V[-1]), _PULSES_S, _ENERGIES_J)
    made = [replace(plain, noise_v=noise, pulse_fwhm_s=pulse, energy_j=energy) for noise, pulse, energy in parts]
    return [setup for setup in [plain, *made] if possible(setup)]


def share_in_order(light: float, cells: float, rng: np.random.Generator, count: int = 200_000) -> float:
    """Share of experiments, one fixed pattern of speckle each, that give the stronger of two surfaces more light.

    `light` is the ratio of the mean signals, `cells` the speckles M on the detector: each signal is its mean times a gamma
    variable of shape M and mean 1. Where electronic noise dominates, the brighter echo has the smaller error.
    """
    strong, weak = rng.gamma(cells, 1.0, (2, count))
    return float(np.mean(light * strong > weak))


def _expected(setup: Setup, target: Surface, angle_deg: float) -> float:
    return closed_form_std(setup, mean_signal(setup, target, math.radians(angle_deg)))


def _figure_3() -> list[Row]:
    setup, many = Setup(), setups()
    found = {(p["power"], p["finish"]): p for p in figure_3_points()}

    def order(larger: tuple[str, str], smaller: tuple[str, str]) -> list[float]:
        a, b = SURFACES[larger], SURFACES[smaller]
        return [found[larger]["error"] / found[smaller]["error"],
                *(_expected(s, a, 0.0) / _expected(s, b, 0.0) for s in many)]  # fmt: skip

    weak = [r for finish in ("smooth", "rough") for r in order(("weak", finish), ("strong", finish))]
    rough = [r for power in ("strong", "weak") for r in order((power, "rough"), (power, "smooth"))]
    # Eq. 4 as printed ties K_S to no slope.
    tied, free = SURFACES["strong", "smooth"], SURFACES["strong", "rough"]
    untied = _expected(setup, replace(free, k_s=tied.k_s), 0.0) / _expected(setup, tied, 0.0)
    exponents = {v: exponent(replace(setup, noise_v=v)) for v in NOISES_V}
    every = [*exponents.values(), *(exponent(s) for s in many)]
    beams = {b: speckle_cells(replace(setup, beam_half_angle_rad=b)) for b in _BEAMS_RAD}
    shown = {b: share_in_order(_STRONG / _WEAK, cells, _rng(31, n)) for n, (b, cells) in enumerate(beams.items())}
    return [
        Row("Figure 3", "range error of the weak surface over the strong one, rough", "1", math.nan, weak[len(weak) // 2],
            math.nan, judge_settings(ratio > 1.0 for ratio in weak),
            f"one experiment of {MEASUREMENTS} measurements at 5 m; {min(weak):.2f} … {max(weak):.2f} over {len(many)} set-ups "
            "and two finishes, closed form without speckle", FREE),
        Row("Figure 3", "share of single experiments that show this order, with speckle, beam of 1 mrad", "1", math.nan,
            shown[1e-3], math.nan, judge_settings(share > 0.95 for share in shown.values()),
            "the laser is coherent and the detector has no lens: one fixed pattern of speckle changes the light of a surface in "
            "all of its measurements. " + "; ".join(
                f"{1e3 * b:g} mrad: {cells:.3g} speckles on the detector, {100 * shown[b]:.0f} %" for b, cells in beams.items())
            + f" for reflectivities of {_STRONG:g} and {_WEAK:g}. The document does not give the divergence",
            "divergence of the beam; reflectivities; depolarisation"),
        Row("Figure 3", "range error of the rough surface over the smooth one, strong", "1", math.nan, rough[0], math.nan,
            judge_settings(ratio > 1.0 for ratio in (*rough, untied)),
            f"{min(rough):.2f} … {max(rough):.2f} where K_S ∝ 1/s² by conservation of energy, {untied:.2f} where both surfaces "
            "have the same K_S: at θ = 0 the printed Eq. 4 does not depend on the slope, and the document does not specify K_S",
            FREE + "; tie of K_S to the slope"),
        Row("Figure 3", "exponent of range error against reflectivity, electronic noise .1 mV", "1", math.nan,
            exponents[0.1e-3], 0.05, judge_settings(abs(value + 1.0) <= 0.05 for value in every),
            "the abstract: accuracy is proportional to reflectivity, an exponent of −1. "
            f"{max(every):.3f} … {min(every):.3f} over {len(every)} set-ups that are possible with the printed rise time: a "
            f"load of at most {largest_load_ohm(setup):.0f} Ω and at least its thermal noise of "
            f"{1e3 * thermal_noise_v(setup):.3f} mV, which dominates. Eq. 15 and 17, with photon noise alone, give −1/2",
            "electronic noise (.031 to .5 mV); pulse width; pulse energy; quantum efficiency"),
    ]  # fmt: skip


def _figure_4() -> list[Row]:
    setup, many = Setup(), setups()
    kinds = [surface("", 0.5, slope, share) for slope, share in itertools.product(SLOPES, _SHARES)]
    points = figure_4_points()
    at_60 = [_expected(s, kind, 60.0) / _expected(s, kind, 0.0) for s in many for kind in kinds]
    least = [min(ANGLES_DEG, key=lambda angle: _expected(setup, kind, angle)) == 0 for kind in kinds]
    first = [p for p in points if p["surface"] == points[0]["surface"]]
    cells = {b: speckle_cells(replace(setup, beam_half_angle_rad=b)) for b in _BEAMS_RAD}
    expected = np.array([p["expected"] for p in first])
    plain = _least_at_zero(expected, None, _rng(41))
    found = {b: _least_at_zero(expected, m, _rng(42, n)) for n, (b, m) in enumerate(cells.items())}
    strong, weak = points[len(ANGLES_DEG) - 1], points[-1]
    bright, dim = (surface("", rho, ROUGH) for rho in (REFLECTIVITIES[0], REFLECTIVITIES[-1]))
    ratios = [weak["error"] / strong["error"], *(_expected(s, dim, 60.0) / _expected(s, bright, 60.0) for s in many)]
    return [
        Row("Figure 4", "range error at 60° over that at 0°, reflectivity 80 %", "1", math.nan,
            first[-1]["error"] / first[0]["error"], math.nan,
            judge_settings([first[-1]["error"] > first[0]["error"], *(ratio > 1.0 for ratio in at_60)]),
            f"closed form {min(at_60):.2f} … {max(at_60):.2f} over {len(many)} set-ups and {len(kinds)} surfaces with slopes of "
            f"{SLOPES[0]:g} to {SLOPES[-1]:g}", FREE),
        Row("Figure 4", "share of experiments that find the least error at 0°, reflectivity 80 %", "1", math.nan,
            plain, math.nan, judge_settings([*(share > 0.95 for share in (plain, *found.values())), *least]),
            "«clearly minimum at zero»: 30 measurements give a mean |error| to 14 %, while the model changes by "
            f"{100 * (expected[1] / expected[0] - 1):.0f} % from 0 to 10°; with speckle "
            + ", ".join(f"{100 * found[b]:.0f} % at {1e3 * b:g} mrad" for b in cells)
            + f". The expected error is least at 0° for {sum(least)} of {len(least)} surfaces", FREE + "; divergence of the beam"),
        Row("Figure 4", "range error at 60°, 15 % surface over 80 % surface", "1", math.nan, ratios[0], math.nan,
            judge_settings(ratio > 1.0 for ratio in ratios),
            f"weaker surfaces lie higher; closed form {min(ratios[1:]):.2f} … {max(ratios):.2f} over set-ups, without speckle",
            FREE),
    ]  # fmt: skip


def _least_at_zero(expected: np.ndarray, cells: float | None, rng: np.random.Generator) -> float:
    """Share of `_REPEATS` experiments whose mean |error| of 30 measurements is least at the first angle.

    `expected` is the mean |error| at each angle; `cells` speckles change the light, and so the error, of each angle.
    """
    std = expected * math.sqrt(0.5 * math.pi)
    if cells is not None:
        std = std / rng.gamma(cells, 1.0 / cells, (_REPEATS, std.size))
    errors = np.abs(rng.standard_normal((MEASUREMENTS, _REPEATS, expected.size)) * std).mean(axis=0)
    return float(np.mean(np.argmin(errors, axis=1) == 0))
