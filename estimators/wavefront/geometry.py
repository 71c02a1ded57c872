"""The geometry that a wavefront rig declares: lenslets on the camera and in the pupil, and the shape of a spot."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline
from scipy.spatial import cKDTree

from ...optics.lenslets.gradients import hexagon, square
from ...scenes.errors import InputError
from ..declared import check_keys
from ..rig import DeclaredRig
from .declared import WAVEFRONT_KEYS

__all__ = ["Geometry", "Spot", "declared_geometry", "declared_spot"]

Float = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]

#: Share by which the declared places of spots, centres of lenslets, pitch and size of a pixel may disagree. A reference of radius R
#: sets spots wider than lenslets by f/R.
_OFF_SCALE = 0.05
#: Distance [pitch] of lenslets that may be those after the next: √2 in a square, √3 among hexagons.
_NEXT = 1.35
#: Nodes per pixel of the tables of a spot: linear interpolation errs by P''/8·_FINE² = 1e-7 of its height.
_FINE = 1024


@dataclass(frozen=True, eq=False)
class Geometry:
    """Lenslets as declared.

    place_px (lenslet, axis): column and row of the spot of a flat wavefront. site (lenslet, 2): row and column in the array.
    centre_m (lenslet, axis): x, y along the array's axes, from the pupil's centre. hexagonal: whether lenslets are hexagons with
    two edges parallel to y, else squares. rad_per_px: slope that moves a spot by 1 px.
    """

    place_px: Float
    site: npt.NDArray[np.int64]
    centre_m: Float
    pitch_m: float
    pitch_px: float
    hexagonal: bool
    rotation_rad: float
    rad_per_px: float
    wavelength_m: float
    shape: str
    diameter_m: float
    samples: int
    step_m: float
    modes: int

    @property
    def wavenumber(self) -> float:
        """k = 2π/λ [1/m]: phase over optical path."""
        return 2.0 * np.pi / self.wavelength_m

    @property
    def corners_m(self) -> Float:
        """Corners (corners, 2) [m] of a lenslet about its centre, along the array's axes."""
        return hexagon(self.pitch_m) if self.hexagonal else square(self.pitch_m)

    def steps(self) -> Float:
        """Places (lenslet, axis) in pitches along the array's axes, from a point of the array."""
        return self.centre_m / self.pitch_m if self.hexagonal else self.site[:, ::-1].astype(np.float64)

    def within(self, position: Float) -> Bool:
        """Whether positions (…, axis) [px] from their places lie in the lenslet's cell: nearer to it than to any other's place.

        That of squares is parallel to the pixels; that of hexagons turns with the array.
        """
        half = 0.5 * self.pitch_px
        with np.errstate(invalid="ignore"):
            if not self.hexagonal:
                return np.asarray((np.abs(position) <= half).all(axis=-1))
            angle = self.rotation_rad + np.pi / 3.0 * np.arange(3)
            return np.asarray((np.abs(position @ np.stack([np.cos(angle), np.sin(angle)])) <= half).all(axis=-1))

    def own_axes(self, slope: Float) -> Float:
        """Slopes (…, axis) along the camera's axes as those along the array's."""
        c, s = np.cos(self.rotation_rad), np.sin(self.rotation_rad)
        return np.asarray(slope @ np.array([[c, -s], [s, c]]))


@lru_cache(maxsize=8)
def declared_geometry(rig: DeclaredRig) -> Geometry:
    """The geometry of a declared rig. Raises InputError for a missing or unusable value, lists of different lengths, and places,
    centres and pitch that disagree."""
    check_keys(rig, WAVEFRONT_KEYS)
    names = ("col_px", "row_px", "row", "col", "x_m", "y_m")
    lists = {name: rig.numbers(f"lenslets.{name}") for name in names}
    if len({values.size for values in lists.values()}) != 1:
        raise InputError(
            "The declared lists of lenslets have different lengths.", where="attribute rig: lenslets",
            value={name: values.size for name, values in lists.items()}, allowed="one value per used lenslet in each",
        )  # fmt: skip
    pitch, focal = rig.number("lenslets.pitch_m"), rig.number("lenslets.focal_length_m")
    pixel = rig.number("camera.pixel_pitch_m")
    made = Geometry(
        place_px=np.stack([lists["col_px"], lists["row_px"]], axis=1),
        site=np.stack([lists["row"], lists["col"]], axis=1).astype(np.int64),
        centre_m=np.stack([lists["x_m"], lists["y_m"]], axis=1),
        pitch_m=pitch,
        pitch_px=pitch / pixel,
        hexagonal=rig.get("lenslets.grid") is not None
        and rig.word("lenslets.grid", "square", "hexagonal") == "hexagonal",
        rotation_rad=rig.number("lenslets.rotation_rad"),
        rad_per_px=pixel / focal,
        wavelength_m=rig.number("laser.wavelength_m"),
        shape=rig.word("pupil.shape", "disc", "square"),
        diameter_m=rig.number("pupil.diameter_m"),
        samples=rig.whole("pupil.samples"),
        step_m=rig.number("pupil.step_m"),
        modes=rig.whole("pupil.modes", least=2),
    )
    _check_scale(made, pixel)
    return made


def _check_scale(geometry: Geometry, pixel_m: float) -> None:
    """Raise InputError where places, centres and pitch of the declared lenslets are not of one lattice: slopes, or the modes that
    are fitted to them, would be wrong by as much."""
    centre = _width(geometry.centre_m)
    if not centre > 0.0:
        return
    distance = np.asarray(cKDTree(geometry.centre_m).query(geometry.centre_m, 2)[0])
    apart = float(np.median(distance[:, 1])) / geometry.pitch_m
    wider = {"lenslets.col_px, lenslets.row_px, camera.pixel_pitch_m": _width(geometry.place_px) * pixel_m / centre}
    if apart < _NEXT:  # else most lenslets have no neighbour left
        wider["lenslets.pitch_m"] = 1.0 / max(apart, 1e-9)
    for names, ratio in wider.items():
        if not abs(ratio - 1.0) <= _OFF_SCALE:
            raise InputError(
                "The declared lenslets are of two lattices.", where=f"attribute rig: {names}",
                value=f"{ratio:.3g} times that of lenslets.x_m, lenslets.y_m", allowed=f"1 ± {_OFF_SCALE:g}",
                next_step="check pitch, size of a pixel and places of the declared rig",
            )  # fmt: skip


def _width(places: npt.ArrayLike) -> float:
    """Root of the sum of squares of the distances of places (lenslet, axis) from their middle."""
    value = np.asarray(places, np.float64)
    # Of places beyond any array the square is infinite, and the ratio none.
    with np.errstate(over="ignore", invalid="ignore"):
        return float(np.sqrt(((value - value.mean(axis=0)) ** 2).sum()))


class Spot:
    """The declared spot along one axis: its share in a pixel whose centre lies u px beside the spot, and derivatives by u.

    Shares of all pixels sum to the share of the light that the samples hold, which is 1 but for the tails beyond them.
    """

    def __init__(self, start_px: float, step_px: float, value: Float) -> None:
        u = start_px + step_px * np.arange(value.size)
        whole = CubicSpline(u, value / (value.sum() * step_px), extrapolate=False).antiderivative()
        fine = np.arange(u[0] + 0.5, u[-1] - 0.5 + 0.5 * step_px, step_px)
        edge = np.clip(np.stack([fine + 0.5, fine - 0.5]), u[0], u[-1])
        share = CubicSpline(fine, np.asarray(whole(edge[0]) - whole(edge[1])), extrapolate=False)
        grid = np.arange(fine[0], fine[-1], 1.0 / _FINE)
        #: u [px] of the tables' first node, and nodes per pixel.
        self.start_px, self.per_px = float(grid[0]), _FINE
        self._table = [
            np.append(np.nan_to_num(one(grid)), 0.0) for one in (share, share.derivative(1), share.derivative(2))
        ]
        #: rms width [px] of the core: that of the Gaussian of equal peak.
        self.sigma_px = float(1.0 / (np.sqrt(2.0 * np.pi) * max(float(value.max() / (value.sum() * step_px)), 1e-300)))

    @property
    def tables(self) -> tuple[Float, Float]:
        """P(u) and dP/du at the nodes."""
        return self._table[0], self._table[1]

    def _looked_up(self, u: Float, which: int) -> Float:
        """Linear between nodes 1/_FINE px apart, and 0 beyond the samples."""
        table = self._table[which]
        at = (u - self.start_px) * self.per_px
        last = table.size - 2
        node = np.clip(at, 0.0, last).astype(np.intp)
        value = table[node] + (at - node) * (table[node + 1] - table[node])
        return np.asarray(np.where((at >= 0.0) & (at <= last), value, 0.0))

    def share(self, u: Float) -> Float:
        """P(u), dimensionless; 0 beyond the samples."""
        return self._looked_up(u, 0)

    def slope(self, u: Float) -> Float:
        """dP/du [1/px]."""
        return self._looked_up(u, 1)

    def bend(self, u: Float) -> Float:
        """d²P/du² [1/px²]."""
        return self._looked_up(u, 2)


@lru_cache(maxsize=8)
def declared_spot(rig: DeclaredRig) -> Spot:
    """The spot of a declared rig. Raises InputError for samples that are no spot."""
    check_keys(rig, WAVEFRONT_KEYS)
    value = rig.numbers("spot.value")
    if value.size < 8 or not value.sum() > 0 or value.size * rig.number("spot.step_px") < 3.0:
        raise InputError(
            "The declared spot cannot be used.", where="attribute rig: spot.value", value=value.size,
            allowed="8 samples or more of positive sum, over 3 px or more",
        )  # fmt: skip
    return Spot(rig.number("spot.start_px"), rig.number("spot.step_px"), value)
