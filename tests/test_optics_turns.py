"""Processes that need the same kernel at once compile it once."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from beambench.optics import turns
from beambench.optics.copying import copy_into
from beambench.optics.turns import Turn

#: Waits until another process holds the turn, then takes it and says so.
_OTHER = """
import sys
from pathlib import Path
from beambench.optics.turns import Turn
turn = Turn(Path(sys.argv[1]))
print("wait", flush=True)
assert turn.take()
print("mine", flush=True)
turn.end()
"""


def test_a_turn_is_of_one_process_at_a_time(tmp_path: Path) -> None:
    turn = Turn(tmp_path / "made" / "a.lock")
    assert turn.take()
    assert not turn.take()  # held here: no wait for oneself
    with subprocess.Popen([sys.executable, "-c", _OTHER, str(turn.path)], stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "wait\n"
        assert other.poll() is None
        turn.end()
        assert other.stdout.readline() == "mine\n"
    assert other.returncode == 0
    assert turn.take()
    turn.end()


def test_nobody_waits_for_ever(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(turns, "_PATIENCE_S", 0.05)
    held, other = Turn(tmp_path / "a.lock"), Turn(tmp_path / "a.lock")
    assert held.take()
    assert not other.take()
    held.end()
    assert other.take()
    other.end()


def test_without_a_place_there_are_no_turns(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert not Turn(tmp_path / "file" / "a.lock").take()


def test_copies_are_exact() -> None:
    values = np.random.default_rng(1).normal(size=17)
    out = np.zeros(20)
    copy_into(out, values)
    np.testing.assert_array_equal(out[:17], values)
    assert not out[17:].any()
