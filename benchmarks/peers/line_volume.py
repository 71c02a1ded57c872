"""Cost of a laser line's image in water: our rungs `scatter` and `full` against Mitsuba's `volpath`, at equal error.

    python -m beambench.benchmarks.peers.line_volume [--quick]

The scene is `spotscan-wall` without port, in Petzold's coastal water. Mitsuba's light is a projector at the laser whose picture
is one bright column as wide as the sheet at the wall: a sheet of light in the medium, on the wall and back, found by connecting
each scattering event to the projector. Mitsuba's error is its noise alone: ε² = Σ(X₁ − X₂)²/(2 Σ X₁X₂) of two seeds, so that
nothing in which its sheet differs from ours counts against it. ε² = v/N is fitted, and the cost is that of N at ε. Our `scatter`
has a constant cost; its own error is measured against the mean of two seeds of our `full`, and must be below ε. Figures are given
for the whole image, and for the pixels beside the line, where light was scattered. CPU seconds of all threads; scenes are loaded
and kernels compiled beforehand.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...generator.generate import generate
from ...generator.rays.backend import mitsuba
from ...scenes.load import load_scene
from ...scenes.medium_index import phase_index
from ...scenes.rigs.laser_line import laser_line_rig
from ...scenes.rigs.laser_line_geometry import line_sheet
from ...scenes.scene import Scene
from .mitransient_direct import squared_error
from .volume_cost import timed

__all__ = ["line_scene", "measured"]

Image = NDArray[np.float64]

EPSILON, GOAL = 0.03, 1000.0
#: Mean cosine of the phase function.
_G = 0.9
#: Pixels from the line within which light is counted as its own.
_BESIDE_PX = 6
#: Paths of one launch.
_LANES = 1 << 22


def line_scene(rows: int = 256, cols: int = 192) -> Scene:
    """The wall of `spotscan-wall` in coastal water: c = .4 1/m, Henyey-Greenstein of g = .9, which both packages have."""
    medium = {
        "name": "coastal", "index": {"kind": "explicit", "phase": 1.34, "group": 1.36}, "absorption_per_m": 0.179,
        "scattering_per_m": 0.219, "phase_function": {"kind": "henyey-greenstein", "g": _G},
    }  # fmt: skip
    return load_scene(
        "spotscan-wall",
        {"medium": medium, "rig.port": {"kind": "none"}, "rig.camera.rows": rows, "rig.camera.cols": cols,
         "rig.camera.pixel_pitch_m": 57.8125e-6 * 192 / cols, "rig.frames.lit": 1},
    )  # fmt: skip


def _water(scene: Scene) -> dict[str, Any]:
    whole, scattered = scene.medium.attenuation_per_m, scene.medium.scattering_per_m
    return {
        "type": "homogeneous", "albedo": {"type": "spectrum", "value": scattered / whole},
        "sigma_t": {"type": "spectrum", "value": whole}, "phase": {"type": "hg", "g": _G},
    }  # fmt: skip


class _Peer:
    """The scene in Mitsuba: one camera, one projector, one wall, no boundary of the water."""

    def __init__(self, scene: Scene) -> None:
        mi = mitsuba()
        rig = laser_line_rig(scene)
        camera = rig.camera
        self.rows, self.cols, self._mi = camera.rows, camera.cols, mi
        sheet = line_sheet(rig, phase_index(scene.medium, rig.wavelength_m))
        source, axis, normal = np.asarray(sheet.source), sheet.frame[:, 2], np.asarray(sheet.normal)
        up = np.cross(axis, normal)
        fan = float(np.rad2deg(2.0 * rig.laser.fan_half_angle_rad))
        wide = 2.0 * float(np.ravel(sheet.sigma(1.0))[0])  # its full width at 1 m, as an angle
        parts = max(int(np.tan(np.deg2rad(fan / 2)) * 2.0 / wide) | 1, 3)
        picture = np.zeros((parts, parts, 1), np.float32)  # square, as its fans are
        picture[:, parts // 2] = 1.0
        half = camera.cols * camera.pixel_pitch_m / 2
        t = mi.ScalarTransform4f
        wall: Any = scene.target[0]
        shape = wall.shape
        turn = t().rotate([0, 1, 0], shape.tilt_y_deg).rotate([1, 0, 0], shape.tilt_x_deg + 180.0)
        size = t().scale([shape.width_m / 2, shape.height_m / 2, 1])
        even = {"type": "spectrum", "value": float(wall.material.albedo)}
        self.scene = mi.load_dict(
            {
                "type": "scene",
                "water": _water(scene),
                "integrator": {"type": "volpath", "max_depth": -1, "rr_depth": 8},
                "wall": {
                    "type": "rectangle", "to_world": t().translate(list(shape.center_m)) @ turn @ size,
                    "bsdf": {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": even}},
                },
                "light": {
                    "type": "projector", "fov": fan, "fov_axis": "x",
                    "irradiance": {"type": "bitmap", "data": mi.TensorXf(picture), "raw": True, "filter_type": "nearest"},
                    "to_world": t().look_at(origin=source.tolist(), target=(source + axis).tolist(), up=up.tolist()),
                },
                "sensor": {
                    "type": "perspective", "fov": float(np.rad2deg(2 * np.arctan(half / camera.focal_length_m))),
                    "fov_axis": "x", "near_clip": 1e-4, "far_clip": 1e4, "medium": {"type": "ref", "id": "water"},
                    "to_world": t().look_at(origin=[0, 0, 0], target=[0, 0, 1], up=[0, -1, 0]),
                    "film": {
                        "type": "hdrfilm", "width": self.cols, "height": self.rows, "rfilter": {"type": "box"},
                        "pixel_format": "luminance",
                    },
                    "sampler": {"type": "independent"},
                },
            },
            parallel=False,
        )  # fmt: skip

    def image(self, samples: int, seed: int) -> Image:
        """Radiance (rows, cols) of `samples` paths in each pixel."""
        per = max(min(_LANES // (self.rows * self.cols), samples), 1)
        rounds = -(-samples // per)
        words = np.random.SeedSequence(seed).generate_state(rounds)
        total = np.zeros((self.rows, self.cols))
        for word in words:
            total += np.asarray(self._mi.render(self.scene, spp=per, seed=int(word) % (1 << 31)), np.float64).reshape(
                total.shape
            )
        return total / rounds


def _error(one: Image, two: Image, where: NDArray[np.bool_]) -> float:
    """Noise of one image over the image, of two with independent noise."""
    return float(np.sqrt(((one - two)[where] ** 2).sum() / (2.0 * (one * two)[where].sum())))


def _made(scene: Scene, rung: Any, rtol: float, seed: int) -> Image:
    return np.asarray(
        generate(scene, seed=seed, fidelity=rung, rtol=rtol, truth_electrons=True)["truth_electrons"].values[0], np.float64
    ) - laser_line_rig(scene).detector.dark_current_e_per_s * laser_line_rig(scene).detector.exposure_s  # fmt: skip


def measured(rows: int = 128, cols: int = 96, *, samples: int = 1024, reference: float = 0.005) -> dict[str, Any]:
    """Costs at ε = 3 % for the whole image and beside the line.

    Main arguments:
        samples: paths of a pixel in each of Mitsuba's two images. reference: standard error asked of our `full`.
    """
    scene = line_scene(rows, cols)
    full = [_made(scene, "full", reference, seed) for seed in (1, 2)]
    _made(scene, "scatter", EPSILON / 3, 1)
    runs = [timed(lambda: _made(scene, "scatter", EPSILON / 3, 1)) for _ in range(5)]
    ours, cost = runs[0][0], min(seconds for _, seconds in runs)
    peer = _Peer(scene)
    peer.image(2, 9)
    (one, first), (two, second) = (timed(partial(peer.image, samples, seed)) for seed in (11, 12))
    line = np.abs(np.arange(cols) - np.argmax(ours, axis=1)[:, None]) <= _BESIDE_PX
    found: dict[str, Any] = {"rows": rows, "cols": cols, "epsilon": EPSILON, "goal": GOAL, "scatter_cpu_s": cost}
    # Both see the same light: the share of it beside the line is a check of the peer's scene.
    found["share_beside"] = {
        "peer": float((one + two)[~line].sum() / (one + two).sum()),
        "ours": float(full[0][~line].sum() / full[0].sum()),
    }
    for name, where in (("image", np.ones_like(line)), ("beside", ~line)):
        own = np.sqrt(max(squared_error(ours[where], full[0][where], full[1][where]), 0.0))
        noise = _error(one, two, where)
        needed = samples * (noise / EPSILON) ** 2
        peer_s = 0.5 * (first + second) * needed / samples
        found[name] = {
            "scatter_epsilon": float(own), "peer_epsilon": noise, "peer_paths_per_pixel": needed, "peer_cpu_s": peer_s,
            "ratio": peer_s / cost, "met": bool(own <= EPSILON and peer_s / cost >= GOAL),
        }  # fmt: skip
    return found


def main(argv: Sequence[str] | None = None) -> int:
    """Command line of the comparison."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a small image and few paths: a smoke test")
    options = parser.parse_args(argv)
    result = measured(32, 24, samples=16, reference=0.05) if options.quick else measured()
    print(json.dumps(result, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
