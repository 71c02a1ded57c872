"""Periodic structure finer than a pixel: centre rays all hit the same part of it, and must not decide."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from beambench.generator.gated import direct as module
from beambench.generator.gated.direct import render_direct
from beambench.scenes.load import load_scene
from beambench.scenes.rigs.gated import gated_rig
from beambench.scenes.scene import Scene

SIZE, PITCH = 12, 0.02  # tangent of the angle between pixels
SMALL: dict[str, Any] = {
    "rig.camera.rows": SIZE, "rig.camera.cols": SIZE, "rig.camera.pixel_pitch_m": PITCH * 0.01,
    "rig.camera.focal_length_m": 0.01,
    # An even beam, so that slats are all that changes over a pixel.
    "rig.laser.illumination": {"profile": "flat-top", "half_angle_rad": 0.6, "offset_rad": [0.0, 0.0]},
}  # fmt: skip


def slats(share: float, offset: float, behind_m: float = 6.0, behind: float = 0.0) -> Scene:
    """One slat per column at 4.7 m that covers `share` of its pixels, `offset` pixels beside their middle, and a wall."""
    flat = {"kind": "rectangle", "tilt_x_deg": 0.0, "tilt_y_deg": 0.0}
    step = PITCH * 4.7
    target = [
        {
            "name": f"slat{k}", "material": {"kind": "lambert", "albedo": 0.5},
            "shape": flat | {"center_m": [(k - SIZE / 2 - 0.5 + offset) * step, 0.0, 4.7], "width_m": share * step,
                             "height_m": 4.0},
        }
        for k in range(SIZE + 2)
    ]  # fmt: skip
    wall = flat | {"center_m": [0.0, 0.0, behind_m], "width_m": 6.0, "height_m": 6.0}
    target.append({"name": "wall", "material": {"kind": "lambert", "albedo": behind}, "shape": wall})
    return load_scene("flat-wall", SMALL | {"target": target})


def light(scene: Scene, rtol: float) -> np.ndarray[Any, Any]:
    return np.asarray(render_direct(scene, rtol).truth["truth_amplitude"], dtype=float)


@pytest.mark.parametrize(("share", "offset"), [(0.4, 0.1), (0.4, -0.15), (0.7, 0.2)])
def test_slats_in_every_pixel_are_not_taken_for_a_wall(share: float, offset: float) -> None:
    """Every centre ray meets a slat, and sees a wall of slats; the light is the share of it. The error is what was asked for: of
    a hundredth and of a thousandth, rms over pixels, twice that allowed; pixels at 45 mrad and cos⁴ within a pixel are the rest."""
    scene, wall = slats(share, offset), load_scene(
        "flat-wall",
        SMALL | {"target.0.shape.center_m": [0.0, 0.0, 4.7], "target.0.shape.width_m": 6.0,
                 "target.0.shape.height_m": 6.0, "target.0.material.albedo": 0.5},
    )  # fmt: skip
    whole = light(wall, 1e-4)
    for rtol in (1e-2, 1e-3):
        error = light(scene, rtol) / (share * whole) - 1.0
        assert np.sqrt(np.mean(error**2)) < 2.0 * rtol + 1e-3, rtol


def test_slats_as_bright_as_the_wall_behind_them_show_by_their_time() -> None:
    """A wall behind, as bright as the slats: brightness carries no information; half of the light must arrive later."""
    scene = slats(0.5, 0.1, 6.0, 0.5 * (6.0 / 4.7) ** 2)
    found = render_direct(scene, 1e-3)
    r = found.returns
    late = r.tau > 2 * 5.3 / 299_792_458.0
    assert r.amplitude[late].sum() / r.amplitude.sum() == pytest.approx(0.5, abs=2e-3)


def test_where_nothing_recurs_nothing_changes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Equal rays and bits with and without the probes, on scenes of the library."""
    for name in ("relief-tank", "sphere", "step"):
        scene = load_scene(name, {"rig.camera.rows": 48, "rig.camera.cols": 48})
        assert gated_rig(scene).camera.rows == 48
        with_probes = render_direct(scene, 3e-3)
        with monkeypatch.context() as patch:
            patch.setattr(module, "_recurring_error", lambda *told: 0.0)
            without = render_direct(scene, 3e-3)
        assert with_probes.rays == without.rays
        assert with_probes.returns.tau.tobytes() == without.returns.tau.tobytes()
