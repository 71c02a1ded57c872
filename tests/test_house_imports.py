"""The floors: imports point down only, and estimators and generator never import each other."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

FLOORS = {"optics": 0, "scenes": 1, "captures": 2, "generator": 3, "estimators": 3, "benchmarks": 4, "api": 5}
LAZY = re.compile(r"beambench\.(\w+)(?:\.\w+)*:\w+")  # an entry of a table "module:function"


def floor_of(dotted: str) -> str | None:
    """The floor that holds a module, None where it is not ours; `beambench` itself is the api."""
    parts = dotted.split(".")
    if parts[0] != "beambench":
        return None
    return parts[1] if len(parts) > 1 and parts[1] in FLOORS else "api"


def module_name(floor: str, path: Path) -> str:
    """Dotted name of a file, given by its path inside its floor's folder."""
    parts = ["beambench", *([] if floor == "api" else [floor]), *path.with_suffix("").parts]
    return ".".join(parts)


def imported(source: str, module: str, file: str = "<text>") -> Iterator[tuple[int, str]]:
    """(line, dotted name) of every import of a source: anywhere, relative or absolute, by statement or by call."""
    package = module.removesuffix(".__init__") if module.endswith(".__init__") else module.rpartition(".")[0]
    for node in ast.walk(ast.parse(source, filename=file)):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield node.lineno, alias.name
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                above = package.split(".")[: len(package.split(".")) - node.level + 1]
                base = ".".join([*above, base] if base else above)
            for (
                alias
            ) in node.names:  # `from .. import scenes` names a module, `from ..scenes import Scene` an object in one
                yield node.lineno, f"{base}.{alias.name}"
        elif isinstance(node, ast.Call):
            called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            if called in {"import_module", "find_spec", "__import__"} and node.args:
                name = node.args[0]
                if isinstance(name, ast.Constant) and isinstance(name.value, str):
                    level = len(name.value) - len(name.value.lstrip("."))
                    above = package.split(".")[: len(package.split(".")) - level + 1] if level else []
                    yield node.lineno, ".".join([*above, name.value.lstrip(".")])
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and LAZY.fullmatch(node.value):
            yield node.lineno, node.value.partition(":")[0]


def allowed(importer: str, target: str) -> bool:
    """Down or on the same floor; the two rooms of one floor, generator and estimators, never see each other."""
    return importer == target or FLOORS[target] < FLOORS[importer]


def _sources(project: Path) -> Iterator[tuple[str, Path, Path]]:
    for floor in FLOORS:
        for path in sorted((project / floor).rglob("*.py")):
            yield floor, path, path.relative_to(project / floor)


def test_every_import_points_down(project: Path) -> None:
    seen, wrong = 0, []
    for floor, path, inside in _sources(project):
        for line, name in imported(path.read_text(encoding="utf-8"), module_name(floor, inside), str(path)):
            target = floor_of(name)
            seen += target is not None
            if target is not None and not allowed(floor, target):
                wrong.append(f"{floor}/{inside}:{line} imports {name}")
    assert seen > 20, "the reader of imports found next to none: it is broken"
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize(
    ("line", "target"),
    [
        ("from ...generator import trace", "generator"),
        ("from ... import generator", "generator"),
        ("def f():\n    from ...generator.trace import hits", "generator"),
        ("import beambench.benchmarks.runner.session as r", "benchmarks"),
        ("from beambench import generate", "api"),
        ("import importlib\nimportlib.import_module('...generator.trace', __package__)", "generator"),
        ("TABLE = {'x': 'beambench.generator.rays.trace:hits'}", "generator"),
    ],
)
def test_reader_sees_every_way_to_import(line: str, target: str) -> None:
    floors = {floor_of(name) for _, name in imported(line, "beambench.estimators.gated.peak")}
    assert target in floors
    assert not allowed("estimators", target)


_ALONE = """
import importlib, pkgutil, sys
for name in {forbidden!r}:
    sys.modules[name] = None  # an import of it fails; asking where it lies does not
room = importlib.import_module("beambench.{room}")
names = [m.name for m in pkgutil.walk_packages(room.__path__, room.__name__ + ".")]
names = [n for n in names if not n.startswith({apart!r})]
for name in names:
    importlib.import_module(name)
loaded = [m for m in sys.modules if sys.modules[m] and any(m == f or m.startswith(f + ".") for f in {forbidden!r})]
assert not loaded, loaded
print(len(names))
"""


@pytest.mark.parametrize(
    ("room", "forbidden", "apart"),
    [
        ("estimators", ("beambench.generator", "mitsuba", "drjit", "mitransient"), ()),
        ("generator", ("beambench.estimators",), ()),
        # Scoring, reporting and gating work without a renderer; what reproduces or races one is apart.
        (
            "benchmarks",
            ("mitsuba", "drjit", "mitransient"),
            ("beambench.benchmarks.peers", "beambench.benchmarks.reproduce"),
        ),
    ],
)
def test_room_imports_alone(room: str, forbidden: tuple[str, ...], apart: tuple[str, ...], tmp_path: Path) -> None:
    code = _ALONE.format(room=room, forbidden=forbidden, apart=apart)
    run = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False
    )
    assert run.returncode == 0, run.stderr
    assert int(run.stdout) > 3, "next to no module was imported"
