"""The documentation site shows every command, option, public name, field and variable; its commands can be typed; it builds."""

from __future__ import annotations

import importlib
import importlib.util
import re
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import pytest
from pydantic import BaseModel

import beambench
from beambench.captures.example import example_capture
from beambench.captures.layouts import LAYOUTS
from beambench.cli import app

from ._cli_options import OPTIONS


@pytest.fixture(scope="module")
def reference(project: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """{name: text} of the pages that are made from the code."""
    sys.path.insert(0, str(project / "docs"))
    try:
        build = importlib.import_module("build")
        written = build.write_reference(tmp_path_factory.mktemp("reference"))
    finally:
        sys.path.remove(str(project / "docs"))
        for name in ("build", *(name for name in sys.modules if name.split(".")[0] == "pages")):
            sys.modules.pop(name, None)
    return {path.name: path.read_text(encoding="utf-8") for path in written}


def test_every_command_and_option_is_shown(reference: dict[str, str]) -> None:
    sections = dict(re.findall(r"^## beambench ([^\n]+)\n(.*?)(?=^## |\Z)", reference["commands.md"], re.M | re.S))
    assert len(sections) > 25
    assert len(OPTIONS) > 100
    for line in OPTIONS:
        command, _, rest = line.partition(": ")
        name = rest.split(" ")[0]
        assert name in sections[command], f"{command}: {name} is not on the page"


def _missing(text: str, names: Iterator[str]) -> list[str]:
    return [name for name in names if name not in text]


def test_every_public_name_is_shown(reference: dict[str, str]) -> None:
    headings = {line.removeprefix("### ").replace("\\", "") for line in reference["python.md"].splitlines()}
    for room in (beambench, beambench.captures, beambench.estimators):
        missing = sorted(set(room.__all__) - headings)
        assert not missing, f"{room.__name__}: {missing} not on the page"
    assert {"load_scene", "generate", "run_suite"} <= headings


def _models(model: type[BaseModel], seen: set[type[BaseModel]]) -> Iterator[type[BaseModel]]:
    """A spec and all specs inside it, by their annotations."""
    if model in seen:
        return
    seen.add(model)
    yield model
    todo: list[Any] = [field.annotation for field in model.model_fields.values()]
    while todo:
        kind = todo.pop()
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            yield from _models(kind, seen)
        todo += get_args(kind)


@pytest.mark.parametrize(
    ("page", "home"),
    [
        ("scene-files.md", "beambench.scenes.scene:Scene"),
        ("suite-files.md", "beambench.benchmarks.suites.spec:Suite"),
        ("data-set-files.md", "beambench.scenes.datasets.spec:Dataset"),
    ],
)
def test_every_field_is_shown_with_its_unit(reference: dict[str, str], page: str, home: str) -> None:
    module, _, name = home.partition(":")
    spec = getattr(importlib.import_module(module), name)
    tables = dict(re.findall(r"^## (\S+)\n(.*?)(?=^## |\Z)", reference[page], re.M | re.S))
    found = list(_models(spec, set()))
    for model in found:
        own = tables[model.__name__]
        for field in model.model_fields:
            assert f"| `{field}` |" in own, f"{model.__name__}.{field} is not on {page}"
    assert len(found) > 3
    if page == "scene-files.md":
        assert re.search(r"\| `pulse_energy_j` \| number \| ≥ 1e-30, ≤ 1e\+06 \| J \| required \|", tables["Laser"])


@pytest.mark.parametrize("modality", sorted(LAYOUTS))
def test_every_variable_of_a_capture_is_shown(reference: dict[str, str], modality: str) -> None:
    own = reference["captures.md"].split(f"## {modality}\n")[1].split("\n## ")[0]
    capture = example_capture(modality)
    assert len(capture.variables) > 5
    missing = [name for name in map(str, capture.variables) if f"| `{name}` |" not in own]
    assert not missing


def pages(project: Path) -> list[Path]:
    """The hand-written pages that hold commands."""
    return [project / "README.md", project / "CONTRIBUTING.md", *sorted((project / "docs").rglob("*.md"))]


def typed(text: str) -> Iterator[str]:
    """The commands of a page that begin with beambench; a line that ends in a backslash goes on in the next."""
    for line in re.sub(r" *\\\n *", " ", text).splitlines():
        for part in line.split(" > ")[0].split("&&"):
            if re.match(r"\s*beambench [a-z]", part) and (line.startswith("    ") or "pip install" in line):
                yield part.strip()


def test_every_command_of_the_pages_can_be_typed(project: Path) -> None:
    found = [(path.name, line) for path in pages(project) for line in typed(path.read_text(encoding="utf-8"))]
    assert len(found) > 120
    for name, line in found:
        try:
            app.parse_args(shlex.split(line, comments=True)[1:], print_error=False, exit_on_error=False)
        except Exception as error:
            pytest.fail(f"{name}: {line}: {error}")
    with pytest.raises(Exception, match="no-such-option"):
        app.parse_args(["run", "quickstart", "--no-such-option"], print_error=False, exit_on_error=False)


def test_the_suite_of_the_guide_is_one(project: Path, tmp_path: Path) -> None:
    from beambench.benchmarks.suites.suite import load_suite

    text = (project / "docs" / "guides" / "researcher.md").read_text(encoding="utf-8")
    (snippet,) = re.findall(r"```toml\n(.*?)```", text, re.S)
    suite = tomllib.loads(snippet)
    suite["scenes"][0]["scene"] = "tilted-wall"
    assert load_suite(suite).suite.suite == "mine"


@pytest.mark.skipif(importlib.util.find_spec("sphinx") is None, reason="needs the extra `docs`")
def test_the_site_builds_without_warnings_and_links_hold(project: Path, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, str(project / "docs" / "build.py"), str(tmp_path / "site")],
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    assert (tmp_path / "site" / "searchindex.js").is_file()
