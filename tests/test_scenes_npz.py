"""Foreign .npz and .npy files: each damage and each bomb is one clear error, and memory follows the limit, not the claim."""

from __future__ import annotations

import io
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest

from beambench.scenes.errors import InputError
from beambench.scenes.npz import read_npy, read_npz


def _npy(header: str, data: bytes = b"") -> bytes:
    text = header.encode().ljust(117) + b"\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + data


def _zip(path: Path, members: dict[str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return path


def test_what_numpy_wrote_is_read_bit_for_bit(tmp_path: Path) -> None:
    arrays = {
        "a": np.arange(12.0).reshape(3, 4), "f": np.asfortranarray(np.arange(12, dtype=np.int16).reshape(3, 4)),
        "text": np.array(["x", "yz"]), "one": np.float32(2.5), "none": np.empty((0, 3)), "flag": np.array([True, False]),
    }  # fmt: skip
    for save in (np.savez, np.savez_compressed):
        save(tmp_path / "a.npz", **arrays)
        read = read_npz(tmp_path / "a.npz", "The file")
        assert read.keys() == arrays.keys()
        for name, array in arrays.items():
            assert read[name].dtype == np.asarray(array).dtype and read[name].shape == np.shape(array)
            np.testing.assert_array_equal(read[name], array)
    np.save(tmp_path / "a.npy", arrays["f"])
    np.testing.assert_array_equal(read_npy(tmp_path / "a.npy", "The file"), arrays["f"])


BAD = {
    "claims more than it holds": _npy(
        "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000000,)}", b"1234"
    ),
    "claims a count beyond 64 bits": _npy(
        "{'descr': '<f8', 'fortran_order': False, 'shape': (99999999999999999999, 9)}"
    ),
    "negative": _npy("{'descr': '<f8', 'fortran_order': False, 'shape': (-1,)}", b"12345678"),
    "pickled": _npy("{'descr': '|O', 'fortran_order': False, 'shape': (1,)}", b"cos\nsystem\n(S'true'\ntR."),
    "no header": _npy("[" * 110),
    "empty": b"",
    "another version": b"\x93NUMPY\x07\x00",
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_array_is_one_clear_error(name: str, tmp_path: Path) -> None:
    (tmp_path / "a.npy").write_bytes(BAD[name])
    _zip(tmp_path / "a.npz", {"a.npy": BAD[name]})
    tracemalloc.start()
    for read, file in ((read_npy, "a.npy"), (read_npz, "a.npz")):
        with pytest.raises(InputError, match="The grid cannot be read") as caught:
            read(tmp_path / file, "The grid")
        assert file in str(caught.value) and "\x00" not in str(caught.value)
    assert tracemalloc.get_traced_memory()[1] < 2**24
    tracemalloc.stop()


def test_a_bomb_is_refused_before_it_is_unpacked(tmp_path: Path) -> None:
    buffer = io.BytesIO()
    np.save(buffer, np.zeros(2**24))
    bomb = _zip(tmp_path / "a.npz", {"a.npy": buffer.getvalue()})
    assert bomb.stat().st_size < 2**18
    del buffer
    tracemalloc.start()
    with pytest.raises(InputError, match="more than 1,048,576 bytes"):
        read_npz(bomb, "The file", most_bytes=2**20)
    assert tracemalloc.get_traced_memory()[1] < 2**22
    tracemalloc.stop()
    many = _zip(tmp_path / "b.npz", {f"{k}.npy": _npy("{'descr': '|u1', 'fortran_order': False, 'shape': (100000,)}",
                                                     bytes(100_000)) for k in range(12)})  # fmt: skip
    with pytest.raises(InputError, match="more than"):
        read_npz(many, "The file", most_bytes=2**20)


def test_every_flipped_bit_is_an_error_or_changes_nothing(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", a=np.arange(6.0), b=np.array(["x"]))
    whole = (tmp_path / "a.npz").read_bytes()
    rng = np.random.default_rng(1)
    for _ in range(300):
        place = int(rng.integers(8 * len(whole)))
        flipped = bytearray(whole)
        flipped[place // 8] ^= 1 << place % 8
        (tmp_path / "b.npz").write_bytes(flipped)
        try:
            read = read_npz(tmp_path / "b.npz", "The file")
        except InputError:
            continue
        # Bits of names, dates and sizes that zip holds twice; the data themselves have a checksum.
        assert all(np.array_equal(array, np.arange(6.0)) or np.array_equal(array, ["x"]) for array in read.values())
