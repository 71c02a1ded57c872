"""Every reader of other programs' files on damaged and hostile ones: an InputError, or arrays; never another error, hang or memory.

    python -m beambench.benchmarks.checks.fuzz_imports [COUNT [SEED]]

One small sound file of each kind is made, then changed at random: bytes, runs of bytes, numbers of its header, cuts, repeats.
COUNT files in all, 10,000 by default, take some minutes. Prints a line for each kind; exit code 1 where a reader did else.
"""

from __future__ import annotations

import struct
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ...captures.imports.files import read_recording
from ...scenes.errors import InputError
from .attempts import peak_memory
from .mutations import mutated

__all__ = ["SAMPLES", "Outcome", "fuzzed", "main", "sample_trc"]

#: Longest time of one file, s, on a busy machine, and most memory that the whole check may add, bytes.
_SLOW_S, _MOST_BYTES = 20.0, 2 * 2**30
_EXTREME = (b"\xff\xff\xff\xff", b"\x00\x00\x00\x00", b"\xff\xff\xff\x7f", b"\x00\x00\x00\x80")


def _pixels() -> npt.NDArray[np.uint16]:
    return np.arange(12 * 16, dtype=np.uint16).reshape(12, 16)


def _picture(path: Path) -> None:
    import OpenImageIO as oiio

    values: npt.NDArray[Any] = _pixels().astype(np.float32) if path.suffix == ".exr" else _pixels()
    kind = oiio.FLOAT if path.suffix == ".exr" else oiio.UINT16
    file = oiio.ImageOutput.create(str(path))
    assert file is not None
    file.open(str(path), oiio.ImageSpec(16, 12, 1, kind))
    file.write_image(values[..., None])
    file.close()


def _fits(path: Path) -> None:
    from astropy.io import fits

    fits.PrimaryHDU(_pixels()).writeto(path, overwrite=True)


def _hdf5(path: Path) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        file.create_dataset("counts", data=_pixels(), chunks=(4, 4), compression="gzip")
        file.create_group("more").create_dataset("delay", data=np.arange(4.0))


def _mat(path: Path) -> None:
    from scipy.io import savemat

    savemat(path, {"counts": _pixels(), "delay": np.arange(4.0)}, do_compression=True)


def _spe(path: Path) -> None:
    head = bytearray(4100)
    for code, at, value in (
        ("<H", 42, 16),
        ("<h", 108, 3),
        ("<H", 656, 12),
        ("<i", 1446, 1),
        ("<f", 1992, 2.5),
        ("<f", 10, 0.1),
    ):
        struct.pack_into(code, head, at, value)
    path.write_bytes(bytes(head) + _pixels().tobytes())


def _csv(path: Path) -> None:
    path.write_text("time,signal\n" + "\n".join(f"{k * 1e-9},{k}" for k in range(20)))


def sample_trc(path: Path, segments: int = 3, samples: int = 20) -> None:
    """A LeCroy sequence of 16 bit codes 0, 1, 2, …; gain 1/1024 V, offset .5 V, 1 ns, each segment begins k·0.25 ns later."""
    head = bytearray(346)
    head[:8], head[16:27] = b"WAVEDESC", b"LECROY_2_3\0"
    fields = (
        ("<h", 32, 1), ("<h", 34, 1), ("<i", 36, 346), ("<i", 48, 16 * segments), ("<i", 60, 2 * segments * samples),
        ("<i", 116, segments * samples), ("<i", 144, segments), ("<f", 156, 1 / 1024), ("<f", 160, 0.5), ("<h", 172, 8),
        ("<f", 176, 1e-9), ("<d", 180, -5e-9),
    )  # fmt: skip
    for code, at, value in fields:
        struct.pack_into(code, head, at, value)
    head[76:84], head[196:197] = b"EMULATED", b"V"
    pairs = np.stack([0.001 * np.arange(segments), -5e-9 + 0.25e-9 * np.arange(segments)], axis=1)
    path.write_bytes(
        b"#9000000512" + bytes(head) + pairs.tobytes() + np.arange(segments * samples, dtype="<i2").tobytes()
    )


#: Ending -> writer of a sound file.
SAMPLES: dict[str, Callable[[Path], None]] = {
    ".png": _picture,
    ".tif": _picture,
    ".exr": _picture,
    ".fits": _fits,
    ".h5": _hdf5,
    ".npy": lambda path: np.save(path, _pixels()),
    ".npz": lambda path: np.savez_compressed(path, counts=_pixels(), delay=np.arange(4.0)),
    ".mat": _mat,
    ".spe": _spe,
    ".trc": sample_trc,
    ".csv": _csv,
}


class Outcome(dict[str, int]):
    """How many files of a kind were read, refused, and failed otherwise ("wrong"); `said`: the first wrong ones."""

    def __init__(self) -> None:
        super().__init__(read=0, refused=0, wrong=0)
        self.said: list[str] = []


def _changed(sound: bytes, rng: np.random.Generator) -> bytes:
    if rng.random() < 0.3 and len(sound) > 8:  # an extreme number, where a header has one
        at = int(rng.integers(min(len(sound) - 4, 2048)))
        return sound[:at] + _EXTREME[int(rng.integers(len(_EXTREME)))] + sound[at + 4 :]
    return mutated(sound, rng)


def fuzzed(ending: str, count: int, seed: int, folder: Path) -> Outcome:
    """What the reader of an ending did with `count` changed files."""
    path = folder / f"file{ending}"
    SAMPLES[ending](path)
    sound, outcome = path.read_bytes(), Outcome()
    rng = np.random.default_rng([seed, *ending.encode()])
    for _ in range(count):
        path.write_bytes(_changed(sound, rng))
        start = time.perf_counter()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                recording = read_recording(path)
            outcome["read" if recording.arrays else "wrong"] += 1
        except InputError:
            outcome["refused"] += 1
        except Exception as error:  # what the check looks for
            outcome["wrong"] += 1
            outcome.said.append(f"{type(error).__name__}: {error}"[:200])
        if time.perf_counter() - start > _SLOW_S:
            outcome["wrong"] += 1
            outcome.said.append(f"{time.perf_counter() - start:.0f} s")
    return outcome


def main(argv: Sequence[str] | None = None) -> int:
    """Print a line for each kind; 1 where a reader did anything but read or refuse."""
    arguments = [int(one) for one in (sys.argv[1:] if argv is None else argv)]
    count, seed = (*arguments, *(10_000, 1)[len(arguments) :])[:2]
    before, wrong = peak_memory(), 0
    for ending in SAMPLES:
        with tempfile.TemporaryDirectory() as folder:
            outcome = fuzzed(ending, -(-count // len(SAMPLES)), seed, Path(folder))
        wrong += outcome["wrong"]
        print(
            f"{ending:6s} {outcome['read']:6d} read {outcome['refused']:6d} refused {outcome['wrong']:4d} wrong",
            *outcome.said[:3],
        )
    grown = peak_memory() - before
    print(f"memory {grown / 2**20:.0f} MiB more")
    return int(wrong > 0 or grown > _MOST_BYTES)


if __name__ == "__main__":
    sys.exit(main())
