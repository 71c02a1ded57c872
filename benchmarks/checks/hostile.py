"""Hostile files: small ones that state, or unpack to, far too much, that lead elsewhere, or whose parts are of wrong types.

    python -m beambench.benchmarks.checks.hostile

Each is given to the command that reads it, in a process of its own. It holds if the command ends with exit code 2 and no
traceback within 60 seconds of CPU time and 4 GiB.
"""

from __future__ import annotations

import argparse
import gzip
import io
import json
import os
import resource
import struct
import subprocess
import sys
import tempfile
import time
import zipfile
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .attempts import Attempts, print_attempts
from .example_modalities import IMAGING

__all__ = ["CASES", "SCENE", "main"]

_MOST_S = 60
_MOST_BYTES = 4 * 2**30

Case = Callable[[Path], list[str]]
"""Writes the file into a folder, and returns the words of the command that reads it."""


# ---------------------------------------------------------------- specs


def _toml(text: str) -> Case:
    def make(folder: Path) -> list[str]:
        (folder / "s.toml").write_text(text)
        return ["scenes", "show", str(folder / "s.toml")]

    return make


def _json(text: str) -> Case:
    def make(folder: Path) -> list[str]:
        (folder / "s.json").write_text(text)
        return ["scenes", "show", str(folder / "s.json")]

    return make


# ---------------------------------------------------------------- meshes and grids

#: The scene of a mesh or grid, as JSON text with the shape left out.
SCENE = ("flat-wall", {"rig.camera.rows": 4, "rig.camera.cols": 4})


def _shape(name: str, content: bytes, **more: Any) -> Case:
    def make(folder: Path) -> list[str]:
        from ...scenes.load import load_scene

        (folder / name).write_bytes(content)
        scene = json.loads(load_scene(*SCENE).model_dump_json())
        if name.endswith((".npz", ".npy")):
            shape = {"kind": "height-grid", "width_m": 1.0, "relief_m": 0.1, "tilt_x_deg": 0.0, "tilt_y_deg": 0.0}
        else:
            shape = {"kind": "mesh", "size_m": 1.0, "rotation_deg": [0.0, 0.0, 0.0]}
        scene["target"][0]["shape"] = {**shape, "file": name, "center_m": [0.0, 0.0, 3.0], **more}
        (folder / "s.json").write_text(json.dumps(scene))
        return ["generate", str(folder / "s.json"), "--out", str(folder / "out.zarr")]

    return make


def _deflated(times: int, *, wrapped: bool) -> bytes:
    """A deflate stream, `wrapped` as by zlib, of `times` 16 MiB of zeros: one packed block, repeated."""
    packer = zlib.compressobj(9, wbits=15 if wrapped else -15)
    head = packer.compress(b"\0") + packer.flush(zlib.Z_FULL_FLUSH)
    block = packer.compress(bytes(2**24)) + packer.flush(zlib.Z_FULL_FLUSH)
    return head + block * times + packer.flush(zlib.Z_FINISH)


def _zip(name: str, begin: bytes, times: int) -> bytes:
    """A zip whose one member unpacks to `begin` and `times` 16 MiB of zeros."""
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", zipfile.ZIP_STORED) as archive:
        stored = zlib.compressobj(0, wbits=-15)
        archive.writestr(
            name, stored.compress(begin) + stored.flush(zlib.Z_FULL_FLUSH) + _deflated(times, wrapped=False)
        )
        (member,) = archive.filelist  # the directory is written at the end: there the member is a packed one
        member.compress_type, member.file_size = zipfile.ZIP_DEFLATED, len(begin) + 1 + times * 2**24
    return made.getvalue()


def _npz_bomb(folder: Path) -> list[str]:
    """3.5 MB that unpack to 3.5 GB."""
    head = io.BytesIO()
    header: Any = {"descr": "|u1", "fortran_order": False, "shape": (1, 1 + 210 * 2**24)}
    np.lib.format.write_array_header_1_0(head, header)
    return _shape("a.npz", _zip("a.npy", head.getvalue(), 210))(folder)


def _gz_bomb(folder: Path) -> list[str]:
    """1 MB that unpacks to 1 GB: 64 members."""
    return _shape("a.obj.gz", gzip.compress(b"v 0 0 0\n" * 2**21, 9) * 64)(folder)


def _3mf(model: str) -> bytes:
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as package:
        package.writestr("_rels/.rels", "<Relationships/>")
        package.writestr("3D/3dmodel.model", model)
    return made.getvalue()


def _3mf_bomb() -> bytes:
    return _zip("3D/3dmodel.model", b"<", 64)


def _laughs() -> bytes:
    """Objects, each made of ten of the one before: 10^12 triangles."""
    space = 'xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02"'
    first = (
        '<object id="0"><mesh><vertices><vertex x="0" y="0" z="0"/><vertex x="1" y="0" z="0"/><vertex x="0" y="1" z="0"/>'
        "</vertices>"
        '<triangles><triangle v1="0" v2="1" v3="2"/></triangles></mesh></object>'
    )
    more = "".join(
        f'<object id="{n}"><components>{f"""<component objectid="{n - 1}"/>""" * 10}</components></object>'
        for n in range(1, 13)
    )
    return _3mf(f'<model {space}><resources>{first}{more}</resources><build><item objectid="12"/></build></model>')


def _gltf(**changes: Any) -> bytes:
    document: dict[str, Any] = {
        "asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"componentType": 5126, "type": "VEC3", "count": 3}],
    }  # fmt: skip
    return json.dumps(document | changes).encode()


_VAST = {"componentType": 5126, "type": "VEC3", "count": 10**12}
_PLY = (
    b"ply\nformat ascii 1.0\nelement vertex 1000000000000000\n"
    + b"".join(b"property float " + axis + b"\n" for axis in (b"x", b"y", b"z"))
    + b"end_header\n"
)


def _spiral(corners: int) -> bytes:
    """One concave polygon of many corners: a comb."""
    rows = [f"v {k} {(k % 2) * 10 * (1 + k % 7)} 0" for k in range(corners)] + [f"v {corners} -1 0", "v 0 -1 0"]
    return ("\n".join(rows) + "\nf " + " ".join(str(k + 1) for k in range(corners + 2)) + "\n").encode()


# ---------------------------------------------------------------- estimates


def _estimates(change: Callable[[Any, Path], None]) -> Case:
    def make(folder: Path) -> list[str]:
        import h5py

        from ...captures import write
        from ...captures.example import example_capture

        store = write(folder / "s.zarr", example_capture(IMAGING))
        shape = (1, 5, 7)
        with h5py.File(folder / "peak.h5", "w") as file:
            for name, value in {"range": 5.0, "sigma": 1.0}.items():
                file[name] = np.full(shape, value)
            file["valid"] = np.ones(shape, bool)
            change(file, folder)
        return ["score", str(store), str(folder / "peak.h5"), "--out", str(folder / "scores")]

    return make


def _long_cpu(file: Any, folder: Path) -> None:
    del file["range"]
    file.create_dataset("range", (10**11,), "f8", chunks=(2**16,))


def _long_status(file: Any, folder: Path) -> None:
    file.create_dataset("status", (10**11,), "S4", chunks=(2**16,))


def _wide_status(file: Any, folder: Path) -> None:
    file.create_dataset("status", (1,), f"S{2**31 - 1}", chunks=(1,), maxshape=(None,))


def _itself(file: Any, folder: Path) -> None:
    import h5py

    del file["range"]
    layout = h5py.VirtualLayout((1, 5, 7), "f8")
    layout[...] = h5py.VirtualSource(".", "range", (1, 5, 7))
    file.create_virtual_dataset("range", layout)


def _outside(file: Any, folder: Path) -> None:
    import h5py

    with h5py.File(folder / "other.h5", "w") as other:
        other["range"] = np.full((1, 5, 7), 5.0)
    del file["range"]
    file["range"] = h5py.ExternalLink("other.h5", "range")


def _elsewhere(file: Any, folder: Path) -> None:
    (folder / "secret").write_bytes(np.full(35, 5.0).tobytes())
    del file["range"]
    file.create_dataset("range", (1, 5, 7), "f8", external=[(str(folder / "secret"), 0, 280)])


def _packed(file: Any, folder: Path) -> None:
    """A chunk of 280 bytes that unpacks to 3 GB."""
    del file["range"]
    made = file.create_dataset("range", (1, 5, 7), "f8", chunks=(1, 5, 7), compression="gzip")
    made.id.write_direct_chunk((0, 0, 0), _deflated(180, wrapped=True))


def _wide_attribute(file: Any, folder: Path) -> None:
    file.attrs.create("estimator", np.zeros(8000), dtype="f8")
    file.attrs["schema_version"] = 10**9


# ---------------------------------------------------------------- stores


def _store(change: Callable[[Path, dict[str, Any]], None], verb: str = "status") -> Case:
    """A store whose metadata are altered, under right checksums."""

    def make(folder: Path) -> list[str]:
        from ...captures import write
        from ...captures.example import example_capture
        from .fuzz_subjects import reseal

        store = write(folder / "s.zarr", [example_capture(IMAGING, seed=seed) for seed in range(2)])
        (store / "record.jsonl").unlink()
        manifest = json.loads((store / "manifest.json").read_bytes())
        change(store, manifest)
        manifest["store_version"] = 1
        (store / "manifest.json").write_text(json.dumps(manifest))
        reseal(store)
        return ["data", verb, str(store)] if verb != "export" else ["export", str(store), "--out", str(folder / "a.h5")]

    return make


def _edit(name: str, change: Callable[[dict[str, Any]], None]) -> Callable[[Path, dict[str, Any]], None]:
    def apply(store: Path, manifest: dict[str, Any]) -> None:
        body = json.loads((store / name).read_bytes())
        change(body)
        (store / name).write_text(json.dumps(body))

    return apply


def _far(body: dict[str, Any]) -> None:
    body["shape"] = [2, *[10**5] * 3]
    body["chunk_grid"]["configuration"]["chunk_shape"] = [1, *[10**5] * 3]


def _shape_of(*shape: int) -> Callable[[dict[str, Any]], None]:
    return lambda body: body.update(shape=[2, *shape])


def _bomb(store: Path, manifest: dict[str, Any]) -> None:
    """Chunks of .2 MB that unpack to 3 GB: all arrays of the capture as they are, but `truth_range` of a larger header."""
    from numcodecs import Blosc

    content = bytearray(Blosc(cname="zstd", clevel=1).encode(bytes(2**27)))
    content[4:8] = struct.pack("<I", 2**31 - 64)
    _sealed(store / "truth_range" / "c.0.0.0", bytes(content))


def _sealed(file: Path, content: bytes) -> None:
    import google_crc32c

    file.write_bytes(content + int(google_crc32c.value(content)).to_bytes(4, "little"))


def _manifest(**changes: Any) -> Callable[[Path, dict[str, Any]], None]:
    return lambda store, manifest: manifest.update(changes)


CASES: dict[str, Case] = {
    "TOML: a whole number of 5,000 digits": _toml(f"schema_version = {'9' * 5000}\n"),
    "TOML: a key of 40 KB": _toml("a" + ".a" * 20000 + " = 1\n"),
    "TOML: a key of 40 KB in quotes": _toml('"a"' + '."a"' * 10000 + " = 1\n"),
    "TOML: 60,000 brackets": _toml("a = " + "[" * 60000 + "\n"),
    "JSON: a whole number of 5,000 digits": _json('{"schema_version": ' + "9" * 5000 + "}"),
    "JSON: a whole number of 400 digits": _json('{"schema_version": 1' + "0" * 400 + "}"),
    "JSON: 60,000 brackets": _json('{"a": ' + "[" * 60000 + "}"),
    "npz: 3.5 MB to 3.5 GB": _npz_bomb,
    "obj.gz: 1 MB to 1 GB": _gz_bomb,
    "obj: a polygon of 60,000 corners": _shape("a.obj", _spiral(60000)),
    "ply: 10^15 vertices": _shape("a.ply", _PLY),
    "3mf: objects made of ten objects, twelve times": _shape("a.3mf", _laughs()),
    "3mf: a model of 1 GB": _shape("a.3mf", _3mf_bomb()),
    "gltf: an accessor of 10^12 elements": _shape("a.gltf", _gltf(accessors=[_VAST])),
    "gltf: nodes made of ten nodes, twelve times": _shape(
        "a.gltf", _gltf(nodes=[*({"children": [n + 1] * 10} for n in range(12)), {"mesh": 0}])
    ),
    "HDF5: 10^11 elements": _estimates(_long_cpu),
    "HDF5: 10^11 statuses": _estimates(_long_status),
    "HDF5: a status of 2 GB": _estimates(_wide_status),
    "HDF5: a view of itself": _estimates(_itself),
    "HDF5: a link to another file": _estimates(_outside),
    "HDF5: data in another file": _estimates(_elsewhere),
    "HDF5: a chunk that unpacks to 3 GB": _estimates(_packed),
    "HDF5: an attribute of odd form": _estimates(_wide_attribute),
    "store: chunks of 10^15": _store(_edit("counts/zarr.json", _far)),
    "store: unlike sizes": _store(_edit("truth_range/zarr.json", _shape_of(5, 8))),
    "store: sizes of text": _store(_edit("counts/zarr.json", lambda body: body.update(shape="many"))),
    "store: another codec": _store(_edit("counts/zarr.json", lambda body: body.update(codecs=[{"name": "bytes"}]))),
    "store: variables of wrong type": _store(_edit("zarr.json", lambda body: body["attributes"].update(variables=7))),
    "store: captures of wrong type": _store(_edit("zarr.json", lambda body: body["attributes"].update(captures=[1, 2]))),
    "store: texts that are missing": _store(_edit("zarr.json", lambda body: body["attributes"].update(texts={}))),
    "store: a count of text": _store(_manifest(count="two")),
    "store: a count of 10^18": _store(_manifest(count=10**18)),
    "store: modality of wrong type": _store(_manifest(modality=[IMAGING])),
    "store: a chunk whose header says 2 GB": _store(_bomb, "export"),
}  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Run all cases and print the table. Returns 1 where one failed."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--only", default="", help="part of the names of the cases to run")
    given = parser.parse_args(arguments)
    parts: dict[str, Attempts] = {}
    for name, case in CASES.items():
        if given.only in name:
            part = parts.setdefault(name.partition(":")[0], Attempts(name.partition(":")[0]))
            problem, peak_bytes = _run(case)
            part.used(peak_bytes)
            part.failed(f"{name}: {problem}") if problem else part.held()
    return print_attempts(list(parts.values()))


def _run(case: Case) -> tuple[str, int]:
    """(why a case did not hold, or "", its most resident memory in bytes)."""
    with tempfile.TemporaryDirectory(prefix="beambench-hostile-") as place:
        words = case(Path(place))
        start = time.monotonic()
        path = os.pathsep.join(part or os.getcwd() for part in sys.path)
        with open(Path(place) / "told", "w+b") as told:
            child = subprocess.Popen(
                [sys.executable, "-m", "beambench", *words], stdout=told, stderr=told, stdin=subprocess.DEVNULL,
                env=os.environ | {"PYTHONPATH": path},
            )  # fmt: skip
            # CPU time: a busy machine decides nothing. A child that waits is not ended by it.
            resource.prlimit(child.pid, resource.RLIMIT_CPU, (_MOST_S, _MOST_S))
            while True:
                pid, status, usage = os.wait4(child.pid, os.WNOHANG)
                if pid:
                    child.returncode = os.waitstatus_to_exitcode(status)
                    break
                if time.monotonic() - start > 10 * _MOST_S:
                    child.kill()
                    child.wait()
                    return f"over {10 * _MOST_S} s", 0
                time.sleep(0.02)
            told.seek(0)
            text = told.read().decode(errors="replace")
    peak_bytes = usage.ru_maxrss * 1024
    if child.returncode != 2 or "Traceback" in text:
        return f"exit {child.returncode}: {text.strip()[-200:]!r}", peak_bytes
    return f"{peak_bytes / 2**30:.1f} GiB" if peak_bytes > _MOST_BYTES else "", peak_bytes


if __name__ == "__main__":
    sys.exit(main())
