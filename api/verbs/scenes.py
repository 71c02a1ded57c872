"""`beambench scenes list`, `beambench scenes show` and `beambench scenes preview`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..scenes.scene import Scene

__all__ = ["scenes_list", "scenes_preview", "scenes_show"]


def scenes_list() -> list[dict[str, Any]]:
    """The scenes of the library: name, title, modality, image size and number of slices."""
    from ..scenes.load import list_scenes, load_scene
    from ..scenes.scene import sizes_of

    listed = []
    for name in list_scenes():
        scene = load_scene(name)
        slices, rows, cols = sizes_of(scene)
        listed.append(
            {
                "name": name,
                "title": scene.title,
                "modality": scene.modality,
                "rows": rows,
                "cols": cols,
                "slices": slices,
                "objects": len(scene.target),
                "medium": scene.medium.name,
            }
        )
    return listed


def scenes_show(scene: str | Path | Mapping[str, Any] | Scene, *, overrides: Mapping[str, Any] | None = None) -> Scene:
    """The scene as validated, with every value that `overrides` can set.

    Main arguments:
        scene: a name in the library, a path to a .toml or .json file, plain data, or a Scene.
        overrides: {path: value}, applied before validation.

    Raises:
        InputError: no such scene, an unknown key, a missing or impossible value.
    """
    from ..scenes.load import load_scene

    return load_scene(scene, overrides)


def scenes_preview(
    scene: str | Path | Mapping[str, Any] | Scene,
    *,
    overrides: Mapping[str, Any] | None = None,
    size: int = 640,
    out: str | Path | None = None,
    overwrite: bool = False,
) -> dict[str, Any]:
    """Draw a scene into a PNG file in sRGB: room light, and the laser in the colour of its wavelength.

    Main arguments:
        scene: as for `scenes_show`.
        out: the file, which must end in .png; by default a fresh folder under ./beambench-runs holds it.
    Other arguments:
        size: pixels of the picture's longer side, 16 … 8192.
        overwrite: replace the file.

    Returns `file`, `rows`, `cols`, `target_share` of the view, `laser_nm`, `laser_visible` and `laser_rgb` (linear sRGB).

    Raises:
        InputError: pyrender (extra `preview`) or EGL is missing, a bad size or file name, or as `scenes_show`.
    """
    from ..benchmarks.folders.files import write_atomic
    from ..output import claim, is_picture, slug
    from ..scenes.errors import InputError

    if not 16 <= size <= 8192:
        raise InputError("A picture has no such size.", where="size", value=size, allowed="16 … 8192")
    if out is not None and Path(out).suffix.lower() != ".png":
        raise InputError("A preview is a PNG file.", where="out", value=str(out), allowed="a name that ends in .png")
    loaded = scenes_show(scene, overrides=overrides)
    name = slug(loaded.name)
    path = claim(out, name, overwrite=overwrite, ours=is_picture)
    from ..generator.preview.picture import preview

    drawn = preview(loaded, size)
    image = _png(drawn.picture)
    if out is None:
        path.mkdir()
        path = path / f"{name}.png"

    def write(partial: Path) -> None:
        partial.write_bytes(image)

    write_atomic(path, write)
    return {
        "file": str(path),
        "rows": drawn.picture.shape[0],
        "cols": drawn.picture.shape[1],
        "target_share": drawn.seen,
        "laser_nm": round(loaded.rig.wavelength_m * 1e9, 3),
        "laser_visible": drawn.visible,
        "laser_rgb": list(drawn.laser_rgb),
    }


def _png(picture: Any) -> bytes:
    """A PNG file in sRGB (ISO 15948), rows filtered as differences to the row above. It is encoded in memory: a library
    that writes the file itself does not tell when the disk is full at its end."""
    import struct
    import zlib

    import numpy as np

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    rows, cols, channels = picture.shape
    lines = np.asarray(picture, np.uint8).reshape(rows, cols * channels)
    filtered = np.full((rows, 1 + cols * channels), 2, np.uint8)
    filtered[:, 1:] = np.diff(lines, axis=0, prepend=np.zeros_like(lines[:1]))  # modulo 256, as the filter is
    header = struct.pack(">IIBBBBB", cols, rows, 8, {1: 0, 2: 4, 3: 2, 4: 6}[channels], 0, 0, 0)
    parts = ((b"IHDR", header), (b"sRGB", b"\0"), (b"IDAT", zlib.compress(filtered.tobytes(), 9)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunk(kind, data) for kind, data in parts)
