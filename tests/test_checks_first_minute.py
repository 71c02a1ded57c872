"""The check of the first minute: how commands are timed, and what it says of made-up times."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

from beambench.benchmarks.checks.first_minute import Timed, measured, newcomer, verdicts


def test_a_command_is_timed_with_its_children_and_its_first_result(tmp_path: Path) -> None:
    code = (
        "import subprocess, sys, time\n"
        "print('generate 1/1', flush=True); time.sleep(0.2)\n"
        "print('estimate 1/2 peak: object1, matched, 21 mm rms', flush=True)\n"
        "busy = 'import time; t = time.process_time()\\nwhile time.process_time() < t + 0.3: pass'\n"
        "subprocess.run([sys.executable, '-c', busy])\n"
    )
    found = measured([sys.executable, "-c", code], tmp_path, newcomer(tmp_path), re.compile(r"^estimate +\d+/\d+ .*: "))
    assert found.seen_s is not None and 0.2 <= found.seen_s <= found.wall_s
    assert found.cpu_s >= 0.3
    assert measured([sys.executable, "-c", "pass"], tmp_path, newcomer(tmp_path)).seen_s is None


def test_a_command_that_fails_says_why(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="ended with 3\nno room"):
        measured([sys.executable, "-c", "print('no room'); raise SystemExit(3)"], tmp_path, newcomer(tmp_path))


def test_caches_of_the_user_are_left_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", "/somewhere")
    monkeypatch.setenv("XDG_CACHE_HOME", "/warm")
    env = newcomer(tmp_path)
    assert "PYTHONPATH" not in env and env["XDG_CACHE_HOME"] == str(tmp_path / "cache") and "PATH" in env


def test_verdicts_of_made_up_times() -> None:
    install = Timed(120.0, 60.0)
    good = verdicts(install, Timed(100.0, 90.0, 15.0), Timed(40.0, 30.0), 0.3, 0.05)
    assert all(met for _, _, met in good) and good[3][1].startswith("0.30 s, 6.0 × python -c pass")
    bad = verdicts(install, Timed(179.0, 155.0, None), Timed(100.0, 74.0), 0.5, 0.05)
    assert not any(met for _, _, met in bad) and bad[0][1] == "1.49 (≤ 1)"
