"""Triangulation: the point where the ray of a line's centre meets the laser's plane.

    X = O + d (n·(P − O))/(n·d),    σ_X² = (∂X/∂c)² σ_c² + (∂X/∂p) C (∂X/∂p)ᵀ,

O and d the ray's origin and direction in the medium, P a point of the sheet and n its normal; C the covariance of the calibrated
parameters p where the rig declares one (`calibration`). What a calibration errs by is common to all points of a capture.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import xarray as xr

from ..registry import estimator
from ..result import stage_result
from ..rig import DeclaredRig
from .deviations import STEPS, deviated
from .geometry import Geometry, declared_covariance, declared_geometry
from .ray_kernel import meet_sheet, takes

__all__ = ["triangulate_air", "triangulate_pinhole_port", "triangulate_refractive"]

Float = npt.NDArray[np.float64]

#: Half the step [px] of the derivative by the column.
_STEP = 1e-3
#: Least standard error [m]: a coordinate that the column does not move is still known no better than numbers are.
_LEAST_M = 1e-12


@estimator("triangulation", cites="exact refraction at a flat port: A. Agrawal et al., CVPR 2012, p. 3346")
def triangulate_refractive(lines: xr.Dataset, rig: DeclaredRig) -> xr.Dataset:
    """Exact refraction through air, glass and water, with the port's stand-off. Returns point (frame, row, return, xyz), sigma
    [m], valid. Invalid where the line is, or where the ray meets the plane behind port or laser."""
    return _points(lines, declared_geometry(rig), rig)


@estimator("triangulation", cites="Kusters 1992, Eq. 3.20-3.32: a single interface at the pinhole")
def triangulate_pinhole_port(lines: xr.Dataset, rig: DeclaredRig) -> xr.Dataset:
    """Refraction at a port of no thickness at the entrance pupil: exact for no stand-off. As `triangulate_refractive`."""
    return _points(lines, declared_geometry(rig, port="pinhole"), rig, without=("stand_off_m",))


@estimator("triangulation", cites="the pinhole model in air, which leaves refraction out")
def triangulate_air(lines: xr.Dataset, rig: DeclaredRig) -> xr.Dataset:
    """Straight rays from the entrance pupil, as in air. As `triangulate_refractive`."""
    return _points(lines, declared_geometry(rig, port="none"), rig, without=("stand_off_m",))


def _points(lines: xr.Dataset, geometry: Geometry, rig: DeclaredRig, *, without: tuple[str, ...] = ()) -> xr.Dataset:
    column, spread = (np.asarray(lines.variables[name].values, np.float64) for name in ("column", "sigma"))
    valid = np.asarray(lines.variables["valid"].values, bool)
    row = np.broadcast_to(np.arange(column.shape[1], dtype=np.float64)[:, None], column.shape)
    held = np.where(valid, column, geometry.camera.col0)
    if takes(geometry.camera):
        flat, per_px = meet_sheet(geometry.camera, geometry.sheet, np.ascontiguousarray(row).ravel(), held.ravel())
        point, slope = flat.reshape(*held.shape, 3), per_px.reshape(*held.shape, 3)
    else:
        ends = [np.moveaxis(geometry.points(row, held + step), 0, -1) for step in (0.0, -_STEP, _STEP)]
        point, slope = ends[0], np.abs(ends[2] - ends[1]) / (2.0 * _STEP)
    variance = (slope * spread[..., None]) ** 2 + _LEAST_M**2
    if rig.get("calibration") is not None:
        variance = variance + np.moveaxis(_uncalibrated(geometry, rig, without, row, held), 0, -1)
    return stage_result("triangulation", point=point, sigma=np.sqrt(variance), valid=valid)


def _uncalibrated(geometry: Geometry, rig: DeclaredRig, without: tuple[str, ...], row: Float, col: Float) -> Float:
    """Variance (3, …) [m²] of points by what the rig's calibration leaves open."""
    names, covariance = declared_covariance(rig)
    own = [k for k, name in enumerate(names) if name not in without]
    slopes = []
    for k in own:
        step = STEPS[names[k]]
        ahead, behind = (deviated(geometry, {names[k]: sign * step}).points(row, col) for sign in (1.0, -1.0))
        slopes.append((ahead - behind) / (2.0 * step))
    if not own:
        return np.zeros((3, *col.shape))
    slope = np.stack(slopes)
    variance = np.einsum("kc...,kl,lc...->c...", slope, covariance[np.ix_(own, own)], slope)
    return np.asarray(np.maximum(variance, 0.0))
