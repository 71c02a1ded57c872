"""Textured albedo: its position on every kind of surface, its effect on echoes and truth, and invalid files."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beambench.cli import main
from beambench.generator.generate import capture_key_of, generate
from beambench.generator.rays.trace import Tracer, pixel_directions
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene
from beambench.scenes.meshes import load_grid
from beambench.scenes.rigs.gated import gated_rig
from beambench.scenes.scene import Scene
from beambench.scenes.spec_files import LIBRARY
from beambench.scenes.textures import Texture, bilinear, load_texture

RAMP = np.linspace(0.1, 0.9, 64)[None, :] * np.linspace(1.0, 0.5, 48)[:, None]
SMALL = {
    "rig.camera.rows": 24,
    "rig.camera.cols": 32,
    "rig.delays.count": 6,
    "rig.delays.start_s": 18e-9,
    "rig.delays.step_s": 5e-10,
}


@pytest.fixture
def ramp(tmp_path: Path) -> dict[str, Any]:
    np.save(tmp_path / "ramp.npy", RAMP)
    return {"file": str(tmp_path / "ramp.npy"), "encoding": "linear"}


def wall(texture: dict[str, Any] | None, **changes: Any) -> Scene:
    item = load_scene("flat-wall").target[0].model_dump(mode="json")
    item["shape"] |= {"width_m": 2.0, "height_m": 1.5, "tilt_y_deg": 20.0, "center_m": [0.1, -0.05, 3.0]}
    item |= {} if texture is None else {"texture": texture}
    return load_scene("flat-wall", SMALL | {"target": [item]} | {k.replace("__", "."): v for k, v in changes.items()})


def trace(scene: Scene) -> tuple[Any, np.ndarray]:
    camera = gated_rig(scene).camera
    direction = pixel_directions(camera, *(a.ravel() for a in np.mgrid[: camera.rows, : camera.cols]))
    hits = Tracer(scene).trace((0.0, 0.0, 0.0), direction)
    return hits, direction * np.where(hits.target >= 0, hits.distance, 1.0)


def ramp_at(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """The texture's own formula: bilinear, so that bilinear interpolation is exact within the outermost texel centres."""
    x, y = np.clip(u * 64 - 0.5, 0, 63) / 63, np.clip(v * 48 - 0.5, 0, 47) / 47
    return np.asarray((0.1 + 0.8 * x) * (1.0 - 0.5 * y))


def test_bilinear_is_exact_for_planes_and_closes_around() -> None:
    u, v = np.random.default_rng(0).uniform(0, 1, (2, 500))
    np.testing.assert_allclose(bilinear(RAMP, u, v), ramp_at(u, v), atol=1e-12)
    image = np.array([[0.0, 1.0, 0.5, 0.25]])
    assert bilinear(image, np.array([1.0]), np.array([0.5]))[0] == 0.25
    assert bilinear(image, np.array([1.0]), np.array([0.5]), around=True)[0] == pytest.approx(0.125)
    assert bilinear(image, np.array([0.0]), np.array([0.5]), around=True)[0] == pytest.approx(0.125)


def test_a_rectangle_shows_it_as_an_untilted_camera_would(ramp: dict[str, Any]) -> None:
    hits, point = trace(wall(ramp))
    mine = hits.target == 0
    assert mine.sum() > 100
    # By hand: along the tilted width (turned about y by 20°) and down the height.
    along = np.array([np.cos(np.radians(20.0)), 0.0, -np.sin(np.radians(20.0))])
    offset = point[:, mine] - np.array([[0.1], [-0.05], [3.0]])
    u, v = along @ offset / 2.0 + 0.5, offset[1] / 1.5 + 0.5
    # float32 hits: 1e-6 m of 2 m, times 64 texels of .013.
    np.testing.assert_allclose(hits.shade[mine], ramp_at(u, v), atol=1e-5)
    assert (hits.shade[~mine] == 1.0).all()


def test_a_relief_shows_it_over_its_grid(ramp: dict[str, Any]) -> None:
    item = load_scene("relief-tank").target[0].model_dump(mode="json") | {"texture": ramp}
    scene = load_scene("relief-tank", {"target": [item], "rig.camera.rows": 24, "rig.camera.cols": 32})
    hits, point = trace(scene)
    mine = hits.target == 0
    rows, cols = load_grid("library:relief.npz", "test").shape
    height = 1.5 * (rows - 1) / (cols - 1)
    np.testing.assert_allclose(
        hits.shade[mine], ramp_at(point[0, mine] / 1.5 + 0.5, point[1, mine] / height + 0.5), atol=1e-5
    )


def test_a_sphere_wears_it_with_its_middle_to_the_camera(ramp: dict[str, Any]) -> None:
    item = load_scene("sphere").target[0].model_dump(mode="json") | {"texture": ramp}
    scene = load_scene(
        "sphere", {"target": [item], "rig.camera.rows": 41, "rig.camera.cols": 41, "rig.camera.focal_length_m": 4e-3}
    )
    hits, point = trace(scene)
    mine = hits.target == 0
    assert mine.sum() > 30
    x, y, z = (point[:, mine] - np.array([[0.0], [0.0], [4.7]])) / 0.3
    longitude, polar = np.arctan2(x, -z), np.arccos(np.clip(-y, -1, 1))
    np.testing.assert_allclose(hits.shade[mine], ramp_at(0.5 + longitude / (2 * np.pi), polar / np.pi), atol=2e-4)
    middle = np.argmin(np.hypot(x, y))
    assert hits.shade[mine][middle] == pytest.approx(ramp_at(np.array([0.5]), np.array([0.5]))[0], abs=0.02)


def test_a_mesh_brings_its_own_coordinates(ramp: dict[str, Any], tmp_path: Path) -> None:
    file = tmp_path / "plate.obj"
    # y of the file points down in the camera's frame, v of the file up: vt 1 is the picture's top.
    file.write_text(
        "v -1 -0.75 0\nv 1 -0.75 0\nv 1 0.75 0\nv -1 0.75 0\nvt 0 1\nvt 1 1\nvt 1 0\nvt 0 0\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\n"
    )
    shape = {
        "kind": "mesh",
        "file": str(file),
        "size_m": 2.0,
        "center_m": [0.1, -0.05, 3.0],
        "rotation_deg": [0.0, 20.0, 0.0],
    }
    plate = wall(ramp, target__0__shape=shape)
    one, two = trace(plate)[0], trace(wall(ramp))[0]
    np.testing.assert_array_equal(one.target, two.target)
    np.testing.assert_allclose(one.shade, two.shade, atol=1e-5)
    plain = tmp_path / "plain.obj"
    plain.write_text("\n".join(line.split("/")[0] if line.startswith("vt") else line for line in
                               ["v -1 -1 0", "v 1 -1 0", "v 1 1 0", "f 1 2 3"]) + "\n")  # fmt: skip
    with pytest.raises(InputError, match="no texture coordinates"):
        trace(wall(ramp, target__0__shape=shape | {"file": str(plain)}))


@pytest.mark.parametrize(
    ("material", "diffuse"),
    [
        ({"kind": "lambert", "albedo": 0.5}, 0.5),
        ({"kind": "phong", "diffuse_albedo": 0.4, "specular_albedo": 0.3, "exponent": 8.0}, 0.4),
        ({"kind": "cook-torrance", "diffuse_albedo": 0.3, "f0": 0.05, "roughness": 0.3, "distribution": "ggx"}, 0.3),
        ({"kind": "chua", "k_s": 0.05, "k_d": 0.1, "slope": 0.2, "diffusivity": 1.0, "convention": "brdf"}, None),
    ],
)
def test_it_scales_the_diffuse_part_of_echo_and_truth(
    material: dict[str, Any], diffuse: float | None, tmp_path: Path
) -> None:
    even = {"file": str(tmp_path / "even.npy"), "encoding": "linear"}
    np.save(tmp_path / "even.npy", np.full((4, 4), 0.25))
    name = {"lambert": "albedo", "chua": "k_d"}.get(material["kind"], "diffuse_albedo")
    painted = generate(wall(even, target__0__material=material), seed=1, capture_key=1, truth_electrons=True)
    mixed = generate(
        wall(None, target__0__material=material | {name: 0.25 * material[name]}),
        seed=1,
        capture_key=1,
        truth_electrons=True,
    )
    # An even texture of 1/4 is the material with a quarter of its diffuse albedo, to rounding.
    np.testing.assert_allclose(painted["truth_electrons"], mixed["truth_electrons"], rtol=1e-5)
    np.testing.assert_allclose(painted["truth_albedo"], mixed["truth_albedo"], rtol=1e-5)
    assert diffuse is None or float(np.nanmax(painted["truth_albedo"])) < diffuse + 0.4


def test_truth_albedo_is_the_textures(ramp: dict[str, Any]) -> None:
    scene = wall(ramp)
    capture = generate(scene, seed=1)
    hits, _ = trace(scene)
    expected = np.where(hits.target >= 0, 0.5 * hits.shade, np.nan).reshape(24, 32)
    np.testing.assert_allclose(capture["truth_albedo"].values, expected, rtol=1e-6)
    counter = load_scene("counter", {"target.0.texture": ramp, "rig.record.shots": 2})
    plain = load_scene("counter", {"rig.record.shots": 2})
    share = generate(counter, seed=1)["truth_amplitude"] / generate(plain, seed=1)["truth_amplitude"]
    # Two shots at ∓.25 rad on a wall 8 m wide at 4 m, mid height.
    u = 0.5 + np.array([-1.0, 1.0]) * 4.0 * np.tan(0.25) / 8.0
    np.testing.assert_allclose(share, ramp_at(u, np.array([0.5, 0.5])), rtol=2e-3)


def test_a_scene_without_texture_reads_as_before(ramp: dict[str, Any]) -> None:
    plain = wall(None)
    assert "texture" not in plain.model_dump(mode="json")["target"][0]
    assert capture_key_of(plain) != capture_key_of(wall(ramp))
    again = Scene.model_validate_json(wall(ramp).model_dump_json())
    assert again == wall(ramp)


def test_png_files_and_their_encoding(tmp_path: Path) -> None:
    import OpenImageIO as oiio

    def write(name: str, pixels: np.ndarray) -> str:
        out = oiio.ImageOutput.create(str(tmp_path / name))
        channels = pixels.shape[2] if pixels.ndim == 3 else 1
        kind = "uint16" if pixels.dtype == np.uint16 else "uint8"
        out.open(str(tmp_path / name), oiio.ImageSpec(pixels.shape[1], pixels.shape[0], channels, kind))
        out.write_image(pixels.reshape(pixels.shape[0], pixels.shape[1], channels))
        out.close()
        return str(tmp_path / name)

    grey = write("grey.png", np.array([[0, 128, 255]] * 2, dtype=np.uint8))
    linear = load_texture(Texture(file=grey, encoding="linear"), "t")
    np.testing.assert_allclose(linear[0], [0, 128 / 255, 1], atol=1e-6)
    srgb = load_texture(Texture(file=grey, encoding="srgb"), "t")
    np.testing.assert_allclose(srgb[0], [0, 0.2158605, 1], atol=1e-6)
    deep = write("deep.png", np.array([[0, 32768, 65535]] * 2, dtype=np.uint16))
    np.testing.assert_allclose(
        load_texture(Texture(file=deep, encoding="linear"), "t")[0], [0, 32768 / 65535, 1], atol=1e-6
    )
    coloured = write("rgb.png", np.zeros((2, 3, 3), dtype=np.uint8))
    with pytest.raises(InputError, match="one channel"):
        load_texture(Texture(file=coloured, encoding="linear"), "t")
    (tmp_path / "broken.png").write_bytes(b"\x89PNG\r\n\x1a\nnothing")
    with pytest.raises(InputError, match="cannot be read"):
        load_texture(Texture(file=str(tmp_path / "broken.png"), encoding="linear"), "t")


@pytest.mark.parametrize("interlaced", [False, True])
@pytest.mark.parametrize(("samples", "colour", "bits"), [(1, 0, 8), (1, 0, 16)])
def test_a_damaged_picture_is_refused(
    ramp: dict[str, Any], tmp_path: Path, samples: int, colour: int, bits: int, interlaced: bool
) -> None:
    """libpng gives black rows after the damage: a cut file, a flipped bit, a lost end, a missing row."""
    import struct
    import zlib

    def part(name: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))

    rows = cols = 16
    grids = [(range(r, rows, dr), range(c, cols, dc)) for r, c, dr, dc in (
        ((0, 0, 8, 8), (0, 4, 8, 8), (4, 0, 8, 4), (0, 2, 4, 4), (2, 0, 4, 2), (0, 1, 2, 2), (1, 0, 2, 1))
        if interlaced else ((0, 0, 1, 1),)
    )]  # fmt: skip
    pixel = bits // 8 * samples
    lines = [
        b"\0" + bytes((7 * row + col) % 251 for col in range(pixel * len(across)))
        for down, across in grids
        for row in down
    ]
    head = part(b"IHDR", struct.pack(">IIBBBBB", cols, rows, bits, colour, 0, 0, int(interlaced)))
    start, end = b"\x89PNG\r\n\x1a\n", part(b"IEND", b"")
    data = zlib.compress(b"".join(lines))
    whole = start + head + part(b"IDAT", data[:20]) + part(b"IDAT", data[20:]) + end
    file = tmp_path / "p.png"
    spec = Texture(file=str(file), encoding="linear")
    file.write_bytes(whole)
    assert load_texture(spec, "test").shape == (rows, cols)
    flipped = bytearray(whole)
    flipped[len(start + head) + 12] ^= 1
    for damaged in (
        whole[: len(whole) // 2], bytes(flipped), whole[:-12], whole[:-1], start,
        start + head + part(b"IDAT", zlib.compress(b"".join(lines[:-1]))) + end,
        start + head + part(b"IDAT", data[:-4]) + end, start + head + part(b"IDAT", b"\0" + data[1:]) + end, start + head + end,
    ):  # fmt: skip
        file.write_bytes(damaged)
        with pytest.raises(InputError):
            load_texture(spec, "test")


def test_bad_textures_are_refused(ramp: dict[str, Any], tmp_path: Path) -> None:
    np.save(tmp_path / "bright.npy", np.full((3, 3), 1.5))
    np.save(tmp_path / "flat.npy", np.zeros(3))
    for bad, says in (
        ({"file": str(tmp_path / "bright.npy")}, "relative albedo"), ({"file": str(tmp_path / "flat.npy")}, "grid of numbers"),
        ({"file": str(tmp_path / "none.npy")}, "no such file"), ({"encoding": "srgb"}, "linear"),
        ({"file": "library:../relief.npz"}, "named without folders"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=says):
            Tracer(wall(ramp | bad))
    with pytest.raises(InputError, match="one of"):
        wall(ramp | {"file": "x.exr"})
    box = {"kind": "box", "center_m": [0.0, 0.0, 3.0], "size_m": [1.0, 1.0, 1.0], "rotation_deg": [0.0, 0.0, 0.0]}
    with pytest.raises(InputError, match="box"):
        wall(ramp, target__0__shape=box)


def test_a_scene_files_texture_lies_beside_it_and_cannot_escape(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "scene"
    (folder / "maps").mkdir(parents=True)
    np.save(folder / "maps" / "a.npy", RAMP)
    np.save(tmp_path / "outside.npy", RAMP)
    (folder / "link.npy").symlink_to(tmp_path / "outside.npy")
    data = tomllib.loads((LIBRARY / "flat-wall.toml").read_text())

    def told(name: str) -> int:
        data["target"][0]["texture"] = {"file": name, "encoding": "linear"}
        (folder / "wall.json").write_text(json.dumps(data))
        small = ["--set", "rig.camera.rows=8", "--set", "rig.camera.cols=8", "--set", "rig.delays.count=2"]
        return main(["generate", str(folder / "wall.json"), *small, "-o", str(tmp_path / "out.zarr"), "--overwrite"])

    assert told("maps/a.npy") == 0
    for bad in ("../outside.npy", str(tmp_path / "outside.npy"), "link.npy", "maps/../../outside.npy"):
        assert told(bad) == 2, bad
        assert "of a scene file should lie in its folder" in capsys.readouterr().err
    assert told("maps/none.npy") == 2 and "no such file" in capsys.readouterr().err
