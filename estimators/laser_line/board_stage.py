"""Calibration as a stage: from one capture of a checkerboard to camera, stand-off of the port and plane of the sheet."""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...scenes.errors import InputError
from ..registry import estimator
from ..result import stage_result
from ..rig import read_rig
from .board import Board
from .bundle import Adjusted, flat_port
from .calibrate import calibrate
from .declared import CAMERA
from .described import NEEDED, described, spread
from .geometry import Geometry, declared_geometry

__all__ = ["calibrate_board"]

Float = npt.NDArray[np.float64]

#: Fewest views of a calibration: two of a line tell its plane, a third tells an error.
_LEAST_VIEWS = 3
#: Nodes that are answered lie at the boards' depths, or nearer or farther by up to this factor: beyond, a calibration is a guess.
_BEYOND = 2.0
#: Least standard error of a number that a rig is described by: numbers hold no less.
_LEAST_SIGMA = 1e-12


@estimator(
    "calibration", joint=True,
    cites="Z. Zhang, IEEE TPAMI 22:1330, 2000 (boards); A. Agrawal et al., CVPR 2012, p. 3346 (flat port)",
)  # fmt: skip
def calibrate_board(
    capture: xr.Dataset, *, rows: int = 6, cols: int = 9, square_m: float = 0.02, beyond_x_m: float = 0.095,
    beyond_y_m: float = 0.035, port: Literal["declared", "pinhole", "none"] = "declared",
    hold: Literal["nothing", "camera"] = "nothing",
) -> xr.Dataset:  # fmt: skip
    """Bundle adjustment of the corners of a board and of the line on it, seen from several stations (`calibrate.calibrate`).

    `rows` × `cols` inner corners, `square_m` apart; the plane goes on evenly by `beyond_x_m`, `beyond_y_m` beyond them. First
    values are the declared ones. `port`: as declared, refracted exactly; its surfaces at the entrance pupil; or none, so that
    focal length and distortion take up what the port does. `hold`: "camera" leaves focal length, principal point and distortion
    as they are declared, from a calibration in air: in water alone a camera a little longer and a port a little nearer look
    alike. Their error is then not in what is stated here; `calibrate.calibrate` adjusts captures in air and in water together.

    Returns node (lattice, xyz) [m], focal_length [m], principal_point [px], stand_off [m], plane_angle [rad] and plane_offset
    [m] as of `described`, with their standard errors by the adjustment's covariance. What the views do not tell is invalid: the
    stand-off in air. All is invalid where the capture cannot be used (fewer than three whole boards, one pose, squares of
    another size than the rig's poses say); the attribute `refused` then says why. So are nodes nearer or farther by a factor of
    2 than the line was seen. Raises InputError for a board or a port that cannot be calibrated.
    """
    rig = read_rig(capture, str(capture.attrs["modality"]))
    board = Board(rows, cols, square_m, (beyond_x_m, beyond_y_m))
    start = declared_geometry(rig, port=port)
    flat_port(start.camera.port)
    pitch = rig.number("camera.pixel_pitch_m", above=0)
    try:
        found = calibrate(
            [capture], board, port=port, least_views=_LEAST_VIEWS, held=CAMERA if hold == "camera" else ()
        )
    except InputError as error:
        return _answered(start, pitch, None).assign_attrs(refused=str(error))
    return _answered(found.geometry, pitch, found).assign_attrs(
        views=len(found.poses), corner_rms_px=found.corner_rms_px, line_rms_px=found.line_rms_px
    )


def _answered(geometry: Geometry, pitch_m: float, found: Adjusted | None) -> xr.Dataset:
    """The result of the stage; without an adjustment all of it is invalid."""
    value = described(geometry, pitch_m)
    names = () if found is None else found.names
    sigma = spread(geometry, pitch_m, names, np.zeros((0, 0)) if found is None else found.covariance)
    made: dict[str, npt.NDArray[np.generic]] = {}
    for name, held in value.items():
        end = "" if name == "node" else f"_{name}"
        whole = held.shape[:1]
        made[name], made[f"sigma{end}"] = held, np.maximum(sigma[name], _LEAST_SIGMA)
        made[f"valid{end}"] = np.full(whole, all(one in names for one in NEEDED[name]))
    if found is not None and found.depths_m is not None:
        nearest, farthest = found.depths_m
        with np.errstate(invalid="ignore"):
            depth = value["node"][:, 2]
            near = (depth > nearest / _BEYOND) & (depth < _BEYOND * farthest)
        made["valid"] = np.asarray(made["valid"], bool) & near
    return stage_result("calibration", **made)
