"""`beambench scenes list`, `show`, `preview` and `new`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..scenes.scene import Scene

__all__ = ["scenes_list", "scenes_new", "scenes_preview", "scenes_show"]

_HEAD = """A scene: target, medium, rig. Look at it: beambench scenes preview {file}    Make a capture: beambench generate {file}
Every key, with unit and range, is in the documentation, "Scene files". No physical value has a default."""


def scenes_list() -> list[dict[str, Any]]:
    """List the scenes of the library.

    Returns:
        One record per scene: name, title, modality, size, number of objects, and medium.
    """
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
    """Print a scene in full, as validated, in JSON: a start for a scene file of your own.

    Main arguments:
        scene: Name of a scene of the library, or a .toml or .json file; in Python also a scene as data.
        overrides: {path: value}, applied before validation.

    Returns:
        The scene, with every value that `overrides` can set.

    Raises:
        InputError: No such scene, an unknown key, a missing or impossible value, or a mesh, grid or texture that cannot be used.
    """
    from ..scenes.load import load_scene
    from ..scenes.whole import check_whole

    loaded = load_scene(scene, overrides)
    check_whole(loaded)
    return loaded


def scenes_new(name: str, *, like: str = "flat-wall", out: str | Path | None = None, overwrite: bool = False) -> Path:
    """Write the file of a scene of your own, begun from one of the library, with its comments.

    Main arguments:
        name: Name of the new scene.
    Other arguments:
        like: Scene of the library that it begins from.
        out: The file; ./<name>.toml by default.
        overwrite: Replace an existing file.

    Returns:
        The path of the file.

    Raises:
        InputError: A bad name, no such scene, or a file that exists.
    """
    from ..scenes.load import list_scenes
    from ..scenes.spec_files import LIBRARY
    from .new_file import write_new

    return write_new(name, "scene", "name", LIBRARY, list_scenes(), like, out, overwrite, _HEAD)


def scenes_preview(
    scene: str | Path | Mapping[str, Any] | Scene,
    *,
    overrides: Mapping[str, Any] | None = None,
    size: int = 640,
    out: str | Path | None = None,
    overwrite: bool = False,
) -> dict[str, Any]:
    """Draw a scene as a person beside the camera would see it: room light, and the laser in its colour.

    The picture is a PNG file in sRGB. It needs pyrender (extra `preview`).

    Main arguments:
        scene: Name of a scene of the library, or a .toml or .json file; in Python also a scene as data.
        overrides: {path: value}, applied before validation.
    Other arguments:
        size: Pixels of the picture's longer side, 16 to 8192.
        out: The file, which must end in .png; by default it lies in ./beambench-runs/<name>-<time>.
        overwrite: Replace an existing picture.

    Returns:
        `file`, `rows`, `cols`, `target_share` (of the view), `laser_nm`, `laser_visible` and `laser_rgb` (linear sRGB).

    Raises:
        InputError: pyrender or EGL is missing, a bad size or file name, or as for `scenes_show`.
    """
    from ..benchmarks.folders.files import write_atomic
    from ..generator.preview.png import png
    from ..output import claim, is_picture, slug
    from ..scenes.errors import InputError

    if not 16 <= size <= 8192:
        raise InputError("A picture cannot have this size.", where="size", value=size, allowed="16 to 8192")
    if out is not None and Path(out).suffix.lower() != ".png":
        raise InputError("A preview is a PNG file.", where="out", value=str(out), allowed="a name that ends in .png")
    loaded = scenes_show(scene, overrides=overrides)
    name = slug(loaded.name)
    path = claim(out, name, overwrite=overwrite, ours=is_picture)
    from ..generator.preview.picture import preview

    drawn = preview(loaded, size)
    image = png(drawn.picture)
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
