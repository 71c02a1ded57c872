"""What strangers wrote reaches the terminal as plain text, and no lone surrogate ends a run."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from beambench.benchmarks.runner.protocol import read_results
from beambench.benchmarks.runner.session import _line
from beambench.captures.layouts import stage_of
from beambench.console import print_lines
from beambench.scenes.errors import InputError
from beambench.scenes.plain_text import plain_text


def test_control_sequences_and_surrogates_become_escapes() -> None:
    assert plain_text("ν = 1.5 µm, «x»\n\tline") == "ν = 1.5 µm, «x»\n\tline"
    assert plain_text("a\x1b[2Jb\x07\ud800\x9b1m") == r"a\x1b[2Jb\x07\ud800\x9b1m"


def test_the_message_of_a_plugin_is_plain() -> None:
    told = _line({"message": "RuntimeError: \x1b]0;owned\x07 \udcff"})
    assert told == r"RuntimeError: \x1b]0;owned\x07 \udcff" and told.encode()


def test_lines_are_printed_plain(capsys: pytest.CaptureFixture[str]) -> None:
    print_lines("name\x1b[31m\ud800")
    assert capsys.readouterr().out == "name\\x1b[31m\\ud800\n"


def test_a_name_with_a_control_sequence_is_told_plainly() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "beambench", "data", "status", "no\x1b[2Jsuch"], capture_output=True, timeout=120, check=False,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
    )  # fmt: skip
    assert done.returncode == 2 and b"\x1b" not in done.stderr and b"\\x1b[2J" in done.stderr


def test_a_value_that_has_no_text_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    assert "cannot be shown" in str(InputError("Too large.", value=10**5000))


def test_an_answer_that_is_cut_is_invalid_and_not_mapped(tmp_path: Path) -> None:
    """A mapped file that its writer shortened ended the runner by SIGBUS."""
    stage = stage_of("gated")
    for name in stage.dims():
        kind = bool if name == "valid" else float
        np.save(tmp_path / f"{name}.npy", np.ones((3, 4), kind))
    arrays, wrong = read_results(tmp_path, stage, {"row": 3, "col": 4})
    assert not wrong and all(
        type(array.base) is not np.memmap and not isinstance(array, np.memmap) for array in arrays.values()
    )
    path = tmp_path / "sigma.npy"
    path.write_bytes(path.read_bytes()[:-8])
    assert "sigma is not an array" in read_results(tmp_path, stage, {"row": 3, "col": 4})[1]
