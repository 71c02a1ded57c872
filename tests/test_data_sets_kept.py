"""What is said of a data set that was interrupted, is unfinished, or is complete: how it goes on."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Any

import pytest

import beambench
from beambench import cli
from beambench.benchmarks.datasets import large
from beambench.benchmarks.datasets.large import Force, make_dataset
from beambench.scenes.datasets.load import load_dataset
from beambench.scenes.errors import InputError

from ._data_sets import QUICK, tiny


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "my quick.json"
    path.write_text(json.dumps(tiny(QUICK, captures=12)))
    return path


def test_an_interrupted_data_set_tells_the_command_that_goes_on(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out, heard = tmp_path / "out", large._Run._heard

    def stop(self: Any, index: int) -> None:
        heard(self, index)
        if self._done == 6:  # the first shard of four is complete
            raise KeyboardInterrupt

    words = ["generate", str(file), "-o", str(out), "--workers", "1", "--set", "seed=5"]
    with monkeypatch.context() as planted:
        planted.setattr(large._Run, "_heard", stop)
        assert cli.main(words) == 130
    told = capsys.readouterr().err
    kept = next(line for line in told.splitlines() if line.startswith("  kept:"))
    assert f"1 complete shard in {out}.partial" in kept

    with pytest.raises(InputError, match="unfinished") as unfinished:
        beambench.data_verify(out)
    assert f"--resume and -o {out}" in unfinished.value.next_step and "finalize" in unfinished.value.next_step

    program, *again = shlex.split(kept.partition("to continue: ")[2])
    assert program == "beambench" and cli.main([*again, "--workers", "1"]) == 0
    assert not beambench.data_verify(out) and beambench.data_status(out)["count"] == 12

    for count, advice in ((12, "--set captures=24 makes 12 more"), (20, "makes 8 more")):
        assert cli.main([*words, "--set", f"captures={count}"]) == 2
        told = capsys.readouterr().err
        assert "12 captures of this data set" in told and "--resume" in told and advice in told
    assert cli.main([*words, "--set", "seed=6"]) == 2  # another data set: --resume would refuse it, too
    assert "--resume" not in capsys.readouterr().err


def test_progress_says_at_once_what_is_done_and_tells_no_time_of_its_own(tmp_path: Path) -> None:
    source, out = load_dataset(tiny(QUICK, captures=12)), tmp_path / "out"
    told: list[tuple[str, int, int, str]] = []
    for draws, resume in ((source, False), (load_dataset(tiny(QUICK, captures=16)), True)):
        make_dataset(
            draws, out, Force(1), resume=resume, overwrite=False, tell=lambda *step: told.append(step)
        )  # fmt: skip
    assert told[:2] == [("generate", 0, 12, "pilot"), ("generate", 0, 12, "workers start")]
    again = told.index(("check", 0, 1, "captures that are there"))
    assert told[again - 1] == ("generate", 12, 12, "")
    assert told[again + 1 : again + 3] == [("check", 1, 1, ""), ("generate", 12, 16, "workers start")]
    assert told[-1] == ("generate", 16, 16, "") and not any("left" in text for *_, text in told)


def test_nothing_is_told_of_what_was_not_begun(tmp_path: Path) -> None:
    from beambench.benchmarks.datasets.kept import kept_note

    assert kept_note("gated-1k", {}, tmp_path / "out") == ""
