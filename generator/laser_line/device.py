"""The sheet of light and the scene in drjit arrays, for the paths of the full rung. All in the frame of the scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...optics.water.phase_forms import PhaseFunction, phase_density
from ...scenes.scene import Scene
from ..paths.phase import PhaseCells, straight_share
from ..paths.world import path_geometry
from ..rays.backend import mitsuba, opaque
from ..water.phase import phase_of
from .setting import Pose, Setting

__all__ = ["DeviceSheet", "LineWorld", "Turns"]

#: Least angle [rad] that is told from straight on, and cells of ln ψ from there to π.
_FINEST, _CELLS = 1e-6, 1024
_LOG_STEP = float(np.log(np.pi / _FINEST)) / _CELLS
#: Turns below this many pixels are counted as none.
_STRAIGHT_PX = 0.05
#: A uniform number is kept this far from 0 and 1, where the inverse of the normal distribution ends.
_EDGE = 1e-6


@dataclass(frozen=True)
class DeviceSheet:
    """A `Sheet` in drjit arrays, placed by the pose of a frame. `profile`: as of `Sheet.fan_profile`."""

    source: Any
    normal: Any
    along: Any
    axis: Any
    waist: Any
    waist_at: Any
    divergence: Any
    half: Any
    scale: Any
    whole: Any
    profile: str

    @staticmethod
    def of(setting: Setting, pose: Pose) -> DeviceSheet:
        """The sheet of a setting where the rig stands at `pose`."""
        mi, sheet = mitsuba(), setting.sheet
        frame = pose.turn @ sheet.frame
        source = pose.of_point(sheet.source[:, None])[:, 0]
        half = sheet.fan_half_angle_rad
        from scipy.special import erf

        whole = float(erf(np.sqrt(2.0) * 0.5 * np.pi / half))
        peak = float(sheet.fan_density(0.0))
        normal, along, axis = (mi.Vector3f(*(opaque(float(v)) for v in frame[:, k])) for k in range(3))
        return DeviceSheet(
            source=mi.Point3f(*(opaque(float(v)) for v in source)), normal=normal, along=along, axis=axis,
            waist=opaque(sheet.waist_m), waist_at=opaque(sheet.waist_at_m), divergence=opaque(sheet.divergence_rad),
            half=opaque(half), scale=opaque(peak), whole=opaque(whole), profile=sheet.fan_profile,
        )  # fmt: skip

    def density(self, phi: Any) -> Any:
        """p(φ) [1/rad]."""
        import drjit as dr

        if self.profile == "flat-top":
            return dr.select(dr.abs(phi) <= self.half, self.scale, 0.0)
        return dr.select(dr.abs(phi) <= 0.5 * dr.pi, self.scale * dr.exp(-2.0 * dr.square(phi / self.half)), 0.0)

    def drawn(self, uniform: Any) -> Any:
        """φ of density p(φ) from a uniform number."""
        import drjit as dr

        centred = 2.0 * uniform - 1.0
        if self.profile == "flat-top":
            return centred * self.half
        return self.half * float(np.sqrt(0.5)) * dr.erfinv(dr.clip(centred * self.whole, _EDGE - 1.0, 1.0 - _EDGE))

    @property
    def reach(self) -> Any:
        """The largest |φ| [rad] with light."""
        import drjit as dr

        return self.half if self.profile == "flat-top" else dr.opaque(mitsuba().Float, 0.5 * float(np.pi))

    def sigma(self, range_m: Any) -> Any:
        """σ(r) [m]."""
        import drjit as dr

        return 0.25 * dr.sqrt(dr.square(self.waist) + dr.square(self.divergence * (range_m - self.waist_at)))


@dataclass(frozen=True)
class Turns:
    """Angles ψ drawn with the density of β̃(ψ) per angle (not per solid angle) between two ends. `sums` (cells + 1): ∫β̃ dψ up to the
    edges of cells that are even in ln ψ, linear in ln ψ within each."""

    sums: Any

    @staticmethod
    def of(phase: PhaseFunction, least_rad: float) -> Turns:
        """The table of a phase function, of angles above `least_rad`."""
        edge = np.geomspace(_FINEST, np.pi, _CELLS + 1)
        middle = np.sqrt(edge[1:] * edge[:-1])
        # Half a cell early: no angle that is scattered has no chance to be drawn.
        share = np.where(edge[1:] < 0.98 * least_rad, 0.0, phase_density(phase, middle) * np.diff(edge))
        return Turns(mitsuba().Float(np.concatenate([[0.0], np.cumsum(share) / share.sum()]).astype(np.float32)))

    def drawn(self, uniform: Any, least: Any, most: Any) -> tuple[Any, Any]:
        """(ψ between `least` and `most`, 1 over its density)."""
        import drjit as dr

        mi = mitsuba()
        low, high = self._at(least), self._at(dr.maximum(most, least))
        wanted = low + uniform * (high - low)
        cell: Any = dr.binary_search(  # type: ignore[no-untyped-call]
            0, _CELLS - 1, lambda i: dr.gather(mi.Float, self.sums, i + 1) < wanted
        )
        cell = dr.minimum(mi.UInt32(cell), _CELLS - 1)
        begin = dr.gather(mi.Float, self.sums, cell)
        step = dr.maximum(dr.gather(mi.Float, self.sums, cell + 1) - begin, 1e-12)
        psi = _FINEST * dr.exp((mi.Float(cell) + dr.clip((wanted - begin) / step, 0.0, 1.0)) * _LOG_STEP)
        return psi, psi * _LOG_STEP * (high - low) / step

    def _at(self, psi: Any) -> Any:
        import drjit as dr

        mi = mitsuba()
        x = dr.clip(dr.log(dr.maximum(psi, _FINEST) / _FINEST) / _LOG_STEP, 0.0, _CELLS - 1e-3)
        cell = mi.UInt32(x)
        one, two = (dr.gather(mi.Float, self.sums, cell + k) for k in (0, 1))
        return one + (two - one) * (x - mi.Float(cell))


@dataclass(frozen=True)
class LineWorld:
    """Geometry, medium and sheet of one frame.

    `attenuation`, `absorption`, `scattering` 1/m; `phase`, `turns` None where nothing scatters; `straight`: b of turns that are
    counted as none, 1/m, which are in none of these; `reached` m, about the distance of the line from the laser.
    """

    geometry: Any
    sheet: DeviceSheet
    phase: PhaseCells | None
    attenuation: Any
    absorption: Any
    scattering: Any
    reached: Any
    turns: Turns | None
    straight: float

    @staticmethod
    def of(setting: Setting, pose: Pose, reached_m: float, geometry: Any = None) -> LineWorld:
        """The world of a frame; `geometry`: of an earlier frame of the same scene.

        Turns of less than a twentieth of a pixel displace no light that could be seen, and are counted as none: they would peak
        so high that single paths outshine the image.

        Raises InputError as `path_geometry`, and for a medium that scatters and has no phase function.
        """
        scene: Scene = setting.scene
        medium, phase = scene.medium, phase_of(scene)
        least = _STRAIGHT_PX / (setting.camera.focal_px * setting.camera.narrowing)
        straight = 0.0 if phase is None else medium.scattering_per_m * straight_share(phase, least)
        scattering = medium.scattering_per_m - straight
        return LineWorld(
            geometry=path_geometry(scene) if geometry is None else geometry,
            sheet=DeviceSheet.of(setting, pose),
            phase=None if phase is None else PhaseCells.of(phase, least),
            attenuation=opaque(medium.absorption_per_m + scattering),
            absorption=opaque(medium.absorption_per_m),
            scattering=opaque(scattering),
            reached=opaque(reached_m),
            turns=None if phase is None else Turns.of(phase, least),
            straight=straight,
        )
