"""Kernels are compiled while captures are generated: once, in a process that ends when asked and with the runner."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from beambench.benchmarks import ahead
from beambench.benchmarks.ahead import Ahead, compile_all
from beambench.benchmarks.run import run_suite
from beambench.benchmarks.runner.child import bind
from beambench.optics import jit
from beambench.scenes.machine import usable_cores


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty folder of compiled code."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    jit.cache_folder.cache_clear()
    yield jit.cache_folder()
    jit.cache_folder.cache_clear()


def helpers() -> list[psutil.Process]:
    return [
        one
        for one in psutil.Process().children(recursive=True)
        if "beambench.benchmarks.ahead" in " ".join(one.cmdline())
    ]


def waited(found: Path, what: str) -> bool:
    until = time.monotonic() + 120.0
    while not list(found.rglob(what)) and time.monotonic() < until:
        time.sleep(0.05)
    return bool(list(found.rglob(what)))


@pytest.mark.skipif(usable_cores() < 2, reason="needs a second processor")
def test_kernels_are_compiled_once_and_marked(cache: Path) -> None:
    with Ahead(["peak", "x-plug-in"]) as one:
        assert len(helpers()) == 1
        assert waited(cache, "compiled/*")
        assert waited(cache, "*.nbi")
        one.stop()
        assert not helpers()
    with Ahead(["peak", "x-plug-in"]):
        assert not helpers()  # nothing is left to do, and plug-ins are not called
    with Ahead(["peak", "parabola"]):
        assert len(helpers()) == 1
    assert not helpers()


def test_it_ends_wherever_it_is(cache: Path) -> None:
    with pytest.raises(KeyboardInterrupt), Ahead(["poisson-ml"]):
        time.sleep(1.0)
        began = time.monotonic()
        raise KeyboardInterrupt
    assert time.monotonic() - began < 1.0  # poisson-ml compiles for longer
    assert not helpers()
    assert not list(cache.glob("compiled/*"))
    assert jit.damaged_files(cache) == []


def test_it_ends_with_the_runner(cache: Path, tmp_path: Path) -> None:
    code = (
        "import time; from beambench.benchmarks.ahead import Ahead; one = Ahead(['poisson-ml']); "
        "print(one._process.pid, flush=True); time.sleep(60)"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, cwd=tmp_path) as runner:
        assert runner.stdout is not None
        pid = int(runner.stdout.readline())
        runner.kill()
        runner.wait()
    until = time.monotonic() + 10.0
    while psutil.pid_exists(pid) and time.monotonic() < until:
        time.sleep(0.05)
    assert not psutil.pid_exists(pid)


def test_an_estimator_that_fails_is_left_to_its_child(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    called = []
    monkeypatch.setattr(
        ahead, "bind", lambda label: called.append(label) or bind("peak" if label == "peak" else "none")
    )
    compile_all(["none", "peak"])
    assert called == ["none", "peak"]
    assert len(list(cache.glob("compiled/*"))) == 1


def test_the_one_with_the_most_kernels_is_first() -> None:
    numbers = [jit.kernels_below(bind(label)[1].function) for label in ("peak", "weighted-average", "poisson-ml")]
    assert 0 < numbers[0] < numbers[1] < numbers[2]


@pytest.mark.parametrize("cores", [1, 2])
def test_a_run_gives_the_same_answers_with_and_without_it(
    cache: Path, tmp_path: Path, cores: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ahead, "usable_cores", lambda: cores)
    given = {"scenes": [{"scene": "flat-wall"}], "estimators": ["peak"], "conditions": ["matched"], "draws": []}
    result = run_suite("quickstart", tmp_path / "run", overrides=given, report=False)
    assert [row["status"] for row in result.rows] == ["ok"]
    assert not helpers()
    assert os.listdir(cache)
