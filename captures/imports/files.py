"""The readers by the ending of a file's name."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path

from ...scenes.errors import InputError
from .recording import Recording, reading

__all__ = ["GEOMETRY", "READERS", "read_recording"]

#: Ending -> (what it is, "module:function" of this folder).
READERS: dict[str, tuple[str, str]] = {
    ".png": ("PNG", "pictures:read_png"),
    ".tif": ("TIFF", "pictures:read_picture"),
    ".tiff": ("TIFF", "pictures:read_picture"),
    ".exr": ("EXR", "pictures:read_picture"),
    ".fits": ("FITS", "fits:read_fits"),
    ".fit": ("FITS", "fits:read_fits"),
    ".fts": ("FITS", "fits:read_fits"),
    ".h5": ("HDF5", "hdf5:read_hdf5"),
    ".hdf5": ("HDF5", "hdf5:read_hdf5"),
    ".npy": ("NPY", "numpy_files:read_npy_file"),
    ".npz": ("NPZ", "numpy_files:read_npz_file"),
    ".mat": ("MAT", "mat:read_mat"),
    ".sif": ("Andor SIF", "sif:read_sif"),
    ".spe": ("SPE", "spe:read_spe"),
    ".trc": ("LeCroy", "trc:read_trc"),
    ".csv": ("CSV", "table:read_csv"),
    ".txt": ("CSV", "table:read_csv"),
}
#: Endings of surfaces, which are targets of scenes and no captures.
GEOMETRY = (".obj", ".ply", ".stl", ".off", ".glb", ".gltf", ".3mf", ".gz")


def read_recording(path: Path) -> Recording:
    """Read a file by the ending of its name; at most 1 GiB of arrays.

    Raises:
        InputError: absent, of an unknown kind, damaged, too large, or of a surface.
    """
    ending = path.suffix.lower()
    if ending in GEOMETRY:
        raise InputError(
            "This is a surface, not a capture: it can be the target of a scene.", where=str(path),
            allowed=", ".join(sorted(READERS)),
            next_step='[[target]] shape = { kind = "mesh", file = … } in a scene file (docs/importing.md)',
        )  # fmt: skip
    if ending not in READERS:
        raise InputError(
            "Files of this kind are not read.", where=str(path), value=ending or "no ending",
            allowed=", ".join(sorted(READERS)),
        )  # fmt: skip
    what, home = READERS[ending]
    module, _, name = home.partition(":")
    read: Callable[[Path], Recording] = getattr(import_module(f".{module}", __package__), name)
    return reading(read, path, what)
