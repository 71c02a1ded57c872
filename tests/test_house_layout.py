"""The layout of the project: packaging lists every folder, typings link to it, and the sources follow the rules."""

from __future__ import annotations

import ast
import re
import subprocess
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

FLOORS = ("optics", "scenes", "captures", "generator", "estimators", "benchmarks", "api")
LONGEST = 400  # lines of one file


def packages(project: Path) -> dict[str, str]:
    """Package name -> folder, from the folders that hold Python files."""
    found = {}
    for floor in FLOORS:
        folders = {path.parent for path in (project / floor).rglob("*.py")} | {project / floor}
        for folder in folders:
            inside = folder.relative_to(project).as_posix()
            dotted = inside.replace("/", ".")
            found[
                "beambench" if floor == "api" and folder.name == "api" else f"beambench.{dotted.removeprefix('api.')}"
            ] = inside
    return found


def sources(project: Path) -> Iterator[Path]:
    for floor in FLOORS:
        yield from sorted((project / floor).rglob("*.py"))


def name_of(path: Path, project: Path) -> str:
    return path.relative_to(project).as_posix()


def parsed(path: Path) -> ast.Module:
    """The file's tree; a syntax that the oldest Python lacks fails with the file's name."""
    return ast.parse(path.read_text(encoding="utf-8"), filename=str(path), feature_version=(3, 11))


@pytest.fixture(scope="module")
def setuptools_table(project: Path) -> dict[str, Any]:
    table: dict[str, Any] = tomllib.loads((project / "pyproject.toml").read_text(encoding="utf-8"))["tool"][
        "setuptools"
    ]
    return table


def test_every_folder_is_packaged(project: Path, setuptools_table: dict[str, Any]) -> None:
    found = packages(project)
    assert len(found) >= 13
    assert sorted(setuptools_table["packages"]) == sorted(found)
    assert setuptools_table["package-dir"] == found
    for folder in found.values():
        assert (project / folder / "__init__.py").is_file(), f"{folder} has no __init__.py"


def test_typings_link_to_the_rooms(project: Path) -> None:
    """For type checkers `typings/beambench` is the package: api's files beside links to the other rooms."""
    typings = project / "typings" / "beambench"
    expected = {floor: f"../../{floor}" for floor in FLOORS if floor != "api"}
    for path in (project / "api").iterdir():
        if path.suffix == ".py" or (path.is_dir() and (path / "__init__.py").is_file()):
            expected[path.name] = f"../../api/{path.name}"
    found = {}
    for link in typings.iterdir():
        if link.name == "py.typed" or link.name.startswith((".", "__pycache__")):
            continue
        assert link.is_symlink(), f"typings/beambench/{link.name} is a copy, not a link"
        assert link.exists(), f"typings/beambench/{link.name} points nowhere"
        found[link.name] = link.readlink().as_posix()
    missing = "; ".join(f"ln -s {expected[n]} typings/beambench/{n}" for n in sorted(expected.keys() - found.keys()))
    assert found == expected, f"missing: {missing or 'none'}; too many: {sorted(found.keys() - expected.keys())}"


def test_no_runtime_code_uses_typings(project: Path) -> None:
    assert not [name_of(p, project) for p in sources(project) if '"typings' in p.read_text(encoding="utf-8")]


def test_numba_has_one_door(project: Path) -> None:
    """Only optics/jit.py imports Numba: its cache is the one that cannot be stale."""
    wrong = []
    for path in sources(project):
        if name_of(path, project) == "optics/jit.py":
            continue
        for node in ast.walk(parsed(path)):
            names: list[str] = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and not node.level:
                names = [node.module or ""]
            elif isinstance(node, ast.Attribute) and node.attr in {"njit", "guvectorize"}:
                names = ["numba"]
            wrong += [f"{name_of(path, project)}: {name}" for name in names if name.split(".")[0] == "numba"]
    assert not wrong, f"import `kernel` (and `prange`) from optics/jit.py instead: {wrong}"


def _unsafe(tree: ast.AST) -> Iterator[tuple[int, str]]:
    modules = {"pickle", "cPickle", "dill", "cloudpickle", "shelve", "marshal", "joblib"}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, a.name) for a in node.names if a.name.split(".")[0] in modules)
        elif isinstance(node, ast.ImportFrom) and not node.level:
            if (node.module or "").split(".")[0] in modules:
                yield node.lineno, str(node.module)
        elif isinstance(node, ast.Call):
            if isinstance(node.func, ast.Name) and node.func.id in {"eval", "exec", "compile", "__import__"}:
                yield node.lineno, node.func.id
            if isinstance(node.func, ast.Attribute) and isinstance(node.func.value, ast.Name):
                called = f"{node.func.value.id}.{node.func.attr}"
                if called in {"yaml.load", "os.system", "os.popen", "pd.read_pickle", "pd.eval"}:
                    yield node.lineno, called
            for keyword in node.keywords:
                given = isinstance(keyword.value, ast.Constant) and keyword.value.value is True
                if given and keyword.arg in {"shell", "allow_pickle"}:
                    yield node.lineno, f"{keyword.arg}=True"


def test_no_door_to_foreign_code(project: Path) -> None:
    """Data never runs: no pickles, no evaluated text, no shell."""
    wrong = [
        f"{name_of(path, project)}:{line} {what}" for path in sources(project) for line, what in _unsafe(parsed(path))
    ]
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize(
    "line",
    ["import pickle", "from dill import loads", "eval('1')", "exec(text)", "subprocess.run(c, shell=True)",
     "np.load(f, allow_pickle=True)", "yaml.load(f)", "os.system(c)"],
)  # fmt: skip
def test_reader_of_foreign_code_works(line: str) -> None:
    assert list(_unsafe(ast.parse(line)))


def test_files_are_short(project: Path) -> None:
    lengths = {
        name_of(path, project): len(path.read_text(encoding="utf-8").splitlines())
        for path in [*sources(project), *(project / "tests").glob("*.py")]
    }
    print("longest files:", sorted(lengths.items(), key=lambda item: -item[1])[:5])
    assert not {name: n for name, n in lengths.items() if n > LONGEST}


def test_everything_public_is_documented(project: Path) -> None:
    wrong = []
    for path in sources(project):
        tree = parsed(path)
        public = [n for n in tree.body if isinstance(n, ast.FunctionDef | ast.ClassDef) and not n.name.startswith("_")]
        methods = [
            m
            for c in public
            if isinstance(c, ast.ClassDef)
            for m in c.body
            if isinstance(m, ast.FunctionDef) and not m.name.startswith("_") and not _is_validator(m)
        ]
        if tree.body and not ast.get_docstring(tree):
            wrong.append(f"{name_of(path, project)}: the file itself")
        wrong += [
            f"{name_of(path, project)}:{n.lineno} {n.name}" for n in [*public, *methods] if not ast.get_docstring(n)
        ]
    assert not wrong, "\n".join(wrong)


def _is_validator(method: ast.FunctionDef) -> bool:
    """pydantic calls these by their decorator; the class's docstring says what is allowed."""
    return any(
        "validator" in ast.dump(d) or "overload" in ast.dump(d) or "serializer" in ast.dump(d)
        for d in method.decorator_list
    )


def test_nothing_is_left_for_later(project: Path) -> None:
    words = re.compile(r"\b(TODO|FIXME|XXX|HACK|raise NotImplementedError|[Pp]laceholder|[Ff]or now)\b")
    wrong = [
        f"{name_of(path, project)}:{number} {line.strip()}"
        for path in sources(project)
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if words.search(line)
    ]
    assert not wrong, "\n".join(wrong)


def _project_files(project: Path) -> list[Path]:
    """Files that belong to the project: git's own list where there is a repository, else everything but leftovers."""
    listed = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard", "-z"], cwd=project, capture_output=True, text=True, check=False
    )
    if listed.returncode == 0 and listed.stdout:
        return [project / name for name in listed.stdout.split("\0") if name and (project / name).is_file()]
    left = (
        "__pycache__",
        ".egg-info",
        "/.venv",
        "/build/",
        "/dist/",
        "_cache/",
        "/.git/",
        "/.hypothesis/",
        "beambench-runs",
    )
    return [p for p in project.rglob("*") if p.is_file() and not any(part in p.as_posix() for part in left)]


def test_no_machine_path_and_no_registry_host(project: Path) -> None:
    """What is written must hold on any machine. The forbidden words are built here, for this file is read too."""
    words = ["/" + folder + "/" for folder in ("wo" + "rk", "ho" + "me", "ro" + "ot", "Use" + "rs")]
    words += [
        "py" + "pi.org",
        "python" + "hosted.org",
        "anaconda" + ".org",
        "index" + "-url",
        "npmjs" + ".org",
        "/opt/" + "wheels",
    ]
    pattern = re.compile("|".join(re.escape(word) for word in words) + r"|\b(?:\d{1,3}\.){3}\d{1,3}:\d+")
    files = _project_files(project)
    assert len(files) > 50
    wrong = []
    for path in files:
        content = path.read_bytes()
        if b"\0" in content:
            continue  # an array or a picture
        for number, line in enumerate(content.decode("utf-8").splitlines(), 1):
            if match := pattern.search(line):
                wrong.append(f"{name_of(path, project)}:{number} {match.group()}")
    assert not wrong, "\n".join(wrong)


def test_data_grids_hold_plain_numbers(project: Path) -> None:
    """Every grid of the library: small, one two-dimensional array of finite numbers, its origin stated beside it."""
    import numpy as np

    grids = sorted((project / "scenes" / "library").glob("*.npz"))
    assert grids
    for path in grids:
        assert path.stat().st_size < 60_000
        assert (path.parent / f"{path.stem}.SOURCE.txt").is_file()
        with np.load(path, allow_pickle=False) as content:
            (array,) = (content[key] for key in content.files)
        assert array.ndim == 2 and np.isfinite(array).all() and np.ptp(array) > 0
