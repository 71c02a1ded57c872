"""Reading a data set: speed against plain zarr, memory against the number of captures, and what a loader of batches costs.

    python -m beambench.benchmarks.checks.data_set_reading --few 100 --many 10000 --rounds 5

Writes two stores of small captures, reads one array of up to 1,000 captures of the larger one by zarr itself and by the
readers, in turn, and tells captures/s by processor time. Memory is the most that a process had which opened a store, read its
index and streamed it once. Where PyTorch is installed, its `DataLoader` reads too: batches of eight by no worker, in this process.
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path

__all__ = ["main", "written"]

#: Captures of a shard.
_LENGTH = 64

_STREAM = """
import sys
from beambench.benchmarks.checks.attempts import peak_memory
from beambench.captures.lazy import dataset
from beambench.captures.readers import CaptureStream
total = sum(1 for sample in CaptureStream(sys.argv[1], ["counts", "truth_range"], part="train", seed=1))
stacks = dataset(sys.argv[1], ["counts"], part="train")
last = float(stacks["counts"].isel(capture=-1).mean())
print(total, peak_memory())
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print. Returns 1 below 80 % of zarr's speed, or where memory grows by over 10 %."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--few", type=int, default=100)
    parser.add_argument("--many", type=int, default=10_000)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--side", type=int, default=32, help="rows and columns of a capture of 16 slices")
    given = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory(prefix="beambench-reading-") as place:
        stores = {count: written(Path(place) / str(count), count, given.side) for count in (given.few, given.many)}
        peaks = {count: _peak(store) for count, store in stores.items()}
        ratios = _speeds(stores[given.many], min(given.many, 1000), given.rounds)
    for count, peak in peaks.items():
        print(f"{count} captures streamed: most memory {peak / 2**20:.0f} MiB")
    growth = peaks[given.many] / peaks[given.few]
    print(
        f"memory {growth:.3f}; " + "; ".join(f"{name}: {ratio:.2f} of zarr's speed" for name, ratio in ratios.items())
    )
    return int(growth > 1.1 or min(ratios.values()) < 0.8)


def written(root: Path, count: int, side: int) -> Path:
    """A store of so many captures: eight kinds of noise, again and again, each time with another number."""
    import numpy as np

    from ...captures import finalize
    from ...captures.example import example_capture
    from ...captures.store.journal import JOURNAL, mark_journal
    from ...captures.store.shard_finish import write_request
    from ...captures.store.shard_writer import ShardWriter
    from .example_modalities import IMAGING

    partial = root.with_name(root.name + ".partial")
    partial.mkdir()
    with open(partial / JOURNAL, "xb") as file:
        mark_journal(file)
    write_request(partial, {"name": "s", "count": count, "identity": "i", "numbers": ["a"], "texts": []})
    rng = np.random.default_rng(1)
    capture = example_capture(IMAGING, seed=0, sizes={"slice": 16, "row": side, "col": side})
    noise = [rng.poisson(200.0, capture["counts"].shape).astype("u2") for _ in range(8)]
    for shard, first in enumerate(range(0, count, _LENGTH)):
        rows = range(first, min(first + _LENGTH, count))
        with ShardWriter(partial, IMAGING, shard, rows, _LENGTH, last=rows.stop == count) as writer:
            for row in rows:
                capture["counts"].values[...] = noise[row % 8]
                writer.append(capture, {"part": "test" if row % 5 == 0 else "train", "values": {"a": row / 2}})
            writer.close()
    finalize(root)
    return root


def _peak(store: Path) -> int:
    """Most resident memory of a process that streams the store, bytes."""
    done = subprocess.run([sys.executable, "-c", _STREAM, str(store)], capture_output=True, text=True, check=True)
    return int(done.stdout.split()[-1])


def _speeds(store: Path, count: int, rounds: int) -> dict[str, float]:
    """Speed of each reader as a share of that of zarr, by processor time, medians of interleaved rounds."""
    import zarr

    from ...captures.lazy import dataset
    from ...captures.readers import Captures, CaptureStream
    from .example_modalities import IMAGING

    def plain() -> None:
        array = zarr.open_group(str(store / IMAGING), mode="r")["counts"]
        for number in range(count):
            array[number]  # type: ignore[index]

    def mapped() -> None:
        captures = Captures(store, ["counts"])
        for number in range(count):
            captures[number]

    def streamed() -> None:
        for number, _ in enumerate(CaptureStream(store, ["counts"], seed=2), 1):
            if number == count:
                break

    def stacked() -> None:
        counts = dataset(store, ["counts"])["counts"].variable
        for number in range(count):
            _ = counts[number].values

    readers: dict[str, Callable[[], None]] = {
        "zarr": plain,
        "Captures": mapped,
        "CaptureStream": streamed,
        "xarray": stacked,
    }
    if find_spec("torch") is not None:
        readers["DataLoader"] = _loaded(store, count)
    times: dict[str, list[float]] = {name: [] for name in readers}
    for _ in range(rounds):
        for name, read in readers.items():
            began = time.process_time()
            read()
            times[name].append(time.process_time() - began)
    base = statistics.median(times.pop("zarr"))
    print(f"zarr: {count / base:.0f} captures/s of one processor")
    return {name: base / statistics.median(found) for name, found in times.items()}


def _loaded(store: Path, count: int) -> Callable[[], None]:
    """Reads so many captures by PyTorch's loader, in batches of eight tensors."""
    import torch

    from ...captures.readers import CaptureStream

    torch.set_num_threads(1)

    def read() -> None:
        loader = torch.utils.data.DataLoader(CaptureStream(store, ["counts"], seed=2), batch_size=8)
        for number, _ in enumerate(loader, 1):
            if 8 * number >= count:
                break

    return read


if __name__ == "__main__":
    sys.exit(main())
