"""Zernike circle polynomials in Noll's order with unit rms over the unit disk: indices, values, exact derivatives.

V_n^m = R_n^|m|(ρ) e^{imθ} is a polynomial in z = x + iy and its conjugate z̄, so that no division by ρ occurs and the derivatives
at the origin are those of any other point. With V_n^m = 0 for |m| > n:

    V_n^m = z V_{n−1}^{m−1} + z̄ V_{n−1}^{m+1} − V_{n−2}^m,
    ∂V_n^m/∂x = ∂V_{n−2}^m/∂x + n (V_{n−1}^{m+1} + V_{n−1}^{m−1}),
    ∂V_n^m/∂y = ∂V_{n−2}^m/∂y − i n (V_{n−1}^{m+1} − V_{n−1}^{m−1}).

Z_j = √(n+1) R_n^0 for m = 0, else √(2(n+1)) R_n^m cos mθ (even j) or sin mθ (odd j); θ from x (columns) to y (rows).

Sources: R. J. Noll, JOSA 66:207, 1976 (order, normalisation); A. J. E. M. Janssen, J. Eur. Opt. Soc. Rapid 9:14028, 2014
(derivatives); B. H. Shakibaei and R. Paramesran, Opt. Lett. 38:2487, 2013 (recurrence); ANSI Z80.28 (OSA/ANSI order).
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "noll_of", "noll_of_osa", "orders_of", "orders_of_osa", "osa_of", "osa_of_noll", "zernike", "zernike_gradient",
]  # fmt: skip

Float = NDArray[np.float64]
Complex = NDArray[np.complex128]


def orders_of(noll: int) -> tuple[int, int]:
    """(n, m) of Noll's index j ≥ 1: m > 0 for cosines (even j), m < 0 for sines (odd j). Raises ValueError for j < 1."""
    j = _index(noll, 1, "Noll's index")
    n = int((np.sqrt(8 * j - 7) - 1) / 2)
    while (n + 1) * (n + 2) // 2 < j:
        n += 1
    place = j - n * (n + 1) // 2  # 1 … n + 1 within the radial order
    m = 2 * (place // 2) if n % 2 == 0 else 2 * ((place + 1) // 2) - 1
    return n, m if j % 2 == 0 else -m


def noll_of(n: int, m: int) -> int:
    """Noll's index j of radial order n and azimuthal order m (cosine for m > 0, sine for m < 0). Raises ValueError if |m| > n or
    n − |m| is odd."""
    _orders(n, m)
    first = n * (n + 1) // 2
    if m == 0:
        return first + 1
    pair = first + abs(m)
    # The two indices of |m| ≥ 1 are first + |m| and first + |m| + 1; the even one is the cosine.
    return pair if (pair % 2 == 0) == (m > 0) else pair + 1


def osa_of(n: int, m: int) -> int:
    """OSA/ANSI index (n(n + 2) + m)/2, from 0. Raises ValueError as `noll_of`."""
    _orders(n, m)
    return (n * (n + 2) + m) // 2


def orders_of_osa(osa: int) -> tuple[int, int]:
    """(n, m) of an OSA/ANSI index ≥ 0. Raises ValueError below 0."""
    j = _index(osa, 0, "The OSA/ANSI index")
    n = int(np.ceil((-3 + np.sqrt(9 + 8 * j)) / 2))
    return n, 2 * j - n * (n + 2)


def osa_of_noll(noll: int) -> int:
    """OSA/ANSI index of Noll's index. Both orders have unit rms and equal signs: coefficients move, they do not scale."""
    return osa_of(*orders_of(noll))


def noll_of_osa(osa: int) -> int:
    """Noll's index of an OSA/ANSI index."""
    return noll_of(*orders_of_osa(osa))


def zernike(noll: Iterable[int] | int, x: ArrayLike, y: ArrayLike) -> Float:
    """Z_j(x, y) (modes, …), dimensionless, unit rms over the unit disk; beyond it the same polynomials.

    Main arguments:
        noll: Noll's indices, from 1. x, y (…): coordinates in radii of the pupil.

    Raises ValueError for an index below 1.
    """
    orders = _wanted(noll)
    values = _circle(orders, x, y)
    return np.stack([_real(values[n, abs(m)], n, m) for n, m in orders])


def zernike_gradient(noll: Iterable[int] | int, x: ArrayLike, y: ArrayLike) -> Float:
    """(∂Z_j/∂x, ∂Z_j/∂y) as (modes, 2, …), per radius of the pupil; exact, at the origin too.

    Arguments as for `zernike`. Raises ValueError for an index below 1.
    """
    orders = _wanted(noll)
    values = _circle(orders, x, y)
    zero = np.zeros_like(values[0, 0])
    slopes: dict[tuple[int, int], tuple[Complex, Complex]] = {}

    def value(n: int, m: int) -> Complex:
        if abs(m) > n:
            return zero
        return values[n, m] if m >= 0 else np.conj(values[n, -m])

    def slope(n: int, m: int) -> tuple[Complex, Complex]:
        if m > n:
            return zero, zero
        if (n, m) not in slopes:
            up, down = value(n - 1, m + 1), value(n - 1, m - 1)
            before = slope(n - 2, m)
            slopes[n, m] = before[0] + n * (up + down), before[1] - 1j * n * (up - down)
        return slopes[n, m]

    return np.stack([np.stack([_real(part, n, m) for part in slope(n, abs(m))]) for n, m in orders])


def _wanted(noll: Iterable[int] | int) -> list[tuple[int, int]]:
    asked = [noll] if isinstance(noll, int | np.integer) else list(noll)
    if not asked:
        raise ValueError("At least one index of Noll is needed.")
    return [orders_of(int(j)) for j in asked]


def _circle(orders: list[tuple[int, int]], x: ArrayLike, y: ArrayLike) -> dict[tuple[int, int], Complex]:
    """V_n^m for 0 ≤ m ≤ n, up to the highest n asked for."""
    px, py = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
    z: Complex = px + 1j * py
    back = np.conj(z)
    v = {(0, 0): np.ones_like(z)}
    for n in range(1, max(n for n, _ in orders) + 1):
        for m in range(n % 2, n + 1, 2):
            term = z * (v[n - 1, m - 1] if m else np.conj(v[n - 1, 1]))
            if m + 1 <= n - 1:
                term = term + back * v[n - 1, m + 1]
            if m <= n - 2:
                term = term - v[n - 2, m]
            v[n, m] = term
    return v


def _real(value: Complex, n: int, m: int) -> Float:
    if m == 0:
        return np.asarray(np.sqrt(n + 1.0) * value.real)
    return np.asarray(np.sqrt(2.0 * (n + 1.0)) * (value.real if m > 0 else value.imag))


def _index(value: int, least: int, name: str) -> int:
    if int(value) != value or value < least:
        raise ValueError(f"{name} must be a whole number of at least {least}, not {value!r}.")
    return int(value)


def _orders(n: int, m: int) -> None:
    if n < 0 or abs(m) > n or (n - abs(m)) % 2:
        raise ValueError(f"A mode needs n ≥ |m| and n − |m| even, not n = {n!r}, m = {m!r}.")
