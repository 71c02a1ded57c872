"""Sealed captures: no process changes them, and what repeats a call or warms up is other data of the same kind."""

from __future__ import annotations

import mmap
import os
from pathlib import Path

import numpy as np
import pytest

from beambench.benchmarks.runner.protocol import write_capture, write_meta
from beambench.benchmarks.runner.sealed import block, drawn, fresh, unpack

from .test_benchmarks_runner import hidden_capture


@pytest.fixture
def spooled(tmp_path: Path) -> Path:
    capture = hidden_capture(3)
    write_capture(tmp_path / "x", capture)
    write_meta(tmp_path / "x", capture, "matched")
    return tmp_path / "x"


def test_a_block_cannot_be_written_resized_or_mapped_for_writing(spooled: Path) -> None:
    handle = block(spooled, "matched")
    with pytest.raises(PermissionError):
        os.pwrite(handle, b"x", 0)
    for size in (0, 1 << 24):
        with pytest.raises(PermissionError):
            os.ftruncate(handle, size)
    with pytest.raises(PermissionError):
        mmap.mmap(handle, 0)
    os.close(handle)


def test_fresh_data_are_other_noise_each_time_and_keep_dead_and_full_samples(spooled: Path) -> None:
    counts = np.array([[0, 1, 100, 200], [4095, 300, 0, 4095]] * 500, np.uint16)
    one, two = (fresh("counts")("counts", ["row", "col"], counts) for _ in range(2))
    assert one.dtype == counts.dtype and not np.array_equal(one, two)
    kept = (counts <= 1) | (counts == 4095)
    for other in (one, two):
        step = other.astype(int) - counts
        assert np.array_equal(other[kept], counts[kept])
        assert set(np.unique(step[~kept])) == {-1, 0, 1}
    real = fresh("counts")("counts", ["row"], np.linspace(1.0, 2.0, 100))
    assert 0 < np.abs(real / np.linspace(1.0, 2.0, 100) - 1).max() <= 1.001e-3
    assert fresh("counts")("delay", ["slice"], counts[0]) is not None and np.array_equal(
        fresh("counts")("delay", ["slice"], counts[0]), counts[0]
    )


def test_a_warm_up_shows_no_more_than_eight_elements() -> None:
    rng = np.random.default_rng(1)
    counts = rng.integers(1000, 60000, (5, 12, 10)).astype(np.uint16)
    seen = drawn("counts", ("row", "col"))("counts", ["slice", "row", "col"], counts)
    assert seen.shape == counts.shape and seen.dtype == counts.dtype
    near = np.abs(seen.reshape(5, -1)[:, :, None].astype(int) - counts.reshape(5, -1)[:, None, :]).max(axis=0) <= 1
    assert near.any(axis=1).all(), "every element is one of the capture's but for a DN"
    assert np.unique(near.argmax(axis=1)).size <= 8


def test_drawn_elements_keep_the_order_of_their_samples() -> None:
    counts = (1000 + 10 * np.arange(6 * 4)[:, None] + np.zeros(3)).astype(np.uint16).reshape(6, 4, 3)
    seen = drawn("counts", ("row",))("counts", ["row", "frame", "col"], counts)  # six elements: fresh, in their places
    assert np.abs(seen.astype(int) - counts).max() <= 1


def test_a_block_is_the_capture_of_its_condition(spooled: Path) -> None:
    write_meta(spooled, hidden_capture(3).assign_attrs(rig='{"other": 1}'), "calibrated")
    found = []
    for condition in ("matched", "calibrated"):
        handle = block(spooled, condition)
        found.append(unpack(handle))
        os.close(handle)
    assert found[0].attrs["rig"] != found[1].attrs["rig"] == '{"other": 1}'
    assert found[0]["counts"].identical(found[1]["counts"])
