"""The delay of forward-scattered light: its small-angle limit, and photons followed in three dimensions."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from beambench.optics.water.delay import SHARES, delay_nodes, halo_ratio, single_turn_delay
from beambench.optics.water.halo import forward_share
from beambench.optics.water.phase_forms import FournierForand, HenyeyGreenstein

OCEAN = FournierForand(1.1, 3.58)


def test_small_angles_tend_to_their_closed_form() -> None:
    """All turns small and the beam wide: λ = b r, ⟨δ⟩ = r⟨ψ²⟩/12, and the ratio to the small-angle picture is 1.

    HG with g = .9999 has its light at a few times 1 − g: 99.9 % below .2 rad, where the next terms of the series are 1 %.
    """
    narrow = HenyeyGreenstein(0.9999)
    longer, light = single_turn_delay(narrow, 0.3, 0.0, 5.0, 1.2)
    assert light.sum() == pytest.approx(0.3 * 5.0 * forward_share(narrow), rel=0.01)
    # Far below the tail of large turns the distribution itself is compared: P(δ < d) with t even in 0 … 1.
    rng = np.random.default_rng(1)
    xi, t = rng.random((2, 400_000))
    g = narrow.g
    cosine = (1 + g * g - ((1 - g * g) / (1 - g + 2 * g * xi)) ** 2) / (2 * g)
    psi = np.arccos(np.clip(cosine, -1, 1))
    drawn = 5.0 * t * (1 - t) * psi**2 / 2
    for quantile in (0.3, 0.6, 0.9):
        d = np.quantile(drawn, quantile)
        assert light[longer < d].sum() / light.sum() == pytest.approx(quantile, abs=0.01)
    assert halo_ratio(narrow, 0.3, 0.0, 5.0, 1.2) == pytest.approx(1.0, abs=0.02)
    assert 0.94 < halo_ratio(OCEAN, 1.824, 2.19, 1.5, 0.45) < 0.97


@pytest.mark.parametrize(("b", "g"), [(0.6, 0.97), (1.6, 0.95)])
def test_delays_of_photons_followed_to_a_sphere(b: float, g: float) -> None:
    """Photons of an even cone of half angle w that meet a sphere about the lamp well inside the cone, and turned before.

    The walk knows no small angles; several turns are added as if in random azimuths, which is exact for the mean. 12 % on the
    mean and 20 % on the groups cover the walk's noise (1 % and 3 %) and the cone's edge at a quarter of it.
    """
    r, w = 1.5, 0.45
    rng = np.random.default_rng(5)
    delay = _walk(rng, 600_000, b, g, r, w)
    nodes = delay_nodes(HenyeyGreenstein(g), b, b, (r, r), w)
    delay.sort()
    edge = np.concatenate([[0], np.cumsum(SHARES)])
    found = [delay[int(lo * delay.size) : int(hi * delay.size)].mean() for lo, hi in pairwise(edge)]
    mean = float(SHARES @ nodes.delay_m[0])
    assert mean == pytest.approx(float(delay.mean()), rel=0.12)
    # the last 2 % hold the largest turns, of which few come
    assert nodes.delay_m[0][1:-1] == pytest.approx(np.asarray(found)[1:-1], rel=0.2)


def _walk(rng: np.random.Generator, count: int, b: float, g: float, r: float, w: float) -> np.ndarray:
    """Extra ways of photons, without absorption weights, that turned at least once and first leave the sphere within w/4."""
    cosine = 1 - rng.random(count) * (1 - np.cos(w))
    azimuth = 2 * np.pi * rng.random(count)
    sine = np.sqrt(1 - cosine**2)
    d = np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), cosine])
    x, length, turns = np.zeros((3, count)), np.zeros(count), np.zeros(count, dtype=int)
    out = []
    while x.shape[1]:
        step = rng.exponential(1 / b, x.shape[1])
        along = np.einsum("in,in->n", x, d)
        exit_at = -along + np.sqrt(along**2 + r * r - np.einsum("in,in->n", x, x))
        gone = step >= exit_at
        end = x[:, gone] + d[:, gone] * exit_at[gone]
        near = (end[2] > r * np.cos(w / 4)) & (turns[gone] > 0)
        # light on a longer way is turned away more often: the walk's density e^{−b L} holds that already
        out.append((length[gone] + exit_at[gone] - r)[near])
        keep = ~gone & (length + step < 3 * r)
        x, d, length, turns = (x + d * step)[:, keep], d[:, keep], (length + step)[keep], turns[keep] + 1
        xi = rng.random(x.shape[1])
        mu = (1 + g * g - ((1 - g * g) / (1 - g + 2 * g * xi)) ** 2) / (2 * g)
        d = _turned(rng, d, mu)
    return np.maximum(np.concatenate(out), 0.0)


def _turned(rng: np.random.Generator, d: np.ndarray, mu: np.ndarray) -> np.ndarray:
    helper = np.where(np.abs(d[2]) < 0.9, np.array([[0.0], [0], [1]]), np.array([[1.0], [0], [0]]))
    u = np.cross(d, helper, axis=0)
    u /= np.linalg.norm(u, axis=0)
    v = np.cross(d, u, axis=0)
    phi = 2 * np.pi * rng.random(d.shape[1])
    sine = np.sqrt(np.maximum(1 - mu**2, 0))
    turned = mu * d + sine * (np.cos(phi) * u + np.sin(phi) * v)
    return np.asarray(turned / np.linalg.norm(turned, axis=0))


@pytest.mark.parametrize(("b", "r"), [(0.0, (1.0, 2.0)), (0.1, (2.0, 1.0))])
def test_a_delay_needs_scattering_and_a_range(b: float, r: tuple[float, float]) -> None:
    with pytest.raises(ValueError, match="ranges above 0"):
        delay_nodes(OCEAN, b, 0.2, r, 0.3)
