"""Phase functions: normalised, consistent with their own distribution, and where published numbers are known, equal."""

from __future__ import annotations

import numpy as np
import pytest

from beambench.optics.water.phase_forms import (
    FournierForand,
    HenyeyGreenstein,
    MolecularPhase,
    PhaseFunction,
    TabulatedPhase,
    phase_cdf,
    phase_density,
)
from beambench.optics.water.phase_function import (
    asymmetry,
    backscatter_fraction,
    fournier_forand_of_backscatter,
    mean_square_angle,
    phase_cells,
    phase_from_spec,
    phase_quantile,
)
from beambench.optics.water.types import water_optics
from beambench.scenes import phase as specs

PETZOLD = water_optics("petzold1972", "harbour", 532e-9).phase
assert PETZOLD is not None
ALL: list[PhaseFunction] = [
    HenyeyGreenstein(0.924),
    HenyeyGreenstein(0.0),
    HenyeyGreenstein(1e-8),
    HenyeyGreenstein(-0.5),
    FournierForand(1.10, 3.5835),
    FournierForand(1.05, 3.2),
    FournierForand(1.2, 4.4),
    MolecularPhase(0.09),
    MolecularPhase(0.0),
    TabulatedPhase((0.01, 0.1, 1.0, np.pi), (300.0, 8.0, 0.1, 0.02), -1.3),
    PETZOLD,
]
IDS = [f"{type(p).__name__}-{i}" for i, p in enumerate(ALL)]


def integral(phase: PhaseFunction, low: float, high: float) -> float:
    """2π ∫ β̃ sinψ dψ by Gauss-Legendre in ln ψ, independent of the closed forms; panels end at a table's kinks."""
    edge = np.geomspace(low, high, 160)
    if isinstance(phase, TabulatedPhase):
        angle = np.asarray(phase.angle_rad)
        edge = np.unique(np.concatenate([edge, angle[(angle > low) & (angle < high)]]))
    x, w = np.polynomial.legendre.leggauss(16)
    log = np.log(edge)
    half = 0.5 * np.diff(log)[:, None]
    psi = np.exp(log[:-1, None] + half * (x + 1))
    return float(2 * np.pi * np.sum(half * w * phase_density(phase, psi) * np.sin(psi) * psi))


@pytest.mark.parametrize("phase", ALL, ids=IDS)
def test_the_density_integrates_to_one_and_to_its_distribution(phase: PhaseFunction) -> None:
    # the part below 1e-8 rad is what the distribution says it is: 2.6 % for the most singular one
    start = float(phase_cdf(phase, 1e-8))
    assert start + integral(phase, 1e-8, np.pi) == pytest.approx(1.0, abs=2e-7)
    for psi in (1e-5, 1e-3, 0.1, 1.0, 0.5 * np.pi, 3.0):
        assert float(phase_cdf(phase, psi)) == pytest.approx(start + integral(phase, 1e-8, psi), abs=2e-7)
    assert float(phase_cdf(phase, np.pi)) == pytest.approx(1.0, abs=1e-12)
    assert float(phase_cdf(phase, 0.0)) == 0.0
    psi = np.geomspace(1e-9, np.pi, 3000)
    assert np.all(np.diff(phase_cdf(phase, psi)) >= -1e-15) and np.all(phase_density(phase, psi) > 0)


@pytest.mark.parametrize("phase", ALL, ids=IDS)
def test_mean_cosine_and_backscatter_agree_with_quadrature(phase: PhaseFunction) -> None:
    psi, share = phase_cells(phase)
    # midpoints of 6000 cells of ln ψ: the error of ⟨cosψ⟩ is below Δ²/24 · ⟨ψ²⟩ < 1e-5
    assert asymmetry(phase) == pytest.approx(float(share @ np.cos(psi)), abs=1e-5)
    assert backscatter_fraction(phase) == pytest.approx(integral(phase, 0.5 * np.pi, np.pi), abs=2e-7)
    forward = psi < 0.5 * np.pi
    expected = float(share[forward] @ psi[forward] ** 2 / share[forward].sum())
    assert mean_square_angle(phase) == pytest.approx(expected, rel=3e-3)


@pytest.mark.parametrize("phase", ALL, ids=IDS)
def test_quantiles_invert_the_distribution(phase: PhaseFunction) -> None:
    u = np.linspace(0.05, 0.999, 300)
    assert np.allclose(phase_cdf(phase, phase_quantile(phase, u)), u, atol=2e-5)


def test_closed_forms_of_henyey_and_greenstein_and_of_molecules() -> None:
    for g in (0.3, 0.924, -0.6):
        printed = (1 - g) / (2 * g) * ((1 + g) / np.sqrt(1 + g * g) - 1)
        assert backscatter_fraction(HenyeyGreenstein(g)) == pytest.approx(printed, rel=1e-12)
        assert asymmetry(HenyeyGreenstein(g)) == g
    assert float(phase_density(HenyeyGreenstein(0.0), 1.0)) == pytest.approx(1 / (4 * np.pi))
    assert backscatter_fraction(MolecularPhase(0.09)) == pytest.approx(0.5)
    ratio = phase_density(MolecularPhase(0.09), np.pi) / phase_density(MolecularPhase(0.09), np.pi / 2)
    assert float(ratio) == pytest.approx(1.835, abs=1e-3)  # 1 + .835: Morel 1974


def test_fournier_forand_as_published() -> None:
    # Mobley, Sundman and Boss 2002: n = 1.10, μ = 3.5835 has B = .0183; theirs is the fit to Petzold's turbid waters
    assert backscatter_fraction(FournierForand(1.10, 3.5835)) == pytest.approx(0.0183, abs=5e-5)
    found = fournier_forand_of_backscatter(0.0183)
    assert found.index == pytest.approx(1.10, abs=1e-3) and found.slope == pytest.approx(3.5835, abs=1e-3)
    for fraction in (0.005, 0.013, 0.044):
        assert backscatter_fraction(fournier_forand_of_backscatter(fraction)) == pytest.approx(fraction, rel=1e-9)
    with pytest.raises(ValueError, match=r"fraction \(of backscatter\) must lie between"):
        fournier_forand_of_backscatter(0.4)
    # toward 0 it grows as ψ^{−2(1 + ν)}, ν = (3 − μ)/2
    psi = np.array([1e-6, 1e-5])
    low, high = phase_density(FournierForand(1.10, 3.5835), psi)
    assert np.log(high / low) / np.log(10) == pytest.approx(-2 * (1 - 0.5 * 0.5835), abs=0.01)


def test_fournier_forand_is_smooth_where_its_brackets_cancel() -> None:
    for n, mu in ((1.10, 3.58), (1.02, 3.1), (1.3, 4.2)):
        phase = FournierForand(n, mu)
        at = 2 * np.arcsin(np.sqrt(3) * (n - 1) / 2)  # δ = 1
        psi = at * (1 + np.linspace(-2e-3, 2e-3, 4001))
        value = phase_density(phase, psi)
        # Second differences of a smooth curve are of order step² = 1e-12; rounding in the cancelling branch next to
        # |δ − 1| = 1e-3 leaves 1e-16/1e-6 times a few ten. A jump between the branches would stand out.
        second = np.abs(np.diff(value, 2)) / value[1:-1]
        assert second.max() < 1e-7
        assert np.abs(np.diff(phase_cdf(phase, psi), 2)).max() < 1e-10


def test_henyey_greenstein_is_too_dark_backward() -> None:
    """Petzold's harbour, coastal and clear waters turn 1.9, 2.9 and 8.3 times more light straight back than g = .924."""
    hg = float(phase_density(HenyeyGreenstein(0.924), np.pi))
    ratios = []
    for kind in ("harbour", "coastal", "clear"):
        phase = water_optics("petzold1972", kind, 532e-9).phase
        assert phase is not None
        ratios.append(float(phase_density(phase, np.pi)) / hg)
        matched = HenyeyGreenstein(asymmetry(phase))
        assert float(phase_density(phase, np.pi) / phase_density(matched, np.pi)) > 1.5
    assert ratios == pytest.approx([1.91, 2.88, 8.26], rel=0.01)
    assert float(phase_density(FournierForand(1.10, 3.5835), np.pi)) / hg > 1.5


def test_a_table_keeps_its_values_and_continues_its_power_law() -> None:
    angle, value = (0.01, 0.1, 1.0, np.pi), (300.0, 8.0, 0.1, 0.02)
    phase = TabulatedPhase(angle, value, -1.3)
    ratio = phase_density(phase, np.asarray(angle)) / np.asarray(value)
    assert np.ptp(ratio) / ratio[0] < 1e-12
    between = phase_density(phase, np.sqrt(0.01 * 0.1)) / ratio[0]
    assert float(between) == pytest.approx(np.sqrt(300.0 * 8.0), rel=1e-12)
    assert float(phase_density(phase, 0.001) / phase_density(phase, 0.01)) == pytest.approx(10**1.3, rel=1e-9)


def test_specs_turn_into_shapes_and_bad_shapes_are_refused() -> None:
    assert phase_from_spec(specs.HenyeyGreenstein(g=0.5)) == HenyeyGreenstein(0.5)
    assert phase_from_spec(specs.FournierForand(index=1.1, slope=3.5)) == FournierForand(1.1, 3.5)
    table = specs.TabulatedPhase(angle_rad=(0.1, np.pi), value=(2.0, 1.0), forward_slope=-1.0)
    assert phase_from_spec(table) == TabulatedPhase((0.1, np.pi), (2.0, 1.0), -1.0)
    with pytest.raises(TypeError, match="not a phase function"):
        phase_from_spec(3)
    for bad in (
        lambda: HenyeyGreenstein(1.0),
        lambda: FournierForand(1.0, 3.5),
        lambda: FournierForand(1.1, 3.0),
        lambda: MolecularPhase(1.0),
        lambda: TabulatedPhase((0.1, 1.0), (2.0, 1.0), -1.0),
        lambda: TabulatedPhase((0.1, np.pi), (2.0, 0.0), -1.0),
        lambda: TabulatedPhase((0.1, np.pi), (2.0, 1.0), -2.0),
    ):
        with pytest.raises(ValueError, match=r"must|need|positive|above"):
            bad()
