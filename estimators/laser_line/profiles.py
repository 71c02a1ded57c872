"""Profiles of a surface from triangulated points: which of them are kept, and how they are resampled.

Source: Kusters 1992, sec. 5.5.1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import xarray as xr

from ..rig import DeclaredRig
from .geometry import declared_geometry

__all__ = ["Profile", "Resampled", "levelled", "profiles_of", "resampled", "selected", "shortened"]

Float = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Profile:
    """One frame's line: places `along` it in ascending order, `height` and its standard error `sigma`, each (n) [m]."""

    along: Float
    height: Float
    sigma: Float

    @property
    def length_m(self) -> float:
        """From the first point to the last."""
        return float(self.along[-1] - self.along[0])

    @property
    def interval_m(self) -> float:
        """The average interval, as the document has it: length over the number of points."""
        return self.length_m / self.along.size


@dataclass(frozen=True, eq=False)
class Resampled:
    """Profiles at equal intervals: `height` (profile, count) [m], `interval_m`, and `noise_m2`, the mean stated variance."""

    height: Float
    interval_m: float
    noise_m2: float


def profiles_of(points: xr.Dataset, rig: DeclaredRig) -> list[Profile]:
    """The first returns of every frame in the plane of the sheet: height against the sheet's axis, toward the laser, and place
    square to it. Frames with less than two points give none; of points at one place the first is kept."""
    sheet = declared_geometry(rig).sheet
    point, spread = (np.asarray(points[name].values, np.float64)[:, :, 0] for name in ("point", "sigma"))
    valid = np.asarray(points["valid"].values, bool)[:, :, 0]
    beside, axis = sheet.frame[:, 1], sheet.frame[:, 2]
    along, height = (point - sheet.source) @ beside, -(point - sheet.source) @ axis
    # The coordinates of a point err together, within the sheet: where its second axis is y, |dX·axis| = Σ |dX_i||axis_i|.
    sigma = spread @ np.abs(axis)
    made = []
    for s, h, e, good in zip(along, height, sigma, valid, strict=True):
        at, first = np.unique(s[good], return_index=True)
        if at.size > 1:
            made.append(Profile(at, h[good][first], e[good][first]))
    return made


def shortened(profile: Profile, most_gap: float) -> Profile | None:
    """The profile without large gaps at its ends; None where one lies within, or nothing is left.

    A gap is large above `most_gap` average intervals; one within the outer tenth of the points is at an end. After each cut the
    interval is computed anew, and the criterion applied again.
    """
    while profile.along.size > 1:
        gap = np.flatnonzero(np.diff(profile.along) > most_gap * profile.interval_m)
        if not gap.size:
            return profile
        n = profile.along.size
        edge = max(n // 10, 1)
        if gap[0] < edge:
            keep = slice(int(gap[0]) + 1, None)
        elif gap[-1] >= n - 1 - edge:
            keep = slice(None, int(gap[-1]) + 1)
        else:
            return None
        profile = Profile(profile.along[keep], profile.height[keep], profile.sigma[keep])
    return None


def selected(profiles: Sequence[Profile], least_points: int, most_gap: float) -> list[Profile]:
    """Profiles of `least_points` or more without a gap above `most_gap` average intervals, their ends shortened where that
    removes one; a profile that is then too short is omitted too."""
    enough = (profile for profile in profiles if profile.along.size >= least_points)
    cut = (shortened(profile, most_gap) for profile in enough)
    return [profile for profile in cut if profile is not None and profile.along.size >= least_points]


def resampled(profiles: Sequence[Profile], count: int) -> Resampled:
    """`count` heights of every profile from its first point on, by linear interpolation at the least average interval of all.

    Raises ValueError for no profile.
    """
    interval = min(profile.interval_m for profile in profiles)
    rows = []
    for profile in profiles:
        at = profile.along[0] + interval * np.arange(count)
        rows.append(np.interp(at, profile.along, profile.height))
    noise = float(np.mean([np.mean(profile.sigma**2) for profile in profiles]))
    return Resampled(np.array(rows), interval, noise)


def levelled(profile: Profile) -> Profile:
    """The profile turned so that its line of least squares lies level, centred: heights are then square to the mean surface."""
    at, height = profile.along - profile.along.mean(), profile.height - profile.height.mean()
    angle = np.arctan(float(at @ height) / float(at @ at))
    turned = np.cos(angle) * at + np.sin(angle) * height
    order = np.argsort(turned, kind="stable")
    up = np.cos(angle) * height - np.sin(angle) * at
    return Profile(turned[order], up[order], profile.sigma[order])
