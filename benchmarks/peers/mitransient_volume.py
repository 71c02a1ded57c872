"""mitransient's volumetric integrator as an independent reference of gated stacks, in air and in homogeneous water.

`transient_prbvolpath` starts every path outside all media (its source says that sensors inside media are not supported
yet), which makes water several times too bright. Its source is therefore loaded with that one line set to the medium of
the scene (`_in_water`), so that neither a housing around the camera nor a null interface is needed.

Geometry is written to files and read by Mitsuba; Lambert is Mitsuba's own `diffuse`, Henyey-Greenstein its own `hg`; other
phase functions are sampled from a separate table, constant in each cell of sin²(ψ/2), unlike that of our path tracer. The
lamp is Mitsuba's `spot`.

The histogram of optical paths has bins of σ_R/`divisor`, each evaluated at its middle: it adds (σ_R/divisor)²/12 to the
variance of R, 1/3072 of it at 16. Light in air is traced by `transient_path`.

Limits: its estimate has infinite variance for scattering close to the lamp (1/d²), and small deflections toward the lamp
are sampled by chance only. In harbour water 65,536 samples per pixel leave ε between .5 and 1.4, most runs being too dark
and a few far too bright: it cannot serve as a reference there.
"""

from __future__ import annotations

import importlib.util
import os
import tempfile
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...generator.bsdf.plugin import mitsuba_bsdf
from ...generator.gated.full import Slices
from ...generator.gated.gates import gate_tables, response_width_s
from ...generator.rays.backend import mitsuba
from ...generator.rays.trace import pixel_directions
from ...optics.constants import C_M_PER_S
from ...optics.correlation.response import lookup
from ...optics.water.phase_forms import HenyeyGreenstein, PhaseFunction, phase_cdf
from ...scenes.errors import InputError
from ...scenes.medium_index import group_index
from ...scenes.meshes import shape_mesh
from ...scenes.rigs.gated import gated_rig
from ...scenes.scene import Scene
from ...scenes.shapes import Sphere
from .mitransient_direct import electrons_per_radiance

__all__ = ["MitransientVolume", "mitransient_reference"]

Float = NDArray[np.float64]

_UNSET = "medium = dr.zeros(mi.MediumPtr)\n"
_SET = "medium = mi.MediumPtr(self.sensor_medium)\n"
_NAME = "transient_prbvolpath_in_water"
_PHASE = "tabulated_about_forward"
_CELLS = 1 << 14
_FINEST = 1e-12
#: Lanes of one launch.
_LANES = 1 << 21


def mitransient_reference(
    scene: Scene, slices: Slices, seed: int, samples: int, *, max_depth: int = -1, divisor: int = 16
) -> NDArray[np.float32]:
    """Expected photoelectrons (slices, rows, cols) of all light from the lamp, without ambient light, by mitransient.

    Main arguments:
        scene: gated; a flat-top beam; any material and homogeneous medium.
        slices: delays, scales, gates and the extra delay of the gate in each pixel.
        seed, samples: random numbers, and samples per pixel.
    Other arguments:
        max_depth: as mitransient counts (2 is direct light); −1 for all light.
        divisor: bins of σ_R/divisor.

    Raises:
        InputError: a beam that is not flat-top.
    """
    with tempfile.TemporaryDirectory() as folder:
        return MitransientVolume(scene, slices, folder, max_depth=max_depth, divisor=divisor).run(samples, seed)


class MitransientVolume:
    """A scene loaded by mitransient, and its gates."""

    def __init__(self, scene: Scene, slices: Slices, folder: str, *, max_depth: int = -1, divisor: int = 16) -> None:
        mi = mitsuba()
        import mitransient  # noqa: F401  (registers its plugins; the variant is set already)

        rig, medium = gated_rig(scene), scene.medium
        camera, laser = rig.camera, rig.laser
        if laser.illumination.profile != "flat-top":
            raise InputError(
                "The spot light of mitransient is flat-top only.", where=f"{scene.name}: rig.laser.illumination.profile",
                value=laser.illumination.profile, allowed="flat-top",
            )  # fmt: skip
        self.rows, self.cols, self.slices = camera.rows, camera.cols, slices
        self._tables, self._mi = gate_tables(scene), mi
        self._metre_per_s = C_M_PER_S / group_index(medium, laser.wavelength_m)
        self._bin_s = response_width_s(scene)[0] / divisor
        lows = [slices.delay_s[k] + self._tables[g].start_s for k, g in enumerate(slices.gate)]
        highs = [
            slices.delay_s[k] + self._tables[g].start_s + self._tables[g].step_s * (len(self._tables[g].value) - 1)
            for k, g in enumerate(slices.gate)
        ]
        late = np.zeros(1) if slices.offset_s is None else slices.offset_s
        self._first_s = max(min(lows) + float(late.min()), 0.0)
        self.bins = int(np.ceil((max(highs) + float(late.max()) - self._first_s) / self._bin_s))
        self._scale = np.full(self.rows * self.cols, electrons_per_radiance(scene))
        if camera.vignetting == "cos4":
            row, col = (a.ravel() for a in np.mgrid[: self.rows, : self.cols])
            self._scale *= pixel_directions(camera, row, col)[2] ** 4
        water = medium.absorption_per_m + medium.scattering_per_m > 0
        parts: dict[str, Any] = {"type": "scene", "light": _lamp(mi, scene), "sensor": self._sensor(mi, scene)}
        for number, item in enumerate(scene.target):
            parts[f"o{number}"] = _target(mi, item, os.path.join(folder, f"o{number}.ply"))
        if water:
            # A shell around the scene contains the medium; no light returns from beyond it.
            parts["water"] = {
                "type": "sphere", "radius": 1000.0, "bsdf": {"type": "null"}, "interior": _medium(mi, scene),
            }  # fmt: skip
        self.scene = mi.load_dict(parts, parallel=False)
        kind = "transient_path"
        if water:
            _in_water()
            kind = _NAME
        self.integrator = mi.load_dict({"type": kind, "max_depth": max_depth, "rr_depth": 8})
        if water:
            self.integrator.sensor_medium = next(
                s.interior_medium() for s in self.scene.shapes() if s.interior_medium() is not None
            )

    def _sensor(self, mi: Any, scene: Scene) -> dict[str, Any]:
        camera = gated_rig(scene).camera
        half_width = camera.cols * camera.pixel_pitch_m / 2
        return {
            "type": "perspective",
            "fov": float(np.rad2deg(2 * np.arctan(half_width / camera.focal_length_m))),
            "fov_axis": "x",
            "near_clip": 1e-4,  # path length is measured from the near plane
            "far_clip": 10_000.0,
            # Mitsuba's film mirrors x: x right and y down need "up" = −y.
            "to_world": mi.ScalarTransform4f().look_at(origin=[0, 0, 0], target=[0, 0, 1], up=[0, -1, 0]),
            "film": {
                "type": "transient_hdr_film", "width": self.cols, "height": self.rows, "temporal_bins": self.bins,
                "bin_width_opl": self._bin_s * self._metre_per_s, "start_opl": self._first_s * self._metre_per_s,
                "rfilter": {"type": "box"},
            },
            "sampler": {"type": "independent"},
        }  # fmt: skip

    def histogram(self, samples: int, seed: int) -> Float:
        """Radiance per unit of radiant intensity (pixels, bins) of one rendering."""
        _, transient = self._mi.render(self.scene, integrator=self.integrator, spp=samples, seed=seed % (1 << 31))
        return np.asarray(transient, dtype=np.float64).reshape(self.rows * self.cols, self.bins)

    def run(self, samples: int, seed: int) -> NDArray[np.float32]:
        """Photoelectrons (slices, rows, cols) of `samples` per pixel."""
        per = max(min(_LANES // (self.rows * self.cols), samples), 1)
        rounds = -(-samples // per)
        words = np.random.SeedSequence(seed).generate_state(rounds)
        total = np.zeros((self.rows * self.cols, self.bins))
        for word in words:
            total += self.histogram(per, int(word))
        return self.gated(total / rounds)

    def gated(self, histogram: Float) -> NDArray[np.float32]:
        """The stack of a histogram: the light of every bin at its middle."""
        centre = self._first_s + self._bin_s * (np.arange(self.bins) + 0.5)
        s = self.slices
        out = np.empty((len(s.delay_s), self.rows * self.cols), dtype=np.float32)
        for k, (delay, scale, gate) in enumerate(zip(s.delay_s, s.scale, s.gate, strict=True)):
            if s.offset_s is None:
                seen = histogram @ lookup(self._tables[gate], centre - delay)
            else:
                response = lookup(self._tables[gate], centre[None, :] - delay - s.offset_s[:, None])
                seen = np.einsum("pb,pb->p", histogram, response)
            out[k] = seen * self._scale * scale
        return out.reshape(-1, self.rows, self.cols)


def _lamp(mi: Any, scene: Scene) -> dict[str, Any]:
    laser = gated_rig(scene).laser
    from ...optics.illumination import beam_axis

    where = np.asarray(laser.position_m, dtype=float)
    half = float(np.rad2deg(laser.illumination.half_angle_rad))
    toward = where + beam_axis(laser.illumination.offset_rad)
    return {
        "type": "spot", "intensity": {"type": "spectrum", "value": 1.0},
        # Between the two angles the light falls linearly: over 1e-5 of the beam.
        "cutoff_angle": half * (1.0 + 5e-6), "beam_width": half * (1.0 - 5e-6),
        "to_world": mi.ScalarTransform4f().look_at(origin=where.tolist(), target=toward.tolist(), up=[0, 1, 0]),
    }  # fmt: skip


def _target(mi: Any, item: Any, file: str) -> dict[str, Any]:
    bsdf: Any
    if item.material.kind == "lambert":
        even = {"type": "spectrum", "value": float(item.material.albedo)}
        bsdf = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": even}}
    else:
        bsdf = mitsuba_bsdf(item.material)
    if isinstance(item.shape, Sphere):
        return {"type": "sphere", "center": list(item.shape.center_m), "radius": item.shape.radius_m, "bsdf": bsdf}
    import trimesh

    vertices, faces = shape_mesh(item.shape, item.name)
    trimesh.Trimesh(vertices, faces, process=False).export(file)
    return {"type": "ply", "filename": file, "face_normals": True, "bsdf": bsdf}


def _medium(mi: Any, scene: Scene) -> dict[str, Any]:
    a, b = scene.medium.absorption_per_m, scene.medium.scattering_per_m
    found: dict[str, Any] = {
        "type": "homogeneous",
        "sigma_t": {"type": "spectrum", "value": a + b},
        "albedo": {"type": "spectrum", "value": b / (a + b)},
    }
    if b > 0:
        phase = scene.medium.phase
        assert phase is not None
        if isinstance(phase, HenyeyGreenstein):
            found["phase"] = {"type": "hg", "g": phase.g}
        else:
            found["phase"] = _phase_plugin()(mi.Properties(), phase)
    return found


@lru_cache(maxsize=1)
def _in_water() -> None:
    """Register the integrator of the peer with the medium of the sensor set."""
    mitsuba()
    from mitransient.integrators import transient_prbvolpath as peer

    source = Path(str(peer.__file__)).read_text(encoding="utf-8")
    if source.count(_UNSET) != 1:
        raise RuntimeError(
            f"The source of mitransient's integrator has changed, so it cannot be adapted: {peer.__file__}."
        )
    source = source.replace(_UNSET, _SET).replace('"transient_prbvolpath"', f'"{_NAME}"')
    with tempfile.TemporaryDirectory() as folder:
        # drjit.syntax reads the source of what it transforms, once, at import.
        file = Path(folder) / f"{_NAME}.py"
        file.write_text(source, encoding="utf-8")
        spec = importlib.util.spec_from_file_location(f"{peer.__package__}.{_NAME}", file)
        assert spec is not None and spec.loader is not None
        spec.loader.exec_module(importlib.util.module_from_spec(spec))


@lru_cache(maxsize=1)
def _phase_plugin() -> Any:
    mi = mitsuba()
    import drjit as dr

    class TabulatedPhase(mi.PhaseFunction):  # type: ignore[name-defined,misc]
        """Constant in each cell of s = sin²(ψ/2), cells even in ln s: sampled exactly."""

        def __init__(self, props: Any, phase: PhaseFunction) -> None:
            super().__init__(props)
            edge = np.concatenate([[0.0], np.geomspace(_FINEST, 1.0, _CELLS)])
            cdf = phase_cdf(phase, 2.0 * np.arcsin(np.sqrt(edge)))
            cdf[-1] = 1.0
            share = np.diff(cdf)
            self._edge = mi.Float(edge)
            self._value = mi.Float(share / (4.0 * np.pi * np.diff(edge)))
            self._table = mi.DiscreteDistribution(share.astype(np.float32))
            self.m_flags = int(mi.PhaseFunctionFlags.Anisotropic)

        def sample(self, ctx: Any, mei: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
            cell, _ = self._table.sample_reuse(sample1, active)
            low = dr.gather(mi.Float, self._edge, cell, active)
            s = low + sample2.x * (dr.gather(mi.Float, self._edge, cell + 1, active) - low)
            sine = 2.0 * dr.safe_sqrt(s * (1.0 - s))
            sin_phi, cos_phi = dr.sincos(2.0 * dr.pi * sample2.y)
            local = mi.Vector3f(sine * cos_phi, sine * sin_phi, 1.0 - 2.0 * s)
            wo = mi.Frame3f(-mei.wi).to_world(local)
            return wo, mi.Spectrum(1.0), dr.gather(mi.Float, self._value, cell, active)

        def eval_pdf(self, ctx: Any, mei: Any, wo: Any, active: Any = True) -> Any:
            s = 0.25 * dr.squared_norm(wo + mei.wi)
            x = (dr.log(dr.maximum(s, _FINEST)) - float(np.log(_FINEST))) * ((_CELLS - 1) / -float(np.log(_FINEST)))
            cell = dr.select(s < _FINEST, 0, dr.minimum(mi.UInt32(x) + 1, _CELLS - 1))
            value = dr.gather(mi.Float, self._value, cell, active)
            return mi.Spectrum(value), value

        def to_string(self) -> str:
            return _PHASE

    return TabulatedPhase
