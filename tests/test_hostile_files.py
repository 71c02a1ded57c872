"""Small files that state far too much, lead elsewhere, or are of wrong types: exit code 2 and a clear error, in little memory."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from beambench import cli
from beambench.benchmarks.checks import hostile


@pytest.mark.parametrize("name", [*hostile.CASES])
def test_a_hostile_file_is_bad_input(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = hostile.CASES[name](tmp_path)
    start = time.process_time()
    code = cli.main(words)
    told = capsys.readouterr().err
    assert code == 2 and "error: " in told and "Traceback" not in told, told
    assert time.process_time() - start < 45


@pytest.mark.slow
def test_all_of_them_in_processes_of_their_own(long_run: None) -> None:
    assert hostile.main([]) == 0
