"""Cost of the `direct` rung against mitransient (direct only, mono) at equal error, by DESIGN.md's rule.

Scene: the scanned bunny (or a library sphere where the mesh is not there) before a wall, 512×512×64. The quantity is the
expected photoelectrons per pixel and gate. R1 and R2 are independent references: mitransient at many samples with
different seeds. ε² = Σ(X−R1)(X−R2)/ΣR1R2 is free of reference noise. The peer is run at ≥ 4 sample counts × ≥ 5 seeds;
ε² = floor² + v/N and cost = a + qN are fitted, and its cost is read at the ε asked for. Compilation and loading are left out.

    python -m beambench.benchmarks.peers.mitransient_direct [MESH] [--size 512] [--quick]
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...generator.backend import mitsuba
from ...generator.direct import gate_tables, render_direct
from ...generator.returns import render_stack
from ...generator.trace import Tracer
from ...optics.constants import C_M_PER_S
from ...optics.correlation import lookup
from ...scenes.declare import group_index
from ...scenes.load import load_scene
from ...scenes.meshes import shape_mesh
from ...scenes.scene import Scene
from ...scenes.shapes import Sphere

__all__ = ["MitransientDirect", "compare", "equal_error_cost", "squared_error"]

Float = NDArray[np.float64]


def bunny_scene(mesh: str | None, size: int) -> Scene:
    """A mesh before a wall, Lambert both, seen by a coaxial rig whose beam covers the view evenly."""
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


class MitransientDirect:
    """The peer: mitransient's `transient_path`, depth 2, box filter, histogram bins of σ_R/4, then the same gates."""

    def __init__(self, scene: Scene, bin_s: float) -> None:
        mi = mitsuba()
        import mitransient  # noqa: F401  (registers its plugins; the variant is set already)

        self._mi = mi
        rig = scene.rig
        self.rows, self.cols = rig.camera.rows, rig.camera.cols
        per_second = C_M_PER_S / group_index(scene.medium, rig.laser.wavelength_m)
        table = gate_tables(scene)[0]
        delays = rig.delays.start_s + rig.delays.step_s * np.arange(rig.delays.count) + rig.t0_s
        first = delays[0] + table.start_s
        last = delays[-1] + table.start_s + table.step_s * (len(table.value) - 1)
        self.bins = int(np.ceil((last - first) / bin_s))
        centre = first + bin_s * (np.arange(self.bins) + 0.5)
        self.gates = lookup(table, centre[:, None] - delays[None, :]).astype(np.float32)
        # fov spans the outer edges of the pixels along x.
        half_width = rig.camera.cols * rig.camera.pixel_pitch_m / 2
        fov = float(np.rad2deg(2 * np.arctan(half_width / rig.camera.focal_length_m)))
        parts: dict[str, Any] = {
            "type": "scene",
            "integrator": {"type": "transient_path", "max_depth": 2, "temporal_filter": "box"},
            "sensor": {
                "type": "perspective",
                "fov": fov,
                "fov_axis": "x",
                "near_clip": 1e-4,  # path length is measured from the near plane
                "far_clip": 100.0,
                # Looking along z with y down: Mitsuba's film mirrors x, so x right, y down needs "up" = −y.
                "to_world": mi.ScalarTransform4f().look_at(origin=[0, 0, 0], target=[0, 0, 1], up=[0, -1, 0]),
                "film": {
                    "type": "transient_hdr_film",
                    "width": self.cols,
                    "height": self.rows,
                    "temporal_bins": self.bins,
                    "bin_width_opl": bin_s * per_second,
                    "start_opl": first * per_second,
                    "rfilter": {"type": "box"},
                },
                "sampler": {"type": "independent"},
            },
            "light": {"type": "point", "position": [0, 0, 0], "intensity": {"type": "spectrum", "value": 1.0}},
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
            props = mi.Properties()
            props["face_normals"] = True
            props["mesh_bsdf"] = mi.load_dict(bsdf)
            mesh = mi.Mesh(f"o{number}", len(vertices), len(faces), props=props)
            params = mi.traverse(mesh)
            params["vertex_positions"] = np.ascontiguousarray(vertices, np.float32).ravel()
            params["faces"] = np.ascontiguousarray(faces, np.uint32).ravel()
            params.update()
            parts[f"o{number}"] = mesh
        self._scene = mi.load_dict(parts)

    def run(self, samples: int, seed: int) -> tuple[NDArray[np.float32], float]:
        """Stack (slices, pixels) in the peer's units (radiance per unit intensity), and wall seconds."""
        start = time.perf_counter()
        _, transient = self._mi.render(self._scene, spp=samples, seed=seed)
        histogram = np.asarray(transient).reshape(self.rows * self.cols, self.bins)
        stack = self.gates.T @ histogram.T
        return stack, time.perf_counter() - start


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


def ours(scene: Scene, tracer: Tracer, rtol: float) -> tuple[NDArray[np.float32], float]:
    """Our expected stack (slices, pixels) and wall seconds, scene loaded and kernels compiled before."""
    delays = scene.rig.delays.start_s + scene.rig.delays.step_s * np.arange(scene.rig.delays.count) + scene.rig.t0_s
    out = np.empty((len(delays), scene.rig.camera.rows * scene.rig.camera.cols), dtype=np.float32)
    start = time.perf_counter()
    direct = render_direct(scene, rtol, tracer)
    render_stack(direct.returns, gate_tables(scene)[0], delays, np.ones(len(delays)), None, out)
    return out, time.perf_counter() - start


def compare(mesh: str | None, size: int, counts: list[int], seeds: int, reference: int, repeats: int) -> dict[str, Any]:
    """Run both and print the ratio of costs at our own ε for several rtol, and at ε = 1 % and 0.15 %."""
    scene = bunny_scene(mesh, size)
    tracer = Tracer(scene)
    from ...generator.direct import response_width_s

    sigma, _ = response_width_s(scene)
    peer = MitransientDirect(scene, sigma / 4)
    peer.run(min(counts), 999)
    refs = []
    for half in range(2):
        total = sum(peer.run(counts[-1], 10_000 * (half + 1) + i)[0].astype(np.float64) for i in range(reference))
        refs.append(total / reference)
    # One factor links radiance per unit intensity and photoelectrons.
    fine, _ = ours(scene, tracer, 2e-4)
    scale = float(np.vdot(fine, refs[0] + refs[1]) / np.vdot(fine, fine)) / 2
    runs = []
    mine: dict[float, list[tuple[float, float]]] = {rtol: [] for rtol in (1e-2, 3e-3, 1e-3, 3e-4)}
    for seed in range(seeds):
        for n in counts:
            stack, seconds = peer.run(n, seed)
            runs.append((n, squared_error(stack, *refs), seconds))
        for rtol, rows in mine.items():
            for _ in range(repeats):
                stack, seconds = ours(scene, tracer, rtol)
                rows.append((squared_error(stack * scale, *refs), seconds))
    ns, e2, cost = (np.array(c) for c in zip(*runs, strict=True))
    result: dict[str, Any] = {
        "scene": scene.name, "size": size, "slices": scene.rig.delays.count, "peer_counts": counts, "seeds": seeds,
    }  # fmt: skip
    result["peer_epsilon"] = {int(n): float(np.sqrt(max(np.mean(e2[ns == n]), 0))) for n in counts}
    result["ours"] = []
    for rtol, rows in mine.items():
        epsilon = float(np.sqrt(max(np.mean([r[0] for r in rows]), 0.0)))
        seconds = float(np.median([r[1] for r in rows]))
        peer_cost, floor, remark = equal_error_cost(ns, e2, cost, epsilon)
        result["ours"].append(
            {"rtol": rtol, "epsilon": epsilon, "ratio": peer_cost / seconds, "peer_floor": floor, "remark": remark}
        )
    for epsilon in (0.01, 0.0015):
        enough = [(np.sqrt(max(np.mean([r[0] for r in rows]), 0.0)), np.median([r[1] for r in rows])) for rows in mine.values()]
        reached = [s for e, s in enough if e <= epsilon]
        peer_cost, _, remark = equal_error_cost(ns, e2, cost, epsilon)
        result[f"ratio_at_{epsilon:g}"] = {
            "ratio": peer_cost / min(reached) if reached else None,
            "remark": remark if reached else "ours unreached",
        }
    return result


def main() -> int:
    """Command line of the comparison."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("mesh", nargs="?", default=None)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--quick", action="store_true", help="fewer samples: a smoke test, not a measurement")
    options = parser.parse_args()
    counts = [4, 8] if options.quick else [8, 16, 64, 256]
    print(
        json.dumps(
            compare(
                options.mesh,
                options.size,
                counts,
                seeds=2 if options.quick else 5,
                reference=2 if options.quick else 16,
                repeats=1 if options.quick else 3,
            ),
            indent=1,
        )
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
