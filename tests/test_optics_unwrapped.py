"""Phases of fields: smooth waves come back, vortices have residues and no gradient part, fields behind strong turbulence."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from beambench.optics.reconstruction.unwrapped import at_branch_points, least_squares_phase, residues
from beambench.optics.turbulence.propagation import split_step
from beambench.optics.turbulence.screens import kolmogorov_screen

Float = NDArray[np.float64]


def _plane(n: int) -> tuple[Float, Float]:
    axis = np.arange(n) - 0.5 * (n - 1)
    return np.meshgrid(axis, axis)


def test_a_smooth_wave_comes_back() -> None:
    """30 rad of phase, wrapped many times, on a ring, with and without weights by uneven light: to 1e-7."""
    x, y = _plane(48)
    phase = 0.4 * x - 0.3 * y + 0.012 * (x**2 + 0.5 * x * y)
    r = np.hypot(x, y)
    mask = (r < 22) & (r > 6)
    u = (1.5 + np.sin(0.2 * x)) * np.exp(1j * phase)
    want = phase - phase[mask].mean()
    for by_light in (False, True):
        got = least_squares_phase(u, mask, by_light=by_light)
        assert np.abs(got - want)[mask].max() < 1e-7
        assert np.isnan(got[~mask]).all()
    assert not residues(u).any()
    whole = least_squares_phase(np.exp(0.1j * phase))
    assert np.abs(whole - 0.1 * (phase - phase.mean())).max() < 1e-9


def test_parts_apart() -> None:
    """Two parts of a mask have a mean of their own."""
    x, _ = _plane(12)
    mask = np.ones((12, 12), bool)
    mask[:, 5:7] = False
    got = least_squares_phase(np.exp(0.3j * x), mask)
    for part in (slice(0, 5), slice(7, 12)):
        assert np.abs(got[:, part] - 0.3 * (x[:, part] - x[:, part].mean())).max() < 1e-8


def test_a_vortex_has_a_residue_and_no_gradient() -> None:
    """e^{iθ} about a cell's middle: charge 1 there and none elsewhere. Its δ runs around, so that hardly anything of it is a
    gradient: on a jagged disk up to .04 rad, which changes its sign in every mirror; the defocus below comes back."""
    x, y = _plane(40)
    bowl = 0.01 * (x**2 + y**2)
    u = (x + 1j * y) * np.exp(1j * bowl)
    charge = residues(u)
    assert charge[19, 19] == 1 and np.abs(charge).sum() == 1
    assert residues(np.conj(u))[19, 19] == -1
    mask = np.hypot(x, y) < 18
    got = least_squares_phase(u, mask)
    assert np.isnan(got[19:21, 19:21]).all() and at_branch_points(u).sum() == 4
    good = mask & ~at_branch_points(u)
    want = bowl - bowl[mask].mean()
    rest = np.where(good, got - want, 0.0)
    assert np.abs(rest).max() < 0.05
    assert max(np.abs(rest + rest[:, ::-1]).max(), np.abs(rest + rest[::-1]).max(), np.abs(rest + rest.T).max()) < 1e-7


def test_behind_strong_turbulence() -> None:
    """r₀ of 1.2 mm over 4 m of water: branch points come in pairs (their charges nearly cancel), and the wave that is left is
    closer to the field than the screen's own phase is."""
    n, h = 192, 8e-5
    rng = np.random.default_rng(5)
    screen = kolmogorov_screen(1.2e-3, (n, n), h, rng)
    u = split_step(np.ones((n, n)), [(0.0, screen), (4.0, None)], h, 532e-9 / 1.335)
    charge = residues(u)[48:-48, 48:-48].astype(int)
    assert np.abs(charge).sum() > 20 and abs(charge.sum()) < 0.3 * np.abs(charge).sum()
    part = u[48:-48, 48:-48]
    phase = least_squares_phase(part, by_light=True)
    good = np.isfinite(phase)

    def match(guess: Float) -> float:
        product = (part * np.exp(-1j * np.where(good, guess, 0.0)))[good]
        return float(np.abs(product.sum()) / np.abs(part[good]).sum())

    assert match(phase) > match(screen[48:-48, 48:-48])


def test_what_has_no_phase_is_refused() -> None:
    with pytest.raises(ValueError, match="two dimensions"):
        residues(np.ones(4))
    with pytest.raises(ValueError, match="mask"):
        least_squares_phase(np.ones((4, 4)), np.zeros((4, 4), bool))
    x, y = _plane(32)
    with pytest.raises(ValueError, match="settle"):
        least_squares_phase(np.exp(0.01j * x * y), np.hypot(x, y) < 12, steps=1)
