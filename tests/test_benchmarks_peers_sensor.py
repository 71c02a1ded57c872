"""The chain of a wave sensor against other programs: what does not need their packages, and the comparisons where they are."""

from __future__ import annotations

from pathlib import Path

import pytest

from beambench.benchmarks.peers import sensor_chain


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="peak memory is read from /proc")
def test_a_stream_of_frames_takes_no_more_memory_than_a_few(long_run: None) -> None:
    """Peak resident memory of two processes: a hundred frames of 256 × 256 doubles would be 52 MB, more than 5 %."""
    peak = sensor_chain.memory_of_a_stream()
    assert peak["100"] < 1.05 * peak["10"]


def test_modes_and_their_variances_are_three_products_or_less() -> None:
    """One product and two; the least of 40 turns of 20, on a machine that may be busy."""
    spent = sensor_chain.modes_in_products()
    assert spent["modes"] < 2.0 and spent["variances"] < 3.0


def test_aotools_finds_the_same_positions() -> None:
    """Cells of 9 pixels with a known level against cells of 8.427 with a measured one: a thirtieth of a pixel."""
    pytest.importorskip("aotools")
    assert sensor_chain.against_aotools()["rms_difference_px"] < 0.035
