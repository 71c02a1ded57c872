"""Real spot fields of a telescope's Shack-Hartmann sensors: slopes and Zernike coefficients beside those of the sensors' authors.

    python -m beambench.benchmarks.checks.sh_mmtwfs FOLDER

FOLDER holds images, references and mmtwfs_2.1.0_results.json of the package mmtwfs (MMT Observatory, BSD-3-Clause, commit
bff975a): four images on the sky with their references, square and hexagonal lenslets, and one image that its authors refuse.
Reading FITS needs astropy (extra `imports`).

Lenslets lie where the reference shows spots. In the image the spots lie up to a pitch and a half elsewhere (defocus, and the
pupil's place on the array), so that they are looked for in the whole frame (`search=field`). Slopes are compared where both found
a spot, the mean of each taken off: it says where the array lies. Coefficients are Noll's by number, in nm of amplitude (not of
rms), of a least-squares fit of the gradients at the lenslets' centres, as the authors define them: turned by their angle less the
image's ROT, less the aberrations of their reference (mmtwfs/config.py), tip and tilt left out. What the authors take off for stars
beside the axis of the first and last sensor is not. Authors' releases differ among themselves by 80 nm in Z10 of the first image.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr
from scipy.spatial import cKDTree

from ...captures.hide import hide_truth
from ...captures.imports.files import read_recording
from ...captures.imports.mapping import load_mapping
from ...estimators.registry import run_estimator
from ...optics.zernike import orders_of, zernike_gradient
from ...scenes.errors import InputError
from ..datasets.imported import imported_captures

__all__ = ["PAIRS", "Compared", "Sensor", "capture_of", "compared", "main", "zernikes_nm"]

Float = npt.NDArray[np.float64]

#: Sensor -> image, reference, and columns and rows that the authors cut from the image.
PAIRS = {
    "mmirs": ("mmirs_wfs_0150.fits", "mmirs_camera2_ref.fits", (12, 5)),
    "f9": ("TREX_p500_0000.fits", "f9_ref.fits", (0, 0)),
    "newf9": ("test_newf9.fits", "f9_new_ref.fits", (0, 0)),
    "f5": ("auto_wfs_0037_ave.fits", "f5_hecto_ref.fits", (0, 0)),
}
#: Aberrations of the references [nm] by Noll's number, as the authors' package states them.
REFERENCE_NM = {"mmirs": {4: 1059.0}, "f9": {4: 7982.0}, "newf9": {4: 8282.0}, "f5": {4: -2810.0, 11: -150.0}}
BOGUS = "mmirs_bogus.fits"
#: Radius of the telescope's mirror [m].
_RADIUS_M = 3.251
RESULTS = "mmtwfs_2.1.0_results.json"
CENTROIDS = ("spot-gaussian", "spot-weighted", "spot-threshold", "spot-centroid")
#: Share of lenslets with a spot below which an image is refused.
_HALF = 0.5


@dataclass(frozen=True)
class Sensor:
    """What the authors state of a sensor: pitch, focal length and pixel [m], angle of a pixel on the sky [rad], diameter [px] and
    centre [px] of the pupil, wavelength [m]."""

    pitch_m: float
    focal_m: float
    pixel_m: float
    pixel_rad: float
    pupil_px: float
    inner_px: float
    centre_px: tuple[float, float]
    wavelength_m: float

    @staticmethod
    def of(stated: dict[str, Any]) -> Sensor:
        """From an entry of the authors' results."""

        def number(name: str) -> float:
            return float(str(stated[f"geom_{name}"]).split()[0])

        return Sensor(
            number("lenslet_pitch") * 1e-6, number("lenslet_fl") * 1e-3, number("pix_um") * 1e-6,
            np.deg2rad(number("pix_size") / 3600.0), number("pup_size"), number("pup_inner"),
            (float(stated["xcen"]), float(stated["ycen"])), number("eff_wave") * 1e-9,
        )  # fmt: skip


def capture_of(folder: Path, name: str, image: str = "") -> xr.Dataset:
    """The capture of a sensor, by the mapping `sh_mmtwfs-<name>`; `image`: another frame than the mapping's.

    Raises InputError for files that cannot be read, a reference without spots, and a frame with too few.
    """
    mapping = load_mapping(f"sh_mmtwfs-{name}")
    if image:
        counts = mapping.data["counts"].model_copy(update={"files": (image,)})
        mapping = mapping.model_copy(update={"data": {**mapping.data, "counts": counts}})
    return next(imported_captures(mapping, [folder], name))


@dataclass(frozen=True)
class Compared:
    """One sensor by one centroid: lenslets with a spot, of how many; spots that both found; rms [px] of the differences of slopes
    and of the authors' slopes; rms [nm] of the differences of Z04 … Z22."""

    sensor: str
    centroid: str
    found: int
    lenslets: int
    both: int
    slope_rms_px: float
    slopes_px: float
    zernike_rms_nm: float


def compared(folder: Path, name: str, centroid: str, *, image: str = "") -> Compared:
    """One sensor's image by one centroid. `image`: another one than that of `PAIRS`.

    Raises InputError where fewer than half of the pupil's lenslets show a spot.
    """
    stated = json.loads((folder / RESULTS).read_text(encoding="utf-8"))[name]
    sensor = Sensor.of(stated)
    own, _, cut = PAIRS[name]
    capture = capture_of(folder, name, image)
    rot = float(read_recording(folder / (image or own)).header.get("ROT", 0.0))
    found = run_estimator(f"{centroid}[search=field]", hide_truth(capture))
    valid = found["valid"].values[0]
    _refuse_few(int(valid.sum()), sensor)
    lenslets = json.loads(capture.attrs["rig"])["lenslets"]
    place = np.stack([np.asarray(lenslets[key]) for key in ("col_px", "row_px")], axis=1)
    spot, moved = found["spot"].values[0][valid], (found["spot"].values[0] - place)[valid]
    theirs = np.array([stated["slopes_x"], stated["slopes_y"]], dtype=np.float64).T
    theirs = theirs[np.isfinite(theirs).all(axis=1)]
    radius, centre = 0.5 * sensor.pupil_px, np.array(sensor.centre_px) + cut
    lenslet = np.array([stated["pup_x"], stated["pup_y"]]).T * radius + centre
    near: Any = cKDTree(spot).query(lenslet + theirs)
    distance, mine = near
    both = distance < 0.1 * sensor.pitch_m / sensor.pixel_m
    ours, authors = moved[mine[both]], theirs[both]
    apart = (ours - ours.mean(axis=0)) - (authors - authors.mean(axis=0))
    # A lenslet lies where its light enters the pupil, which the authors' centre of the frame says.
    nm = zernikes_nm((place[valid] + moved.mean(axis=0) - centre) / radius, moved - moved.mean(axis=0), sensor)
    nm = _turned(nm, np.deg2rad(float(str(stated["geom_rotation"]).split()[0]) - rot))
    for number, value in REFERENCE_NM[name].items():
        nm[number - 2] -= value
    misses = nm - np.array([stated["zernike_nm"][f"Z{k:02d}"] for k in range(2, 23)])
    return Compared(
        name, centroid, int(valid.sum()), len(place), int(both.sum()), float(np.sqrt((apart**2).mean())),
        float(np.sqrt(((authors - authors.mean(axis=0)) ** 2).mean())), float(np.sqrt((misses[2:] ** 2).mean())),
    )  # fmt: skip


def _refuse_few(found: int, sensor: Sensor) -> None:
    pitch = sensor.pitch_m / sensor.pixel_m
    pupil = np.pi / 4 * (sensor.pupil_px / pitch) ** 2 - np.pi * (sensor.inner_px / pitch) ** 2
    if found < _HALF * pupil:
        raise InputError(
            "The frame shows too few spots for a wavefront.", where="counts", value=found,
            allowed=f"half of the {pupil:.0f} lenslets of the pupil", next_step="focus the sensor, and record again",
        )  # fmt: skip


def zernikes_nm(at: Float, moved_px: Float, sensor: Sensor, last: int = 22) -> Float:
    """Amplitudes [nm] of Noll's Z02 … Z`last`, without their rms norm, from displacements (n, axis) [px] at pupil places (n, 2).

    A displacement of Δ px turns the light by Δ·(angle of a pixel), which is −∂W/∂X over the mirror's radius.
    """
    gradient = -moved_px * sensor.pixel_rad * _RADIUS_M * 1e9
    columns = []
    for k in range(2, last + 1):
        n, m = orders_of(k)
        norm = np.sqrt(n + 1.0) if m == 0 else np.sqrt(2.0 * (n + 1.0))
        gx, gy = zernike_gradient(k, at[:, 0], at[:, 1])[0]
        columns.append(np.concatenate([gx, gy]) / norm)
    return np.asarray(np.linalg.lstsq(np.stack(columns, axis=1), gradient.T.ravel(), rcond=None)[0])


def _turned(nm: Float, angle: float) -> Float:
    """Coefficients (Z02 …) of the wavefront turned by an angle: those of cosine and sine of one order mix."""
    orders = {orders_of(k): k - 2 for k in range(2, nm.size + 2)}
    out = nm.copy()
    for (n, m), k in orders.items():
        if m and (n, -m) in orders:
            out[k] = np.cos(m * angle) * nm[k] + np.sin(m * angle) * nm[orders[n, -m]]
    return out


def main(argv: Sequence[str] | None = None) -> int:
    """Command line: a line for each sensor and centroid; 0 where all could be read and the unusable frame is refused."""
    arguments = sys.argv[1:] if argv is None else list(argv)
    if len(arguments) != 1:
        print(__doc__)
        return 2
    folder = Path(arguments[0])
    print(
        f"{'sensor':8s} {'centroid':16s} {'found':>6s} {'both':>5s} {'slopes, px':>11s} {'difference':>11s} {'Zernikes, nm':>13s}"
    )
    for name in PAIRS:
        for centroid in CENTROIDS:
            one = compared(folder, name, centroid)
            print(
                f"{name:8s} {centroid:16s} {one.found:6d} {one.both:5d} {one.slopes_px:11.2f} {one.slope_rms_px:11.3f} "
                f"{one.zernike_rms_nm:13.1f}"
            )
    try:
        compared(folder, "mmirs", CENTROIDS[0], image=BOGUS)
    except InputError as error:
        print(f"{BOGUS}: refused. {error}")
        return 0
    print(f"{BOGUS}: not refused")
    return 1


if __name__ == "__main__":
    sys.exit(main())
