"""A wheel built from the sdist and installed elsewhere is the whole package, with its data and its command."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import pytest

FLOORS = ("optics", "scenes", "captures", "generator", "estimators", "benchmarks", "api")
DATA = ("py.typed", "library", "suites", "templates")
LEFTOVERS = (
    ".git",
    "__pycache__",
    "*.pyc",
    "*.egg-info",
    "build",
    "dist",
    ".venv",
    ".*_cache",
    ".hypothesis",
    "beambench-runs",
)


def run(command: list[str], cwd: Path) -> str:
    """Run a command in a clean environment; fails the test with what it printed."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "PYTEST", "DRJIT"))}
    done = subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, f"{' '.join(command)}\n{done.stdout[-2000:]}\n{done.stderr[-4000:]}"
    return done.stdout


def setuptools_is_recent() -> bool:
    """With the setuptools that pyproject.toml requires, nothing is downloaded; else `build` makes its own environment."""
    try:
        return int(version("setuptools").split(".")[0]) >= 77
    except PackageNotFoundError:
        return False


def in_wheel(path: Path) -> str:
    """Where a file of a floor lies inside the wheel: `api/` is the package `beambench` itself."""
    return (
        path.as_posix().replace("api/", "beambench/", 1) if path.parts[0] == "api" else f"beambench/{path.as_posix()}"
    )


@pytest.mark.slow
def test_wheel_installed_elsewhere(project: Path, tmp_path: Path) -> None:
    # A copy, so that nothing is written beside the sources and no old `build/` brings back a deleted module.
    tree = tmp_path / "tree"
    shutil.copytree(project, tree, symlinks=True, ignore=shutil.ignore_patterns(*LEFTOVERS))
    options = ["--no-isolation"] if setuptools_is_recent() else []
    run([sys.executable, "-m", "build", *options, "--outdir", str(tmp_path / "dist"), str(tree)], tmp_path)
    (wheel,) = (tmp_path / "dist").glob("*.whl")
    assert list((tmp_path / "dist").glob("*.tar.gz")), "`build` makes the wheel from the sdist"

    with zipfile.ZipFile(wheel) as archive:
        packed = {name for name in archive.namelist() if not name.split("/")[0].endswith(".dist-info")}
    expected = set()
    for floor in FLOORS:
        for path in (tree / floor).rglob("*"):
            inside = path.relative_to(tree)
            if path.is_file() and (path.suffix == ".py" or any(part in DATA for part in inside.parts)):
                expected.add(in_wheel(inside))
    assert any(name.endswith(".toml") for name in expected) and "beambench/scenes/library/relief.npz" in expected
    assert packed == expected, f"missing {sorted(expected - packed)}, too many {sorted(packed - expected)}"

    # The dependencies are those of this environment, seen through a path file: 1.5 GB are not installed twice.
    venv = tmp_path / "venv"
    run([sys.executable, "-m", "venv", "--without-pip", str(venv)], tmp_path)
    python = str(venv / "bin" / "python")
    site = Path(run([python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"], tmp_path).strip())
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    pip = [sys.executable, "-m", "pip", "--python", python, "install", "--no-deps", "--no-index", "--force-reinstall"]
    run([*pip, str(wheel)], tmp_path)

    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    where = run(
        [python, "-c", "import beambench, beambench.optics as o; print(beambench.__file__, o.__file__)"], elsewhere
    )
    assert all(Path(name).is_relative_to(site) for name in where.split()), where
    assert "Usage" in run([str(venv / "bin" / "beambench"), "--help"], elsewhere)
    assert "Usage" in run([python, "-m", "beambench", "--help"], elsewhere)
    assert "flat-wall" in run([str(venv / "bin" / "beambench"), "scenes", "list"], elsewhere)
    assert not list(elsewhere.iterdir()), "asking for help writes nothing"
