"""Small parts of the campaigns of docs/reliability.md: fuzzed inputs, flipped bits, kills and faults; and that they can fail."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from beambench.benchmarks.checks import attempts, flips, fuzz, fuzz_subjects, interrupted_work, mutations, traced
from beambench.benchmarks.folders.files import write_json, write_text
from beambench.benchmarks.report.charts import svg_of
from beambench.benchmarks.report.pairs import pairs_section
from beambench.benchmarks.report.ranking import ranking_section
from beambench.benchmarks.scores.tables import read_scores
from beambench.benchmarks.suites.suite import load_suite
from beambench.scenes.errors import InputError


@pytest.mark.parametrize("name", [*fuzz_subjects.SUBJECTS])
def test_fuzzed_inputs_end_with_a_result_or_a_clear_error(name: str, tmp_path: Path) -> None:
    subject = fuzz_subjects.SUBJECTS[name]
    sound = tmp_path / "sound"
    sound.mkdir()
    subject.make(sound)
    subject.read(Path(shutil.copytree(sound, tmp_path / "first")))
    refused = 0
    for number in range(6):
        work = Path(shutil.copytree(sound, tmp_path / "work"))
        subject.change(work, np.random.default_rng([7, number]))
        try:
            subject.read(work)
        except InputError:
            refused += 1
        shutil.rmtree(work)
    assert refused or name == "caches", "no change was noticed"


def test_a_reader_that_fails_is_found(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def broken(folder: Path) -> None:
        raise ZeroDivisionError("planted")

    subject = fuzz_subjects.SUBJECTS["caches"]
    planted = fuzz_subjects.Subject(subject.make, subject.change, broken)
    monkeypatch.setitem(fuzz_subjects.SUBJECTS, "caches", planted)
    note, told = fuzz._attempt("caches", tmp_path)
    assert not note and told.startswith("ZeroDivisionError: planted")


@pytest.mark.parametrize("seed", ["", "inf", "1.5", "-1", "1e30"])
def test_a_table_with_a_seed_that_is_no_whole_number_is_refused(tmp_path: Path, seed: str) -> None:
    fuzz_subjects.SUBJECTS["folders of runs"].make(tmp_path)
    lines = (tmp_path / "scores.csv").read_text().splitlines()
    at = lines[0].split(",").index("seed")
    fields = lines[1].split(",")
    fields[at] = seed
    (tmp_path / "scores.csv").write_text("\n".join([lines[0], ",".join(fields), *lines[2:]]))
    with pytest.raises(InputError, match="whole numbers"):
        read_scores(tmp_path)


def test_a_ranking_with_a_rank_that_is_no_number_is_refused(tmp_path: Path) -> None:
    fuzz_subjects.SUBJECTS["folders of runs"].make(tmp_path)
    assert ranking_section(tmp_path) and pairs_section(tmp_path)
    for name, old, new in (("ranking.csv", "rank_lo", "nan"), ("pairs.csv", "winner", None)):
        lines = (tmp_path / name).read_text().splitlines()
        at = lines[0].split(",").index(old)
        fields = lines[1].split(",")
        fields = fields[:at] if new is None else [*fields[:at], new, *fields[at + 1 :]]
        (tmp_path / name).write_text("\n".join([lines[0], ",".join(fields), *lines[2:]]))
        with pytest.raises(InputError, match="cannot be read"):
            ranking_section(tmp_path) if name == "ranking.csv" else pairs_section(tmp_path)


def test_half_a_character_is_written_as_an_escape(tmp_path: Path) -> None:
    """A page of a run whose record held one ended in a traceback."""
    write_text(tmp_path / "page", "a\ud800")
    write_json(tmp_path / "data", {"a\ud800": "\udcff"})
    assert (tmp_path / "page").read_bytes() == rb"a\ud800"
    assert json.loads((tmp_path / "data").read_text()) == {"a\ud800": "\udcff"}


def test_a_name_with_a_zero_byte_is_drawn() -> None:
    """XML has no such character, and the library that draws ended the process (SIGABRT)."""
    spec = {
        "data": {"values": [{"a\0": "b\0\x1b"}]},
        "mark": "text",
        "encoding": {"text": {"field": "a\\0", "type": "nominal"}},
    }
    assert svg_of(spec | {"title": "t\0\ud800"}).count(r"\x00") >= 1


def test_flipped_bits_are_found_and_mended() -> None:
    parts = flips.flips(19, seed=5)
    assert sum(part.tries for part in parts) >= 15 and not [told for part in parts for told in part.failures]


def test_changes_of_json_stay_json() -> None:
    content = b'{"a": [1, 2, {"b": "c"}], "d": "{\\"e\\": 1}"}'
    made = {mutations.json_mutated(content, np.random.default_rng(seed)) for seed in range(40)}
    assert len(made) > 20 and content not in made


def test_the_table_counts_what_failed(capsys: pytest.CaptureFixture[str]) -> None:
    part = attempts.Attempts("a part")
    part.held("read")
    part.failed("for a reason")
    part.used(3 * 2**20)
    assert attempts.print_attempts([part]) == 1
    told = capsys.readouterr().out
    assert "| a part | 2 | 1 | 1 | 1 read | 3 |" in told and "for a reason" in told
    assert attempts.shares(10, [1, 1, 1]) == [4, 3, 3] and attempts.shares(23, [1, 0.15, 1]) == [11, 2, 10]


def test_the_suite_that_is_interrupted_is_one_and_its_result_is_of_no_times(tmp_path: Path) -> None:
    interrupted_work._suite(tmp_path)
    assert load_suite(tmp_path / "suite.json").suite.scenes[0].overrides["rig.camera.rows"] == 4
    results = []
    for cpu_s, rmse in (("1.0", "0.5"), ("2.0", "0.5"), ("1.0", "0.25")):
        for name in ("accuracy.csv", "inputs.csv", "profiles.csv"):
            (tmp_path / "out" / name).parent.mkdir(exist_ok=True)
            (tmp_path / "out" / name).write_text(name)
        (tmp_path / "out" / "scores.csv").write_text(f"seed,rmse,cpu_s\n1,{rmse},{cpu_s}\n")
        results.append(interrupted_work._scored_rows(tmp_path))
    assert results[0] == results[1] != results[2]


@pytest.mark.slow
@pytest.mark.skipif(bool(traced.available()), reason=traced.available() or "strace works")
@pytest.mark.parametrize("kind", ["kills", "faults"])
def test_commands_that_are_stopped_are_finished(kind: str, long_run: None) -> None:
    import subprocess
    import sys

    words = [
        sys.executable,
        "-m",
        "beambench.benchmarks.checks.interruptions",
        "--kind",
        kind,
        "--count",
        "6",
        "--only",
        "data",
    ]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


def test_most_memory_is_the_process_s_own() -> None:
    """A process inherits `ru_maxrss` from the one that starts it: a check in a test of 3 GB found 3 GB, and growth of none."""
    large = np.ones(50_000_000)
    code = "from beambench.benchmarks.checks.attempts import peak_memory\nprint(peak_memory())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert 1e6 < int(done.stdout) < large.nbytes / 2
