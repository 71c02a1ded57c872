"""Each tutorial of the site runs top to bottom, finds what it says, and makes its figure."""

from __future__ import annotations

import importlib.util
import re
import warnings
from pathlib import Path
from types import ModuleType

import pytest

#: Tutorials of more than a minute of CPU time.
LONG = ("line-survey",)


@pytest.fixture(scope="module")
def runner(project: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location("tutorials_run", project / "docs" / "tutorials" / "run.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def executed(runner: ModuleType, name: str, folder: Path) -> None:
    with warnings.catch_warnings():  # a tutorial may silence warnings, of which the next test must not lose any
        assert runner.execute(name, folder).read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    "name",
    [
        "first-capture",
        "your-own-estimator",
        "your-own-rig",
        "water-and-rungs",
        "speed-accuracy",
        "turbulence",
        "training",
        "twin-certificate",
    ],
)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_tutorial_finds_what_it_says(runner: ModuleType, name: str, tmp_path: Path) -> None:
    executed(runner, name, tmp_path)


@pytest.mark.slow
@pytest.mark.usefixtures("long_run")
@pytest.mark.parametrize("name", LONG)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_long_tutorial_finds_what_it_says(runner: ModuleType, name: str, tmp_path: Path) -> None:
    executed(runner, name, tmp_path)


def test_every_tutorial_is_run_and_is_on_the_site(runner: ModuleType, project: Path) -> None:
    names = runner.names()
    tested = Path(__file__).read_text(encoding="utf-8")
    index = (project / "docs" / "index.md").read_text(encoding="utf-8")
    assert len(names) >= 9
    for name in names:
        assert f'"{name}"' in tested, f"{name} is run by no test"
        assert f"\ntutorials/{name}\n" in index, f"{name} is not on the site"
        assert (project / "docs" / "tutorials" / f"{name}.png").is_file(), f"python docs/tutorials/run.py {name}"


def test_every_tutorial_asserts_and_shows_its_figure(runner: ModuleType, project: Path) -> None:
    for name in runner.names():
        text = (project / "docs" / "tutorials" / f"{name}.md").read_text(encoding="utf-8")
        program = runner.program_of(name)
        assert len(re.findall(r"^assert ", program, re.M)) >= 2, f"{name} asserts too little"
        assert "What you should see" in text and f"]({name}.png)" in text and "figure.png" in program


def test_a_wrong_statement_fails_on_the_line_of_the_page(
    runner: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "wrong.md").write_text("# Wrong\n\n```text\nassert False\n```\n\n```python\nassert 1 == 2\n```\n")
    monkeypatch.setattr(runner, "HERE", tmp_path)
    with pytest.raises(AssertionError) as found:
        runner.execute("wrong", tmp_path)
    assert found.traceback[-1].lineno == 7
