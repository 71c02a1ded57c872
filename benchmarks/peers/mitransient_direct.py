"""Cost of the `direct` rung against mitransient (direct light only, mono) at equal error.

Scene: the scanned bunny (or a library sphere where no mesh is given) before a wall, 512×512×64. The quantity is the
expected photoelectrons per pixel and gate. R1 and R2 are independent references by other code: Mitsuba's own sensor,
emitter and BSDF at random film positions, exact times and error functions, without a histogram (`exact_reference`).
ε² = Σ(X−R1)(X−R2)/ΣR1R2 is unbiased by noise of the references. The peer runs at ≥ 4 sample counts × ≥ 5 seeds;
ε² = floor² + v/N and cost = a + qN are fitted, and its cost is evaluated at the given ε. The bin of the histogram sets the
floor of the peer (the whole echo of a pixel moves to the centre of the bin), so several bin widths are tried and the
cheapest that reaches ε counts. The cost of the peer is its rendering only: gating the histogram is not counted.
Compilation and loading are excluded on both sides. Both use all cores; runs alternate. `--clock wall` (the default) needs
an idle machine; `--clock cpu` counts the seconds of all threads, including those in which they wait for each other.

    python -m beambench.benchmarks.peers.mitransient_direct [MESH] [--size 512] [--quick]
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from ...generator.gated.direct import render_direct
from ...generator.gated.gates import gate_tables, response_width_s
from ...generator.rays.backend import mitsuba
from ...generator.rays.returns import render_stack
from ...generator.rays.trace import Tracer
from ...optics.constants import C_M_PER_S, FWHM_PER_SIGMA, PLANCK_J_S
from ...optics.correlation.response import lookup
from ...scenes.load import load_scene
from ...scenes.medium_index import group_index
from ...scenes.meshes import shape_mesh
from ...scenes.rigs.gated import gated_rig
from ...scenes.rigs.parts import Camera
from ...scenes.scene import Scene
from ...scenes.shapes import Sphere

__all__ = ["MitransientDirect", "compare", "equal_error_cost", "squared_error"]

Float = NDArray[np.float64]

_CLOCKS = {"wall": time.perf_counter, "cpu": time.process_time}
_clock = time.perf_counter

#: Size of one band's histogram; Mitsuba holds a few copies of it.
_BAND_BYTES = 600 * 2**20


def bunny_scene(mesh: str | None, size: int) -> Scene:
    """A mesh before a wall, both Lambertian, and a coaxial rig whose beam covers the field of view evenly."""
    shape: dict[str, Any] = {"kind": "sphere", "center_m": [0.0, 0.05, 4.6], "radius_m": 0.35}
    if mesh:
        shape = {
            "kind": "mesh",
            "file": mesh,
            "size_m": 0.9,
            "center_m": [0.0, 0.05, 4.6],
            "rotation_deg": [180.0, 20.0, 0.0],
        }
    return load_scene(
        "sphere",
        {
            "name": "bunny-before-wall",
            "rig.gates": [{"kind": "rectangular", "width_s": 1.0e-9, "transmission": 1.0}],
            "target.0.shape": shape,
            "target.0.name": "bunny",
            "rig.camera.rows": size,
            "rig.camera.cols": size,
            "rig.camera.focal_length_m": 8.0e-3 * size / 256,
            "rig.camera.vignetting": "none",
            "rig.laser.illumination": {"profile": "flat-top", "half_angle_rad": 0.5, "offset_rad": [0.0, 0.0]},
            "rig.delays.start_s": 28.0e-9,
        },
    )


def _fov_deg(camera: Camera) -> float:
    """Field of view along x: between the outer edges of the pixels."""
    half_width = camera.cols * camera.pixel_pitch_m / 2
    return float(np.rad2deg(2 * np.arctan(half_width / camera.focal_length_m)))


class MitransientDirect:
    """The peer: mitransient's `transient_path`, depth 2, box filter, histogram bins of σ_R/4, then the same gates."""

    def __init__(self, scene: Scene, bin_s: float, folder: str) -> None:
        mi = mitsuba()
        import mitransient  # noqa: F401  (registers its plugins; the variant is set already)
        import trimesh

        self._mi = mi
        rig = gated_rig(scene)
        self.rows, self.cols = rig.camera.rows, rig.camera.cols
        per_second = C_M_PER_S / group_index(scene.medium, rig.laser.wavelength_m)
        table = gate_tables(scene)[0]
        delays = rig.delays.settings_s + rig.t0_s
        first = delays.min() + table.start_s
        last = delays.max() + table.start_s + table.step_s * (len(table.value) - 1)
        self.bins = int(np.ceil((last - first) / bin_s))
        centre = first + bin_s * (np.arange(self.bins) + 0.5)
        self.gates = lookup(table, centre[:, None] - delays[None, :]).astype(np.float32)
        fov = _fov_deg(rig.camera)
        parts: dict[str, Any] = {
            "type": "scene",
            "integrator": {"type": "transient_path", "max_depth": 2, "temporal_filter": "box"},
            "light": {"type": "point", "position": [0, 0, 0], "intensity": {"type": "spectrum", "value": 1.0}},
        }
        # A film of many bins does not fit in memory at once: bands of rows, rendered one after the other.
        self.bands = max(1, -(-self.rows * self.cols * self.bins * 4 // _BAND_BYTES))
        height = -(-self.rows // self.bands)
        for band, first_row in enumerate(range(0, self.rows, height)):
            rows = min(height, self.rows - first_row)
            parts[f"sensor{band}"] = self._sensor(first_row, rows, fov) | {
                "film": {
                    "type": "transient_hdr_film",
                    "width": self.cols,
                    "height": rows,
                    "temporal_bins": self.bins,
                    "bin_width_opl": float(bin_s * per_second),
                    "start_opl": float(first * per_second),
                    "rfilter": {"type": "box"},
                },
            }
        for number, item in enumerate(scene.target):
            assert item.material.kind == "lambert"
            bsdf = {
                "type": "twosided",
                "bsdf": {
                    "type": "diffuse",
                    "reflectance": {"type": "spectrum", "value": float(item.material.albedo)},
                },
            }
            if isinstance(item.shape, Sphere):
                parts[f"o{number}"] = {
                    "type": "sphere",
                    "center": list(item.shape.center_m),
                    "radius": item.shape.radius_m,
                    "bsdf": bsdf,
                }
                continue
            vertices, faces = shape_mesh(item.shape, item.name)
            file = os.path.join(folder, f"o{number}.ply")
            trimesh.Trimesh(vertices, faces, process=False).export(file)
            parts[f"o{number}"] = {"type": "ply", "filename": file, "face_normals": True, "bsdf": bsdf}
        self.scene = mi.load_dict(parts, parallel=False)

    def _sensor(self, first_row: int, rows: int, fov: float) -> dict[str, Any]:
        """The camera of one band of rows, without its film."""
        return {
            "type": "perspective",
            "fov": fov,
            "fov_axis": "x",
            "principal_point_offset_y": 0.5 - (self.rows / 2 - first_row) / rows,
            "near_clip": 1e-4,  # path length is measured from the near plane
            "far_clip": 100.0,
            # Looking along z with y down: Mitsuba's film mirrors x, so x right, y down needs "up" = −y.
            "to_world": self._mi.ScalarTransform4f().look_at(origin=[0, 0, 0], target=[0, 0, 1], up=[0, -1, 0]),
            "sampler": {"type": "independent"},
        }

    def run(self, samples: int, seed: int) -> tuple[NDArray[np.float32], float]:
        """Stack (slices, pixels) in units of the peer (radiance per unit intensity), and seconds of rendering."""
        stack = np.empty((self.gates.shape[1], self.rows * self.cols), dtype=np.float32)
        seconds, first = 0.0, 0
        for band in range(len(self.scene.sensors())):
            start = _clock()
            _, transient = self._mi.render(self.scene, sensor=band, spp=samples, seed=seed * 64 + band)
            histogram = np.asarray(transient).reshape(-1, self.bins)
            seconds += _clock() - start
            stack[:, first : first + len(histogram)] = (histogram @ self.gates).T
            first += len(histogram)
        return stack, seconds


def electrons_per_radiance(scene: Scene) -> float:
    """Photoelectrons per unit radiance of a source of unit radiant intensity: the factor between Mitsuba's units and ours."""
    camera, laser = gated_rig(scene).camera, gated_rig(scene).laser
    solid_angle = 2 * np.pi * (1 - np.cos(laser.illumination.half_angle_rad))
    joule = laser.pulse_energy_j / solid_angle * camera.pixel_pitch_m**2 * np.pi / (4 * camera.f_number**2)
    per_joule = laser.wavelength_m / (PLANCK_J_S * C_M_PER_S)
    return float(
        gated_rig(scene).pulses_per_slice * joule * camera.transmission * camera.quantum_efficiency * per_joule
    )


def exact_reference(peer: MitransientDirect, scene: Scene, samples: int, seed: int) -> Float:
    """Expected photoelectrons (slices, pixels) by Mitsuba's sensor, emitter and BSDF at random positions; exact times."""
    import drjit as dr

    mi = mitsuba()
    rig = gated_rig(scene)
    laser, gate = rig.laser, rig.gates[0]
    assert laser.pulse.kind == "gaussian" and gate.kind == "rectangular"
    delays = rig.delays.settings_s + rig.t0_s
    wide = laser.pulse.fwhm_s / FWHM_PER_SIGMA * np.sqrt(2)
    per_second = C_M_PER_S / group_index(scene.medium, laser.wavelength_m)
    pixels = peer.rows * peer.cols
    total = np.zeros((len(delays), pixels))
    world = peer.scene
    sensor = world.sensors()[0]
    assert peer.bands == 1
    context = mi.BSDFContext()
    for one in range(samples):
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed + one, pixels)
        index = dr.arange(mi.UInt32, pixels)
        position = mi.Vector2f(index % peer.cols, index // peer.cols) + sampler.next_2d()
        ray, _ = sensor.sample_ray(0.0, 0.0, position / mi.Vector2f(peer.cols, peer.rows), mi.Point2f(0.5))
        si = world.ray_intersect(ray)
        ds, weight = world.sample_emitter_direction(si, sampler.next_2d(), True, si.is_valid())
        value = weight * si.bsdf(ray).eval(context, si, si.to_local(ds.d), si.is_valid())
        path = np.asarray((si.t + 1e-4 / dr.abs(ray.d.z) + ds.dist).numpy(), dtype=np.float64)
        light = np.asarray(value.numpy(), dtype=np.float64).ravel()
        tau = np.where(light > 0, path, 0.0) / per_second
        for k, delay in enumerate(delays):
            u = tau - delay
            near = np.abs(u - gate.width_s / 2) < gate.width_s / 2 + 5 * wide
            total[k, near] += light[near] * 0.5 * (erf((gate.width_s - u[near]) / wide) + erf(u[near] / wide))
    return np.asarray(total * (electrons_per_radiance(scene) / samples))


def squared_error(x: Any, r1: Any, r2: Any) -> float:
    """ε² = Σ(X−R1)(X−R2)/ΣR1R2."""
    a, b, c = (np.asarray(v, dtype=np.float64).ravel() for v in (x, r1, r2))
    return float(np.dot(a - b, a - c) / np.dot(b, c))


def equal_error_cost(samples: Any, squared: Any, seconds: Any, epsilon: float) -> tuple[float, float, str]:
    """Fit ε² = floor² + v/N and cost = a + qN; return (cost at ε, floor, remark).

    The remark says "unreached" where the floor is above ε, and "extrapolated" beyond 4 × the largest N.
    """
    n = np.asarray(samples, dtype=float)
    weight = n  # relative errors of ε² are alike at every N
    design = np.stack([np.ones_like(n), 1 / n], axis=1)
    (floor2, v), *_ = np.linalg.lstsq(design * weight[:, None], np.asarray(squared) * weight, rcond=None)
    q, a = np.polyfit(n, np.asarray(seconds), 1)
    floor2 = max(float(floor2), 0.0)
    if epsilon**2 <= floor2:
        return float("inf"), float(np.sqrt(floor2)), "unreached"
    wanted = float(v) / (epsilon**2 - floor2)
    remark = "extrapolated" if wanted > 4 * n.max() or wanted < n.min() / 4 else ""
    return float(max(a, 0.0) + q * wanted), float(np.sqrt(floor2)), remark


def ours(
    scene: Scene, tracer: Tracer, rtol: float, out: NDArray[np.float32] | None = None
) -> tuple[NDArray[np.float32], float]:
    """Our expected stack (slices, pixels) and seconds; the scene is loaded and kernels are compiled beforehand."""
    spec = gated_rig(scene).delays
    delays: Float = spec.start_s + spec.step_s * np.arange(spec.count, dtype=np.float64) + gated_rig(scene).t0_s
    if out is None:
        out = np.zeros((len(delays), gated_rig(scene).camera.rows * gated_rig(scene).camera.cols), dtype=np.float32)
    out.fill(0.0)  # the process already has the memory, as for the peer, whose allocator keeps it
    start = _clock()
    direct = render_direct(scene, rtol, tracer, with_truth=False)  # the peer creates none
    render_stack(direct.returns, gate_tables(scene)[0], delays, np.ones(len(delays)), None, out)
    return out, _clock() - start


def compare(mesh: str | None, size: int, counts: list[int], seeds: int, reference: int, repeats: int) -> dict[str, Any]:
    """Run both, interleaved, and return ε and cost of ours at several rtol, and the ratio of costs at ε = 1 % and 0.15 %."""
    scene = bunny_scene(mesh, size)
    tracer = Tracer(scene)
    sigma, _ = response_width_s(scene)
    factor = electrons_per_radiance(scene)
    result: dict[str, Any] = {
        "scene": scene.name, "size": size, "slices": gated_rig(scene).delays.count, "peer_counts": counts, "seeds": seeds,
        "reference_samples": reference, "peer": [],
    }  # fmt: skip
    refs: list[Float] = []
    mine: dict[float, list[tuple[float, float]]] = {
        rtol: [] for rtol in (3e-2, 2e-2, 1.4e-2, 1e-2, 5e-3, 3e-3, 2e-3, 1e-3)
    }
    fits = []
    buffer, _ = ours(scene, tracer, 1e-2)
    for divisor in (16, 32, 128):
        with tempfile.TemporaryDirectory() as folder:
            peer = MitransientDirect(scene, sigma / divisor, folder)
        if not refs:
            refs = [exact_reference(peer, scene, reference, 100_000 * (half + 1)) for half in range(2)]
            ours(scene, tracer, 1e-2)
        peer.run(min(counts), 999)
        runs = []
        for seed in range(seeds):
            for n in counts:
                stack, seconds = peer.run(n, seed)
                runs.append((n, squared_error(stack * np.float32(factor), *refs), seconds))
            for rtol, rows in mine.items():
                for _ in range(repeats):
                    stack, seconds = ours(scene, tracer, rtol, buffer)
                    rows.append((squared_error(stack, *refs) if not rows else rows[0][0], seconds))
        ns, e2, cost = (np.array(c) for c in zip(*runs, strict=True))
        fits.append((divisor, ns, e2, cost))
        result["peer"].append(
            {
                "bin": f"sigma/{divisor}", "bins": peer.bins,
                "epsilon": {int(n): float(np.sqrt(max(np.mean(e2[ns == n]), 0))) for n in counts},
                "relative_cost": {int(n): float(np.median(cost[ns == n]) / np.median(cost[ns == counts[0]])) for n in counts},
            }
        )  # fmt: skip
        del peer
    ours_at = {
        rtol: (float(np.sqrt(max(rows[0][0], 0.0))), float(np.median([r[1] for r in rows])))
        for rtol, rows in mine.items()
    }
    result["ours"] = [
        {"rtol": rtol, "epsilon": e, "relative_cost": s / ours_at[1e-2][1]} for rtol, (e, s) in ours_at.items()
    ]
    for epsilon in (0.01, 0.0015):
        result[f"at_{epsilon:g}"] = _at_equal_error(epsilon, list(ours_at.values()), fits)
    return result


def _at_equal_error(
    epsilon: float, ours_at: list[tuple[float, float]], fits: list[tuple[int, Float, Float, Float]]
) -> dict[str, Any]:
    """Ratio of costs at error `epsilon`, of the peer's best width of bins.

    Main arguments:
        ours_at: (error, seconds) of ours. fits: (divisor of σ, samples, squared errors, seconds) of the peer's runs.
    """
    reached = [s for e, s in ours_at if e <= epsilon]
    options = []
    for divisor, ns, e2, cost in fits:
        seconds, floor, remark = equal_error_cost(ns, e2, cost, epsilon)
        options.append((seconds, f"sigma/{divisor}", floor, remark))
    seconds, label, floor, remark = min(options)
    return {
        "ratio": seconds / min(reached) if reached and np.isfinite(seconds) else None,
        "peer_bin": label, "peer_floor": floor, "remark": remark if reached else "ours unreached",
        "floors": {o[1]: o[2] for o in options},
    }  # fmt: skip


def main() -> int:
    """Command line of the comparison."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("mesh", nargs="?", default=None)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--quick", action="store_true", help="fewer samples: a smoke test, not a measurement")
    parser.add_argument("--clock", choices=sorted(_CLOCKS), default="wall")
    options = parser.parse_args()
    global _clock
    _clock = _CLOCKS[options.clock]
    counts = [4, 8] if options.quick else [4, 16, 64, 256]
    print(
        json.dumps(
            compare(
                options.mesh,
                options.size,
                counts,
                seeds=2 if options.quick else 5,
                reference=4 if options.quick else 64,
                repeats=1,
            ),
            indent=1,
        )
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
