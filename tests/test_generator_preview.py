"""The second renderer: a reference for depth and visibility in air, and previews in the colours of their spectra."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beambench.cli import main
from beambench.generator.gated.direct import render_direct
from beambench.optics import colorimetry
from beambench.scenes.load import load_scene
from beambench.scenes.rigs.gated import gated_rig
from beambench.scenes.scene import Scene

pytestmark = pytest.mark.skipif(importlib.util.find_spec("pyrender") is None, reason="pyrender is not installed")

#: Rasterisers snap vertices to 1/256 of a pixel.
SNAP_PX = 1 / 256


def torus(tmp_path: Path) -> Scene:
    """A mesh with a hole, which hides parts of itself, before a tilted wall."""
    import trimesh

    file = tmp_path / "torus.ply"
    trimesh.creation.torus(0.3, 0.12, major_sections=96, minor_sections=48).export(file)
    mesh = {
        "kind": "mesh",
        "file": str(file),
        "size_m": 1.1,
        "center_m": [0.1, 0.05, 4.2],
        "rotation_deg": [50.0, 20.0, 0.0],
    }
    wall = load_scene("tilted-wall").target[0].model_dump(mode="json")
    grey = {"kind": "lambert", "albedo": 0.5}
    changes = {"target": [wall, {"name": "ring", "shape": mesh, "material": grey}]}
    return load_scene("tilted-wall", changes | {"rig.camera.rows": 96, "rig.camera.cols": 128})


def box() -> Scene:
    shape = {"kind": "box", "center_m": [-0.2, 0.1, 4.0], "size_m": [0.6, 0.4, 0.5], "rotation_deg": [20.0, 35.0, 10.0]}
    wall = load_scene("flat-wall").target[0].model_dump(mode="json")
    item = {"name": "box", "shape": shape, "material": {"kind": "lambert", "albedo": 0.4}}
    return load_scene("flat-wall", {"target": [wall, item], "rig.camera.rows": 101, "rig.camera.cols": 80})


@pytest.mark.parametrize("name", ["tilted-wall", "step", "sphere", "object1", "panel", "relief-tank", "box", "torus"])
def test_an_independent_rasteriser_sees_the_same_surfaces_at_the_same_depth(name: str, tmp_path: Path) -> None:
    from beambench.generator.preview.raster import RasterView, rasterise

    scene = torus(tmp_path) if name == "torus" else box() if name == "box" else load_scene(name)
    camera = gated_rig(scene).camera
    focal = camera.focal_length_m / camera.pixel_pitch_m
    theirs = rasterise(scene, RasterView(camera.rows, camera.cols, focal))
    truth = render_direct(scene, 0.1).truth
    depth, incidence, material = (np.asarray(truth[k]) for k in ("truth_depth", "truth_incidence", "truth_material"))
    # Which surface is in front: only pixels cut by an edge within the snapped 1/256 px may differ, some 1e-2 of those cut.
    assert np.mean(theirs.target == material) > 0.9998
    same = (theirs.target == material) & (material >= 0)
    error = np.abs(theirs.depth - depth)
    # Float32 on both sides and a 24-bit depth buffer: 2e-6 of the depth. The snap moves the hit by SNAP_PX along the
    # slope. A sphere's facets lie up to 1.9e-5 of its radius inside, more in depth where it is seen askew.
    slope = depth / focal * np.tan(np.minimum(incidence, 1.5)) * SNAP_PX
    inset = 1.9e-5 * 0.3 / np.cos(np.minimum(incidence, 1.5)) if name == "sphere" else 0.0
    allowed = 2e-6 * depth + slope + inset
    picture = np.where(same, depth, np.nan)
    padded = np.pad(picture, 1, mode="edge")
    jump = np.fmax.reduce(
        [np.abs(padded[1 + i : 1 + i + camera.rows, 1 + j : 1 + j + camera.cols] - picture)
         for i in (-1, 0, 1) for j in (-1, 0, 1)]
    )  # fmt: skip
    # A silhouette within one material hides behind itself; there one more pixel may see past it.
    calm = same & (jump < 0.05) & (incidence < 1.4)
    print(
        f"{name}: {calm.sum()} px, worst {error[calm].max():.2e} m, {float((error[calm] / allowed[calm]).max()):.2f} of allowed"
    )
    assert calm.sum() > 0.8 * same.sum()
    assert (error[calm] <= allowed[calm]).all()


def test_nothing_ahead_gives_an_empty_view() -> None:
    from beambench.generator.preview.raster import RasterView, rasterise

    shape = load_scene("flat-wall").target[0].shape.model_copy(update={"center_m": (0.0, 0.0, -3.0)})
    scene = load_scene("flat-wall")
    behind = scene.model_copy(update={"target": (scene.target[0].model_copy(update={"shape": shape}),)})
    seen = rasterise(behind, RasterView(8, 8, 10.0))
    assert (seen.target == -1).all() and np.isnan(seen.depth).all()


def test_the_laser_has_its_colour() -> None:
    green, red, blue = (colorimetry.linear_srgb_of_line(nm * 1e-9) for nm in (532, 640, 450))
    assert np.argmax(green) == 1 and np.argmax(red) == 0 and np.argmax(blue) == 2
    # Y of sRGB by its own primaries (IEC 61966-2-1) is the requested 1, inside and outside the gamut.
    for part in (green, red, blue):
        assert part @ [0.2126, 0.7152, 0.0722] == pytest.approx(1.0, abs=2e-3)
    wave, power = colorimetry.illuminant_spectrum("D65")
    # D65 is sRGB's own white; 5 nm tables against the rounded white point: 1e-2.
    np.testing.assert_allclose(colorimetry.linear_srgb_of_spectrum(wave, power), 1.0, atol=1e-2)
    assert colorimetry.encode_srgb([0.0, 0.21586050, 1.0]).tolist() == [0, 128, 255]
    for bad in (300e-9, 1064e-9):
        with pytest.raises(ValueError, match="is invisible"):
            colorimetry.linear_srgb_of_line(bad)


@pytest.mark.parametrize(("nm", "channel"), [(532, 1), (640, 0), (450, 2), (1064, None)])
def test_a_preview_is_a_picture_in_the_lasers_colour(
    nm: int, channel: int | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "step.png"
    words = ["scenes", "preview", "step", "-o", str(out), "--size", "96", "--set", f"rig.laser.wavelength_m={nm}e-9"]
    assert main([*words, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["rows"] == told["cols"] == 96 and told["laser_visible"] == (channel is not None)
    import OpenImageIO as oiio

    picture = oiio.ImageBuf(str(out)).get_pixels(oiio.UINT8)
    assert picture.shape == (96, 96, 3)
    middle = picture[40:56, 40:56].reshape(-1, 3).mean(axis=0)
    if channel is None:
        assert np.ptp(middle) < 3
    else:
        assert np.argmax(middle) == channel and middle[channel] > 1.5 * np.delete(middle, channel).max()
    assert main(words) == 2 and "exists" in capsys.readouterr().err
    assert main([*words, "--overwrite"]) == 0


@pytest.mark.parametrize("name", ["counter", "amcw", "panel"])
def test_every_modality_can_be_drawn(name: str) -> None:
    from beambench.generator.preview.picture import preview

    drawn = preview(load_scene(name), 64)
    assert drawn.picture.dtype == np.uint8 and max(drawn.picture.shape) == 64
    assert 0.1 < drawn.seen <= 1.0 and np.ptp(drawn.picture) > 50


def test_a_bistatic_laser_casts_a_shadow() -> None:
    from beambench.generator.preview.picture import preview

    aside: dict[str, Any] = {"rig.laser.position_m": [1.5, 0.0, 0.0], "rig.laser.illumination.half_angle_rad": 0.8}
    picture = preview(load_scene("sphere", aside), 128).picture.astype(int)
    level = picture[64, :, 1]
    # The sphere ends at columns 64 ± 20; the light comes from the right, so the shadow lies left of it.
    left, right = level[35:42].mean(), level[87:94].mean()
    assert left < 0.75 * right


def test_a_texture_is_seen(tmp_path: Path) -> None:
    from beambench.generator.preview.picture import preview

    np.save(tmp_path / "halves.npy", np.tile([1.0] * 8 + [0.0] * 8, (2, 1)))
    texture = {"file": str(tmp_path / "halves.npy"), "encoding": "linear"}
    picture = preview(load_scene("flat-wall", {"target.0.texture": texture}), 64).picture.astype(int)
    assert picture[32, 8, 1] > 150 and picture[32, 56, 1] < 60


@pytest.mark.parametrize(
    ("words", "says"),
    [(["--size", "5"], "size"), (["-o", "x.jpg"], "png"), (["--set", "rig.camera.row=3"], "rows")],
)
def test_bad_requests_are_told(words: list[str], says: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scenes", "preview", "step", *words]) == 2
    assert says in capsys.readouterr().err


def test_without_pyrender_the_extra_is_named(tmp_path: Path) -> None:
    """In a process of its own, in which an import of pyrender fails."""
    code = (
        "import sys\nsys.modules['pyrender'] = None\nfrom beambench.cli import main\n"
        "sys.exit(main(['scenes', 'preview', 'step', '-o', 'x.png']))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 2, done.stderr
    assert "pip install 'beambench[preview]'" in done.stderr and "Traceback" not in done.stderr


def test_without_a_display_library_the_package_is_named(tmp_path: Path) -> None:
    environment = os.environ | {"PYOPENGL_PLATFORM": "no-such-platform"}
    done = subprocess.run(
        [sys.executable, "-m", "beambench", "scenes", "preview", "step", "-o", "x.png"], cwd=tmp_path,
        capture_output=True, text=True, timeout=120, check=False, env=environment,
    )  # fmt: skip
    assert done.returncode == 2, done.stderr
    assert "libegl1" in done.stderr
