"""The rooms of the floors: their order, no import circles, no private names across files, short functions, and modalities only
in their own files and in the tables."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import pytest

from beambench.captures.layouts import LAYOUTS
from beambench.generator.models import MODELS
from beambench.health.modalities import NOT_YET, floors, modalities

from ._imports import FLOORS, circles, files_of, graph_of, imports_of

#: Rooms (folders, and files that lie beside them) of each floor, from the left: a file imports from its own room or from
#: rooms to its left. Files that are not named here stand left of all rooms and import none of them.
ORDER: dict[str, tuple[str, ...]] = {
    "optics": (
        "constants", "turns", "jit", "copying", "correlation", "accuracy", "water", "ambient", "amcw", "colorimetry",
        "illumination", "reflection", "ladar", "likelihood", "pile_up", "time_of_flight", "zernike", "turbulence", "lenslets",
        "reconstruction",
    ),
    "scenes": (
        "readers", "rigs", "materials", "procedural", "shapes", "spec_files", "mesh_surface", "meshes", "textures", "scene",
        "declared", "possible", "whole", "measured",
        "load", "rig_files", "grown", "datasets",
    ),
    "captures": (
        "quantities", "layouts", "padding", "validate", "store", "sources", "build", "compare", "hide", "public", "hdf5",
        "estimates", "example", "export", "contents", "readers", "lazy", "exports", "imports", "drivers", "recording",
    ),
    "generator": (
        "rays", "bsdf", "water", "paths", "request", "model", "gated", "ranger", "laser_line", "wavefront", "models", "checked",
        "preview", "captured", "generate", "workshop", "emulators",
    ),
    "estimators": (
        "labels", "rig", "declared", "response", "result", "builtin", "chain", "registry", "fit", "gated", "waveform", "amcw",
        "laser_line", "wavefront", "calibration",
        "listing", "package",
    ),
    "benchmarks": (
        "folders", "statistics", "suites", "scores", "bounds", "written", "judges", "runner", "laws", "report", "looks", "datasets",
        "card", "design", "search", "peers", "fidelity", "rungs", "ahead", "measure", "run", "gate", "twin", "checks",
        "reproduce",
    ),
    "api": ("output", "console", "health", "verbs", "commands", "cli", "__main__"),
}  # fmt: skip

#: Longest function, lines. Compiled kernels are one loop that a call would slow down.
LONGEST = 60

#: Tables that list modalities: name -> "module:object".
TABLES = {
    "scenes/rigs/__init__.py": "RIGS",
    "captures/layouts/__init__.py": "LAYOUTS",
    "captures/recording/recipe.py": "RECIPES",
    "generator/models.py": "MODELS",
    "generator/emulators/sights.py": "EMULATIONS",
    "estimators/builtin.py": "BUILTIN",
    "benchmarks/judges/__init__.py": "JUDGES",
    "benchmarks/looks/__init__.py": "LOOKS",
    "api/health/modalities.py": "NOT_YET",
}

#: Rooms and files that are about one instrument, not about any: published set-ups, comparisons, checks, a face for authors.
ONE_INSTRUMENT = (
    "benchmarks/reproduce", "benchmarks/peers", "benchmarks/checks", "benchmarks/fidelity", "estimators/__init__.py",
)  # fmt: skip


def room_of(name: str) -> tuple[str, str]:
    """(floor, room) of a file; a floor's own `__init__` is the room ""."""
    parts = name.split(".")[1:]
    if parts and parts[0] in FLOORS:
        return parts[0], parts[1] if len(parts) > 1 else ""
    return "api", parts[0] if parts else ""


def rightward(graph: Mapping[str, Mapping[str, int]], order: Mapping[str, tuple[str, ...]]) -> list[str]:
    """Imports within a floor that run against the written order."""
    wrong = []
    for importer, targets in graph.items():
        floor, room = room_of(importer)
        for target, line in targets.items():
            other, place = room_of(target)
            if other != floor or room == place or not place:
                continue
            named = order[floor]
            if not room:
                continue  # a floor's face offers what lies in its rooms
            if place in named and (room not in named or named.index(place) > named.index(room)):
                wrong.append(f"{importer}:{line} imports {target}, which lies to its right")
    return wrong


def private_imports(source: str) -> Iterator[tuple[int, str]]:
    """Names with a leading underscore that a source takes from another file."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and (node.level or (node.module or "").startswith("beambench")):
            yield from (
                (node.lineno, a.name) for a in node.names if a.name.startswith("_") and not a.name.startswith("__")
            )


def long_functions(source: str) -> Iterator[tuple[str, int]]:
    """Functions of more than `LONGEST` lines that are no kernels, with their lines."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            kernel = any("kernel" in ast.unparse(decorator) for decorator in node.decorator_list)
            lines = (node.end_lineno or node.lineno) - node.lineno + 1
            if lines > LONGEST and not kernel:
                yield node.name, lines


def modality_strings(source: str, modalities: Iterable[str]) -> Iterator[tuple[int, str]]:
    """Strings of a source that are equal to the name of a modality."""
    names = set(modalities)
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Constant) and node.value in names:
            yield node.lineno, str(node.value)


def is_of(path: Path, modality: str) -> bool:
    """Whether a file is of a modality: itself or a folder of its path has the modality's name, or begins with it."""
    return any(part == modality or part.startswith(f"{modality}_") for part in path.with_suffix("").parts)


def foreign_imports(graph: Mapping[str, Mapping[str, int]], files: Mapping[str, Path]) -> Iterator[str]:
    """Imports of a modality's files by files that are not of the modality, and not of a room about one instrument."""
    for importer, targets in graph.items():
        at = files[importer]
        if str(at) in ONE_INSTRUMENT or any(str(at).startswith(f"{room}/") for room in ONE_INSTRUMENT):
            continue
        for target, line in targets.items():
            for modality in LAYOUTS:
                if is_of(files[target], modality) and not is_of(at, modality):
                    yield f"{at}:{line} imports {target}"


def sources(project: Path) -> Iterator[tuple[Path, str]]:
    """(path inside the project, text) of every source of the package."""
    for path in files_of(project).values():
        yield path.relative_to(project), path.read_text(encoding="utf-8")


def test_no_circles(project: Path) -> None:
    graph = graph_of(project)
    assert sum(map(len, graph.values())) > 1000, "the reader of imports found next to none: it is broken"
    assert circles(graph) == []


def test_rooms_import_leftward(project: Path) -> None:
    for floor, rooms in ORDER.items():
        there = {path.stem if path.suffix == ".py" else path.name for path in (project / floor).iterdir()}
        assert not set(rooms) - there, f"{floor}/ has no {set(rooms) - there}"
        folders = {path.name for path in (project / floor).iterdir() if (path / "__init__.py").is_file()}
        missing = folders - set(rooms) - {"drivers", "emulators"}
        assert not missing, f"ORDER does not place {missing} of {floor}/"
    assert rightward(graph_of(project), ORDER) == []


def test_no_private_name_crosses_files(project: Path) -> None:
    assert [f"{path}:{line} {name}" for path, text in sources(project) for line, name in private_imports(text)] == []


def test_functions_are_short(project: Path) -> None:
    found = [f"{path} {name}: {lines} lines" for path, text in sources(project) for name, lines in long_functions(text)]
    assert found == []


def test_modalities_stand_in_their_files_and_the_tables(project: Path) -> None:
    wrong = []
    for path, text in sources(project):
        if str(path) in TABLES:
            continue
        wrong += [f"{path}:{line} {name!r}" for line, name in modality_strings(text, LAYOUTS) if not is_of(path, name)]
    assert wrong == []


def test_only_a_modality_imports_its_files(project: Path) -> None:
    files = {name: path.relative_to(project) for name, path in files_of(project).items()}
    assert list(foreign_imports(graph_of(project), files)) == []


def test_every_floor_has_every_modality_or_says_why_not() -> None:
    there = floors()
    names = set().union(*there.values())
    assert names == set(LAYOUTS), "a modality without a layout"
    lacking = {(floor, name) for floor, known in there.items() for name in names - known}
    assert lacking == set(NOT_YET), "NOT_YET names what is there, or lacks what is not"
    assert {finding.state for finding in modalities()} <= {"ok", "missing"}


# ---------------------------------------------------------------- each rule fails on a planted breach


def test_a_circle_is_found() -> None:
    files = dict.fromkeys(("beambench.optics.a", "beambench.optics.b", "beambench.optics.c"))
    text = "def f():\n    from .b import g"
    assert list(imports_of(text, "beambench.optics.a", False, files)) == [(2, "beambench.optics.b")]
    graph = {"a": {"b": 1}, "b": {"c": 1}, "c": {"a": 1}, "d": {"a": 1}}
    assert circles(graph) == [["a", "b", "c"]]
    assert circles({"a": {"b": 1}, "b": {}}) == []


@pytest.mark.parametrize(
    ("importer", "target", "breach"),
    [
        ("beambench.generator.rays.trace", "beambench.generator.gated.model", True),
        ("beambench.generator.random", "beambench.generator.gated.model", True),
        ("beambench.generator.gated.model", "beambench.generator.rays.trace", False),
        ("beambench.generator.gated.model", "beambench.generator.random", False),
        ("beambench.verbs.run", "beambench.commands.run", True),
        ("beambench", "beambench.verbs.run", False),
    ],
)
def test_a_rightward_import_is_found(importer: str, target: str, breach: bool) -> None:
    assert bool(rightward({importer: {target: 3}}, ORDER)) is breach


def test_a_borrowed_private_name_is_found() -> None:
    assert list(private_imports("def f():\n    from ..x import _y, z, __all__")) == [(2, "_y")]
    assert list(private_imports("from numpy import _core")) == []


def test_a_long_function_is_found() -> None:
    body = "\n".join(["    x = 1"] * LONGEST)
    assert list(long_functions(f"def f():\n{body}")) == [("f", LONGEST + 1)]
    assert list(long_functions(f"@kernel(fastmath=True)\ndef f():\n{body}")) == []
    assert list(long_functions(f"class A:\n  def f():\n{body}")) == [("f", LONGEST + 1)]


def test_a_modality_outside_its_files_is_found() -> None:
    text = 'if modality == "gated":\n    pass\nelse:\n    table = {"wavefront": 1}\n"gated captures"'
    assert list(modality_strings(text, LAYOUTS)) == [(1, "gated"), (4, "wavefront")]
    assert is_of(Path("generator/gated/full.py"), "gated") and is_of(Path("benchmarks/bounds/gated_scan.py"), "gated")
    assert not is_of(Path("generator/generate.py"), "gated") and not is_of(Path("generator/propagated.py"), "gated")


def test_a_modality_without_record_or_reason_is_broken(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(MODELS, "amcw")
    (finding,) = (one for one in modalities() if one.name == "amcw")
    assert finding.state == "broken" and "no reason given" in finding.advice
    monkeypatch.setitem(NOT_YET, ("generator", "amcw"), "not built")
    (finding,) = (one for one in modalities() if one.name == "amcw")
    assert finding.state == "missing" and "not built" in finding.advice


def test_a_foreign_import_is_found() -> None:
    names = ("generator/generate", "generator/gated/full", "optics/jit", "generator/ranger/waveform")
    files = {name: Path(f"{name}.py") for name in names}
    graph = {"generator/generate": {"generator/gated/full": 4}, "generator/gated/full": {"optics/jit": 1}}
    assert list(foreign_imports(graph, files)) == ["generator/generate.py:4 imports generator/gated/full"]
    graph = {"generator/gated/full": {"generator/ranger/waveform": 2}}
    assert len(list(foreign_imports(graph, files))) == 1


def test_tables_name_real_files(project: Path) -> None:
    for path, name in TABLES.items():
        assert f"{name}" in (project / path).read_text(encoding="utf-8"), f"{path} holds no {name}"


def test_orders_are_complete_and_unique() -> None:
    count: dict[str, int] = defaultdict(int)
    for floor, rooms in ORDER.items():
        assert len(set(rooms)) == len(rooms)
        count[floor] += len(rooms)
    assert set(count) == set(FLOORS)
