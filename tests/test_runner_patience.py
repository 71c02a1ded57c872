"""A busy machine does not decide which estimators exceed their time: the wait for a processor does not count."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator

import pytest

from beambench.benchmarks.runner.patience import Patience, waited_s

BUSY = "while True: pass"
#: Says so when it has begun, works for a given CPU time, and then ends.
WORK = """
import sys, time
print("begun", flush=True)
while time.process_time() < float(sys.argv[1]): pass
"""


def on_one_core(code: str, *arguments: str) -> subprocess.Popen[bytes]:
    core = min(os.sched_getaffinity(0))
    return subprocess.Popen(
        [sys.executable, "-c", code, *arguments],
        stdout=subprocess.PIPE,
        preexec_fn=lambda: os.sched_setaffinity(0, {core}),
    )


@pytest.fixture
def crowd() -> Iterator[None]:
    busy = [on_one_core(BUSY) for _ in range(3)]
    yield
    for process in busy:
        process.kill()
        process.wait()
        assert process.stdout is not None
        process.stdout.close()


@pytest.mark.skipif(not waited_s(os.getpid()), reason="the kernel does not tell how long threads wait")
def test_a_child_that_waits_for_a_processor_is_given_the_time(crowd: None) -> None:
    with on_one_core(WORK, "0.7") as child:
        assert child.stdout is not None
        child.stdout.readline()
        patience, start = Patience(child.pid, 1.0), time.monotonic()
        while child.poll() is None:
            assert not patience.over()
            time.sleep(0.02)
        spent = time.monotonic() - start
    assert spent > 1.5 * 1.0, "the crowd did not keep the processor: the test shows nothing"


def test_a_child_that_sleeps_or_works_too_long_is_over_its_time() -> None:
    for code in ("import time; time.sleep(60)", BUSY):
        with subprocess.Popen([sys.executable, "-c", code]) as child:
            patience, start = Patience(child.pid, 0.5), time.monotonic()
            while not patience.over():
                assert time.monotonic() - start < 15.5
                time.sleep(0.02)
            child.kill()
        assert time.monotonic() - start >= 0.5
