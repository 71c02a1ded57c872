"""Finders of laser lines from other packages, as functions frame (row, col) -> column [px] of every row, NaN where there is none.

- OpenCV (package opencv-python-headless), compiled: `GaussianBlur`, five `Sobel` derivatives, and the eigen-analysis of the
  Hessian at the pixels whose ridge is strong enough, as Steger 1998; of several in a row the strongest.
- `ridge-detection`: the Python translation of the plug-in Ridge Detection of ImageJ, which is Steger 1998 too.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["PEERS", "by_opencv", "by_ridge_detection"]

Float = npt.NDArray[np.float64]
#: frame (row, col) [DN], scale of the smoothing [px] -> column [px] (row).
Finder = Callable[[npt.NDArray[Any], float], Float]

#: Sobel's 3 × 3 kernels sum their smoothing to this; a derivative is the filter's answer over it.
_SOBEL = {(1, 0): 8.0, (0, 1): 8.0, (2, 0): 4.0, (1, 1): 4.0, (0, 2): 4.0}
#: Ridges below this share of the strongest one of the frame are noise.
_SHARE = 0.2


def by_opencv(frame: npt.NDArray[Any], scale_px: float) -> Float:
    """Steger's points by OpenCV's filters; needs the package opencv-python-headless."""
    import cv2

    smooth = cv2.GaussianBlur(frame.astype(np.float32), (0, 0), scale_px)
    x, y, xx, xy, yy = (cv2.Sobel(smooth, cv2.CV_32F, *order, ksize=3, scale=1 / _SOBEL[order]) for order in _SOBEL)
    row, col = np.nonzero(xx < _SHARE * xx.min())
    gx, gy, a, b, c = (part[row, col].astype(np.float64) for part in (x, y, xx, xy, yy))
    # The eigenvector of the most negative eigenvalue.
    angle = 0.5 * np.arctan2(2 * b, a - c) + 0.5 * np.pi
    nx, ny = np.cos(angle), np.sin(angle)
    bend = a * nx * nx + 2 * b * nx * ny + c * ny * ny
    with np.errstate(divide="ignore", invalid="ignore"):
        t = -(gx * nx + gy * ny) / bend
        place = t / nx
    good = (bend < 0) & (np.abs(t * nx) <= 0.5) & (np.abs(t * ny) <= 0.5)
    row, found, bend = row[good], (col + place)[good], bend[good]
    out = np.full(frame.shape[0], np.nan)
    order = np.argsort(-bend)  # the strongest ridge of a row is written last
    out[row[order]] = found[order]
    return out


def by_ridge_detection(frame: npt.NDArray[Any], scale_px: float) -> Float:
    """The lines of `ridge-detection`, interpolated at the middles of the rows; needs that package.

    The package reads 8 bits: the frame is scaled to 255 at its brightest pixel. Its last two steps round the points to whole pixels
    and thin them; they are left out here, so that its sub-pixel positions are compared.
    """
    from PIL import Image
    from ridge_detection import lineDetector as package

    eight = np.clip(np.rint((frame - float(np.median(frame))) * (255.0 / np.ptp(frame))), 0, 255).astype(np.uint8)
    detector = package.LineDetector(params=_parameters(scale_px))
    with contextlib.redirect_stdout(io.StringIO()), _without_rounding(package):
        lines = detector.detectLines(Image.fromarray(eight))  # it takes the axes of an array for each other
    out = np.full(frame.shape[0], np.nan)
    for line in sorted(lines, key=lambda one: len(one.row)):
        down, across = np.asarray(line.row, np.float64), np.asarray(line.col, np.float64)
        order = np.argsort(down)
        inside = np.arange(int(np.ceil(down.min())), int(np.floor(down.max())) + 1)
        inside = inside[(inside >= 0) & (inside < out.size)]
        out[inside] = np.interp(inside, down[order], across[order])
    return out


@contextlib.contextmanager
def _without_rounding(package: Any) -> Iterator[None]:
    held = {name: getattr(package, name) for name in ("smart_cast_row_and_col", "skeletonize_lines")}
    try:
        for name in held:
            setattr(package, name, lambda contour: None)
        yield
    finally:
        for name, step in held.items():
            setattr(package, name, step)


def _parameters(scale_px: float) -> dict[str, Any]:
    return {
        "path_to_file": "",
        "mandatory_parameters": {
            "Sigma": scale_px, "Lower_Threshold": 2.0, "Upper_Threshold": 8.0, "Maximum_Line_Length": 0,
            "Minimum_Line_Length": 0, "Darkline": "LIGHT", "Overlap_resolution": "NONE",
        },
        "optional_parameters": {"Line_width": 3.5 * scale_px, "High_contrast": 230, "Low_contrast": 87},
        "further_options": {
            "Correct_position": False, "Estimate_width": False, "doExtendLine": False, "Show_junction_points": False,
            "Show_IDs": False, "Display_results": False, "Preview": False, "Make_Binary": False, "save_on_disk": False,
        },
    }  # fmt: skip


#: name: (module that must be installed, package, the finder)
PEERS: dict[str, tuple[str, str, Finder]] = {
    "opencv-steger": ("cv2", "opencv-python-headless", by_opencv),
    "ridge-detection": ("ridge_detection", "ridge-detection", by_ridge_detection),
}
