"""The recipes "a scene" and "a stress axis" of CONTRIBUTING.md, followed word for word."""

from __future__ import annotations

import ast
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from beambench.benchmarks.suites.changes import __all__ as CHANGES
from beambench.generator.generate import generate
from beambench.scenes import load

from ._guide import block, recipe

FLOORS = ("optics", "captures", "generator", "estimators")


def test_the_scene_of_the_guide(project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text, (path,) = recipe(project, "a scene"), re.findall(r"scenes/library/[\w-]+\.toml", recipe(project, "a scene"))
    shutil.copytree(load.LIBRARY, tmp_path / "scenes" / "library")
    (tmp_path / path).write_text(block(project, "a scene", "toml"), encoding="utf-8")
    monkeypatch.setattr(load, "LIBRARY", tmp_path / "scenes" / "library")
    name = Path(path).stem
    assert name in load.list_scenes()
    scene = load.load_scene(name)
    assert scene.name == name and "beambench scenes show" in text
    capture = generate(scene, seed=1, fidelity="direct")
    # A wall turned by β about the vertical at z₀ on the axis: range z₀ cos β/cos(θ + β) or (θ − β), by the sign of the turn.
    angle = np.linspace(-0.2, 0.2, 64)
    turned = [2.0 * np.cos(np.deg2rad(20.0)) / np.cos(angle + sign * np.deg2rad(20.0)) for sign in (-1, 1)]
    truth = capture["truth_range"].values
    assert min(np.abs(truth - one).max() for one in turned) < 1e-6


def _insert(file: Path, name: str, line: str) -> None:
    """Put a line at the end of the table of that name: a dict, a keyword's dict, or the tuple that a dict is made of."""
    source = file.read_text(encoding="utf-8")
    tables: list[ast.expr | None] = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.keyword) and node.arg == name:
            tables.append(node.value)
        elif isinstance(node, ast.AnnAssign | ast.Assign):
            target = node.target if isinstance(node, ast.AnnAssign) else node.targets[0]
            tables += [node.value] if getattr(target, "id", "") == name else []
    (table,) = tables
    table = table.generators[0].iter if isinstance(table, ast.DictComp) else table
    lines = source.splitlines(keepends=True)
    assert table is not None and table.end_lineno is not None
    lines.insert(table.end_lineno - 1, line)
    file.write_text("".join(lines), encoding="utf-8")


def _copy(project: Path, to: Path) -> None:
    """The house with scenes and benchmarks of its own, and the test of stress axes; the other floors are links."""
    package = to / "beambench"
    shutil.copytree(project / "api", package, ignore=shutil.ignore_patterns("__pycache__"))
    for floor in ("scenes", "benchmarks"):
        shutil.copytree(project / floor, to / floor, ignore=shutil.ignore_patterns("__pycache__"))
        (package / floor).symlink_to(to / floor)
    for floor in FLOORS:
        (package / floor).symlink_to(project / floor)
    (to / "tests").mkdir()
    shutil.copy(project / "tests" / "test_benchmarks_stress.py", to / "tests")


_USE = """
import sys
sys.path[:0] = [{house!r}, {tests!r}]
import test_benchmarks_stress as tests
from beambench import scenes
assert scenes.__file__.startswith({house!r}), scenes.__file__
tests.test_every_axis_changes_the_scene()
tests.test_neutral_levels_change_nothing()
from beambench.benchmarks.suites.stress import axis_overrides
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene
for scene, path in (("flat-wall", "rig.detector.dark_current_e_per_s"), ("counter", "rig.detector.dark_e_per_s")):
    assert axis_overrides(load_scene(scene), "dark", 7.0) == {{path: 7.0}}
try:
    axis_overrides(load_scene("amcw"), "dark", 7.0)
except InputError as error:
    assert "does not apply" in error.what and "gated, waveform" in error.allowed
    print("ok")
"""


def test_the_stress_axis_of_the_guide(project: Path, tmp_path: Path) -> None:
    _copy(project, tmp_path)
    code = block(project, "a stress axis", "python")
    steps = re.findall(r"^# (\S+): (\w+)\n((?:[^#\n].*\n)+)", code, re.MULTILINE)
    assert len(steps) == 5 and sum(len(line) for *_, line in steps) > 0
    for file, table, line in steps:
        _insert(tmp_path / file, table, line)
    use = _USE.format(house=str(tmp_path), tests=str(tmp_path / "tests"))
    ran = subprocess.run([sys.executable, "-c", use], capture_output=True, text=True, cwd=tmp_path, check=False)
    assert ran.returncode == 0 and ran.stdout == "ok\n", ran.stderr


def test_the_changes_that_the_guide_names_exist(project: Path) -> None:
    named = re.findall(r"`(\w+)`", recipe(project, "a stress axis").partition("```")[2].rpartition("```")[2])
    assert {"set_to", "multiply", "add", "set_present"} <= set(named) & set(CHANGES)
