"""A mesh file of any kind that is read, packed by gzip or not, with the files that it names."""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Callable
from pathlib import Path

from ..errors import InputError, reason
from .gltf import read_gltf
from .gltf_data import outside_files
from .obj import read_obj
from .off import read_off
from .ply import read_ply
from .stl import read_stl
from .surface import Fetch, Surface
from .threemf import read_3mf

__all__ = ["read_mesh_file", "side_files"]

_READERS: dict[str, Callable[[bytes, Fetch], Surface]] = {
    ".obj": read_obj,
    ".ply": read_ply,
    ".stl": read_stl,
    ".off": read_off,
    ".glb": read_gltf,
    ".gltf": read_gltf,
    ".3mf": read_3mf,
}
#: Most bytes that a packed file may unpack to: 2^26, or more where it is packed by less than this factor (meshes: 3 to 30).
_MOST_BYTES, _MOST_PACKED, _FACTOR = 2**31, 2**26, 64


def read_mesh_file(path: Path, where: str) -> Surface:
    """The triangles of a mesh file, just as it has them.

    Raises:
        InputError: another kind of file, not as its standard has it, or something that is not read; with the reason.
    """
    kind = _kind(path)
    if kind not in _READERS:
        raise InputError(
            "Beambench does not read this kind of mesh file.",
            where=where,
            value=path.name,
            allowed=f"{', '.join(_READERS)}, each also as .gz",
            next_step="convert it, for example to .ply",
        )
    try:
        return _READERS[kind](_content(path), lambda name: _beside(path, name).read_bytes())
    except (
        ValueError,
        TypeError,
        KeyError,
        IndexError,
        AttributeError,
        ArithmeticError,
        OSError,
        RecursionError,
    ) as error:
        # A reader tells what is wrong by a ValueError; the others come of documents whose parts are of a wrong type.
        told = reason(error) if isinstance(error, ValueError | OSError) else f"a part is of the wrong form ({error!r})"
        raise InputError("The mesh cannot be read.", where=where, value=f"{path.name}: {told}") from error


def side_files(path: Path) -> list[Path]:
    """The files beside a mesh file that hold its numbers, such as the .bin of a .gltf; those that are there."""
    if _kind(path) not in (".gltf", ".glb"):
        return []
    try:
        return [_beside(path, name) for name in dict.fromkeys(outside_files(_content(path)))]
    except (ValueError, OSError):
        return []  # the reader tells what is wrong


def _kind(path: Path) -> str:
    suffix = path.suffix.lower()
    return Path(path.stem).suffix.lower() if suffix == ".gz" else suffix


def _content(path: Path) -> bytes:
    """The bytes of a file, unpacked with a bound on their number (a small file can unpack to a huge one)."""
    if path.suffix.lower() != ".gz":
        return path.read_bytes()
    most = min(_MOST_BYTES, max(_MOST_PACKED, _FACTOR * path.stat().st_size))
    try:
        with gzip.open(path, "rb") as stream:
            content = stream.read(most + 1)
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise ValueError(f"it cannot be unpacked: {error}") from error
    if len(content) > most:
        raise ValueError(f"its {path.stat().st_size:,} bytes unpack to more than {most:,}")
    return content


def _beside(path: Path, name: str) -> Path:
    """A file that a mesh file names: in its folder or below, links followed."""
    folder = path.resolve().parent
    if "://" in name or "\0" in name or not name:
        raise ValueError(f"it names {name[:80]!r}, which is no file in its folder")
    found = (folder / name).resolve()
    if not found.is_relative_to(folder):
        raise ValueError(f"it names {name[:80]!r}, which does not lie in its folder")
    if not found.is_file():
        raise ValueError(f"it names {name[:80]!r}, which is not there")
    return found
