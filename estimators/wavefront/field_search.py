"""Spots that left their cells: which spot of a frame is whose, from all spots of the frame at once.

Spots are the maxima of the smoothed frame. From one lenslet and a spot near it the assignment grows outward: the displacement
of the next lenslet is predicted by a plane through those around it (`_REACH` pitches), and the spot nearest to the prediction
is taken if it lies within `_NEAR` of the pitch. Several first spots are tried; the assignment of the most lenslets counts, of
equal ones that of the least common displacement, since a lattice without an edge looks the same after a step of one pitch.

Source: the growth is that of J. Pfund, N. Lindlein, J. Schwider, Optics Letters 23:995, 1998 (unwrapping of displacements), with
predictions from several neighbours.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter, maximum_filter
from scipy.spatial import cKDTree

__all__ = ["assigned_spots", "spots_in"]

Float = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]

#: Radius [pitches] of the lenslets that predict the next one, of those that are tried next, and of first spots.
_REACH, _STEP, _FIRST = 2.6, 1.6, 2.2
#: Farthest [pitches] a spot may lie from its prediction, and two spots from each other.
_NEAR, _APART = 0.4, 0.45
#: Least height of a spot over that of the frame's typical one; most first spots that are tried.
_LEAST, _MOST_FIRST = 0.12, 24
#: Share of the lenslets, or of the spots where these are fewer, at which no other first spot is tried.
_ENOUGH = 0.97


def spots_in(light: Float, pitch_px: float, sigma_px: float, least_sigmas: float) -> Float:
    """Places (spot, axis) [px], columns and rows, of the spots in a frame of photoelectrons (rows, cols), to the pixel.

    Main arguments:
        sigma_px: width of a spot, by which the frame is smoothed. least_sigmas: height over the frame's median, in standard
            deviations of the smoothed frame about it, by its median absolute deviation.
    """
    known = np.isfinite(light)
    if not known.any():
        return np.zeros((0, 2))
    smooth = gaussian_filter(np.where(known, light, np.median(light[known])), max(sigma_px, 0.6))
    middle = float(np.median(smooth))
    noise = 1.4826 * float(np.median(np.abs(smooth - middle)))
    size = 2 * max(int(_APART * pitch_px), 1) + 1
    top = (maximum_filter(smooth, size) == smooth) & (smooth - middle > least_sigmas * max(noise, 1e-12))
    row, col = np.nonzero(top)
    if not row.size:
        return np.zeros((0, 2))
    height = smooth[row, col] - middle
    tall = height > _LEAST * float(np.percentile(height, 75))
    return np.stack([col[tall], row[tall]], axis=1).astype(np.float64)


def assigned_spots(places: Float, spots: Float, pitch_px: float) -> Index:
    """Number of the spot (lenslet) that belongs to each lenslet, −1 where none does.

    Main arguments:
        places (lenslet, axis), spots (spot, axis) [px].
    """
    none = np.full(len(places), -1, np.int64)
    if not len(spots) or not len(places):
        return none
    tree, lattice = cKDTree(spots), cKDTree(places)
    near: Any = lattice.query_ball_point(places, _STEP * pitch_px)
    around: Any = lattice.query_ball_point(places, _REACH * pitch_px)
    best, best_key = none, (-1, 0.0)
    for lenslet, spot in _first(places, spots, pitch_px, tree):
        owner = _grown(places, spots, pitch_px, tree, (near, around), lenslet, spot)
        held = owner >= 0
        away = float(np.linalg.norm((spots[owner[held]] - places[held]).mean(axis=0))) / pitch_px
        # Of two assignments whose numbers differ by less than a fiftieth, the nearer one.
        key = (round(50.0 * float(held.sum()) / len(places)), -away)
        if key > best_key:
            best, best_key = owner, key
        if held.sum() >= _ENOUGH * min(len(places), len(spots)) and away < 0.5:
            break
    return best


def _first(places: Float, spots: Float, pitch_px: float, tree: cKDTree) -> list[tuple[int, int]]:
    """(lenslet, spot) to begin with, nearest first: of the lenslet with most spots around it."""
    around: Any = tree.query_ball_point(places, _FIRST * pitch_px)
    crowd = [len(found) for found in around]
    lenslet = int(np.argmax(np.array(crowd) - 1e-3 * np.linalg.norm(places - places.mean(axis=0), axis=1) / pitch_px))
    found = sorted(around[lenslet], key=lambda spot: float(np.linalg.norm(spots[spot] - places[lenslet])))
    return [(lenslet, int(spot)) for spot in found[:_MOST_FIRST]]


def _grown(
    places: Float, spots: Float, pitch_px: float, tree: cKDTree, lists: tuple[list[list[int]], list[list[int]]], lenslet: int,
    spot: int,
) -> Index:  # fmt: skip
    near, around = lists
    owner = np.full(len(places), -1, np.int64)
    owner[lenslet] = spot
    taken = {spot}
    while True:
        left = np.flatnonzero(owner < 0).tolist()
        rim = [k for k in left if any(owner[n] >= 0 for n in near[k])]
        if not rim:  # over a gap: the lenslets with the most neighbours within reach
            rim = [k for k in left if sum(owner[n] >= 0 for n in around[k]) >= 3]
        claims: dict[int, tuple[float, int]] = {}
        for k in rim:
            wanted = places[k] + _predicted(places, spots, owner, [n for n in around[k] if owner[n] >= 0], k)
            distance, found = tree.query(wanted, distance_upper_bound=_NEAR * pitch_px)
            if np.isfinite(distance) and int(found) not in taken:
                claims[int(found)] = min(claims.get(int(found), (np.inf, -1)), (float(distance), int(k)))
        if not claims:
            return owner
        for number, (_, k) in claims.items():
            owner[k] = number
            taken.add(number)


def _predicted(places: Float, spots: Float, owner: Index, known: list[int], k: int) -> Float:
    """Displacement (axis) [px] of lenslet k: a plane through those of the known ones about it, held flat where they are few."""
    away = spots[owner[known]] - places[known]
    if len(known) < 4:
        return np.asarray(away.mean(axis=0))
    step = places[known] - places[k]
    scale = max(float(np.abs(step).max()), 1e-9)
    basis = np.column_stack([np.ones(len(known)), step / scale])
    normal = basis.T @ basis + np.diag([0.0, 0.1, 0.1])
    return np.asarray(np.linalg.solve(normal, basis.T @ away)[0])
