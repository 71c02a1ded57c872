"""The list of planted wrong versions fits the present sources, and its runner tells killed from survived.

The campaign itself takes long: `python -m beambench.benchmarks.checks.mutants`.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from beambench.benchmarks.checks import mutants
from beambench.benchmarks.checks.mutants import Mutant, applied, read_mutants, run_mutant
from beambench.scenes.errors import InputError

MUTANTS = read_mutants()


@pytest.mark.parametrize("mutant", MUTANTS, ids=[m.name for m in MUTANTS])
def test_every_wrong_version_fits_its_file(mutant: Mutant, project: Path) -> None:
    """Its text stands there exactly once, the wrong file is Python, and its tests exist."""
    source = (project / mutant.file).read_text(encoding="utf-8")
    assert source.count(mutant.old) == 1
    assert applied(mutant, source) != source
    assert mutant.tests
    for test in mutant.tests:
        assert (project / test.split("::")[0]).is_file(), test


def test_the_list_is_long_and_spread_over_the_floors() -> None:
    floors = [mutant.file.split("/")[0] for mutant in MUTANTS]
    assert len(MUTANTS) >= 80
    for floor in ("optics", "scenes", "captures", "generator", "estimators", "benchmarks"):
        assert floors.count(floor) >= 3, floor


def test_few_wrong_versions_compile_everything_anew(project: Path) -> None:
    """An edit of a source that speaks of compiled functions takes a minute and more on its own (`optics/jit.py`)."""
    word = "ker" + "nel"
    assert sum(word in (project / m.file).read_text(encoding="utf-8") for m in MUTANTS) <= 5


def version(**changes: object) -> Mutant:
    plain = {"name": "v", "file": "room/law.py", "old": "2 * x", "new": "3 * x", "tests": ("tests/test_law.py",)}
    return Mutant(**(plain | changes))  # type: ignore[arg-type]


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """A small project with one law and two tests."""
    (tmp_path / "room").mkdir()
    (tmp_path / "tests").mkdir()
    (tmp_path / "room" / "law.py").write_text("def law(x):\n    return 2 * x\n", encoding="utf-8")
    imported = "import sys\nsys.path.insert(0, '.')\nfrom room.law import law\n\n\n"
    for name, check in (("law", "assert law(2) == 4"), ("blind", "assert law(0) == 0")):
        text = f"{imported}def test_{name}():\n    {check}\n"
        (tmp_path / "tests" / f"test_{name}.py").write_text(text, encoding="utf-8")
    (tmp_path / "pytest.ini").write_text("[pytest]\n", encoding="utf-8")
    return tmp_path


def test_a_test_that_notices_kills_and_one_that_does_not_lets_through(copy: Path) -> None:
    before = (copy / "room" / "law.py").read_text(encoding="utf-8")
    mutants.check_copy(copy, ["tests/test_law.py", "tests/test_blind.py"], 120.0)
    killed = run_mutant(copy, version(), 120.0, 0)
    assert (killed.killer, killed.ended) == ("test_law.py::test_law", True)
    survived = run_mutant(copy, version(tests=("tests/test_blind.py",)), 120.0, 1)
    assert (survived.killer, survived.ended) == ("", True)
    # Equally long, and at once after another version: compiled files must not be taken for each other.
    again = run_mutant(copy, version(new="4 * x"), 120.0, 2)
    assert again.killer == "test_law.py::test_law"
    assert (copy / "room" / "law.py").read_text(encoding="utf-8") == before


def test_tests_that_never_end_kill_nothing(copy: Path) -> None:
    endless = run_mutant(copy, version(new="[0 for _ in iter(int, 1)]"), 4.0, 0)
    assert (endless.killer, endless.ended) == ("", False)


def test_a_copy_whose_tests_fail_already_is_refused(copy: Path) -> None:
    (copy / "room" / "law.py").write_text("def law(x):\n    return 5 * x\n", encoding="utf-8")
    with pytest.raises(InputError, match="without any wrong version"):
        mutants.check_copy(copy, ["tests/test_law.py"], 120.0)


def test_tests_that_do_not_exist_are_no_kill(copy: Path) -> None:
    with pytest.raises(InputError, match="did not run"):
        run_mutant(copy, version(tests=("tests/test_absent.py",)), 120.0, 0)


@pytest.mark.parametrize(
    ("changes", "words"),
    [({"old": "7 * x"}, "does not fit"), ({"old": "x"}, "does not fit"), ({"new": "2 * x"}, "does not fit"),
     ({"new": "2 * ("}, "no Python")],
)  # fmt: skip
def test_versions_that_do_not_fit_are_refused(changes: dict[str, object], words: str) -> None:
    with pytest.raises(InputError, match=words):
        applied(version(**changes), "def law(x):\n    return 2 * x\n")


def test_a_list_that_cannot_be_used_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "list.toml"
    path.write_text('[[mutant]]\nname = "a"\n', encoding="utf-8")
    with pytest.raises(InputError, match="cannot be read"):
        read_mutants(path)
    entry = '[[mutant]]\nname = "a"\nfile = "f"\nold = "x"\nnew = "y"\ntests = []\n'
    path.write_text(entry + entry, encoding="utf-8")
    with pytest.raises(InputError, match="one name"):
        read_mutants(path)


def test_a_text_that_no_version_holds_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert mutants.main(["--only", "no such version at all"]) == 2
    assert "nothing to run" in capsys.readouterr().err
