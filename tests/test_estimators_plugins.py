"""Third-party estimators: a package installed with pip is checked against the laws and run; and faulty packages."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

import beambench

SIZE = {"rig.camera.rows": 8, "rig.camera.cols": 8}


def _wheel(package: Path, folder: Path) -> Path:
    """The wheel of a one-module package by its pyproject.toml, made by hand: no build backend, old or new, is needed."""
    project = tomllib.loads((package / "pyproject.toml").read_text())
    name, version = project["project"]["name"].replace("-", "_"), project["project"]["version"]
    info = f"{name}-{version}.dist-info"
    groups = project["project"]["entry-points"]
    entries = "".join(f"[{g}]\n" + "".join(f"{k} = {v}\n" for k, v in items.items()) for g, items in groups.items())
    files = {
        f"{module}.py": (package / f"{module}.py").read_text() for module in project["tool"]["setuptools"]["py-modules"]
    }
    files |= {
        f"{info}/METADATA": f"Metadata-Version: 2.1\nName: {project['project']['name']}\nVersion: {version}\n",
        f"{info}/WHEEL": "Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
        f"{info}/entry_points.txt": entries,
    }
    files[f"{info}/RECORD"] = "".join(f"{path},,\n" for path in [*files, f"{info}/RECORD"])
    path = folder / f"{name}-{version}-py3-none-any.whl"
    with zipfile.ZipFile(path, "w") as archive:
        for inside, text in files.items():
            archive.writestr(inside, text)
    return path


def _install(package: Path, site: Path) -> None:
    """pip as a user would call it, with no network."""
    if importlib.util.find_spec("pip") is None:
        pytest.skip("pip is not installed")
    flags = ["--no-index", "--no-deps", "--disable-pip-version-check", "--quiet"]
    wheel = _wheel(package, site.parent)
    command = [sys.executable, "-m", "pip", "install", *flags, "--target", str(site), str(wheel)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def _beambench(site: Path, *arguments: str, folder: Path | None = None) -> subprocess.CompletedProcess[str]:
    return _python(site, "-m", "beambench", *arguments, folder=folder)


def _python(site: Path, *arguments: str, folder: Path | None = None) -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join(filter(None, [str(site), os.environ.get("PYTHONPATH", "")]))
    return subprocess.run(
        [sys.executable, *arguments], capture_output=True, text=True, check=False, cwd=folder,
        env={**os.environ, "PYTHONPATH": path},
    )  # fmt: skip


def _suite(folder: Path, estimators: list[str], warmup_s: float = 25.0) -> Path:
    data: dict[str, Any] = {
        "suite": "plugins", "scenes": [{"scene": "flat-wall", "overrides": SIZE}], "estimators": estimators,
        "seeds": {"test": [1]}, "limits": {"time_s": 3.0, "memory_bytes": 2**31, "output_bytes": 65536, "warmup_s": warmup_s},
    }  # fmt: skip
    path = folder / "plugins.json"
    path.write_text(json.dumps(data))
    return path


def _scores(out: Path) -> pd.DataFrame:
    table = pd.read_csv(out / "scores.csv")
    return table[table["quantity"] == "range"].set_index("estimator")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("plugin")
    package = beambench.estimators_new("my-median", out=folder / "my-median")
    _install(package, folder / "site")
    assert list((folder / "site").glob("beambench_my_median-*.dist-info/entry_points.txt"))
    return folder / "site"


def test_an_installed_plugin_is_listed_and_keeps_the_laws(site: Path) -> None:
    listed = _beambench(site, "estimators", "list", "--json")
    rows = {row["name"]: row for row in json.loads(listed.stdout)}
    assert rows["my-median"]["origin"] == "plug-in" and rows["peak"]["origin"] == "built-in"
    assert rows["my-median"]["parameters"] == {"least_sigmas": 5.0, "reach": 3.0}
    checked = _beambench(site, "estimators", "check", "my-median", "--json")
    assert checked.returncode == 0, checked.stdout + checked.stderr
    found = json.loads(checked.stdout)
    assert found["ok"] and len(found["laws"]) >= 9


def test_an_installed_plugin_runs_in_a_suite(site: Path, tmp_path: Path) -> None:
    if importlib.util.find_spec("mitsuba") is None:
        pytest.skip("Mitsuba is not installed")
    out = tmp_path / "run"
    suite = _suite(tmp_path, ["my-median", "my-median[reach=2.5]", "peak"])
    done = _beambench(site, "run", str(suite), "-o", str(out))
    assert done.returncode == 0, done.stdout + done.stderr
    table = _scores(out)
    assert (table["status"] == "ok").all() and len(table) == 3
    # 160 photoelectrons under a 1 ns response in .15 ns steps: the median's error is millimetres; a slice is 22 mm.
    assert (table.loc[["my-median"], "rmse_full"] < 0.022).all()


#: Entry points of one package that misbehaves in each way: name -> function, and the module that they live in.
HOSTILE = {
    "raises-at-import": ("hostile_import", "answer"),
    "leaves-at-import": ("hostile_exit", "answer"),
    "hangs": ("hostile_calls", "hangs"),
    "prints": ("hostile_calls", "prints"),
    "kills-itself": ("hostile_calls", "kills_itself"),
    "is-no-estimator": ("hostile_calls", "unmarked"),
}
MODULES = {
    "hostile_import": "raise RuntimeError('no licence found')\n",
    "hostile_exit": "import sys\nsys.exit('good bye')\n",
    "hostile_calls": """
import os, time
import xarray as xr
from beambench.estimators import estimator

def unmarked(capture):
    return capture

@estimator("gated", cites="a test")
def answers(capture):
    even = 0.0 * capture["counts"].mean("slice").astype("float64")
    return xr.Dataset({"range": even + 5.0, "sigma": even + 1.0, "valid": even == 0.0})

@estimator("gated", cites="a test")
def hangs(capture):
    time.sleep(1000)

@estimator("gated", cites="a test")
def prints(capture):
    while True:
        print("x" * 1000, flush=True)

@estimator("gated", cites="a test")
def kills_itself(capture):
    os._exit(0)
""",
}


def _lay(site: Path, entries: dict[str, tuple[str, str]], name: str = "hostile") -> None:
    """A package as pip leaves it: modules and a .dist-info with entry points."""
    site.mkdir(exist_ok=True)
    for module, text in MODULES.items():
        (site / f"{module}.py").write_text(text)
    info = site / f"{name}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    lines = [f"{entry} = {module}:{function}" for entry, (module, function) in entries.items()]
    (info / "entry_points.txt").write_text("[beambench.estimators]\n" + "\n".join(lines) + "\n")


def test_hostile_plugins_are_results_and_the_others_go_on(tmp_path: Path) -> None:
    if importlib.util.find_spec("mitsuba") is None:
        pytest.skip("Mitsuba is not installed")
    _lay(tmp_path / "site", HOSTILE | {"answers": ("hostile_calls", "answers")})
    out = tmp_path / "run"
    # The hanging one uses up its warm-up: short, since the one beside them has nothing to compile.
    suite = _suite(tmp_path, ["answers", *HOSTILE], warmup_s=6.0)
    done = _beambench(tmp_path / "site", "run", str(suite), "-o", str(out))
    assert done.returncode == 0, done.stdout + done.stderr
    status = _scores(out)["status"]
    assert status["answers"] == "ok"
    told = {
        "raises-at-import": "no licence", "leaves-at-import": "good bye", "hangs": "timeout", "prints": "flood",
        "kills-itself": "crash", "is-no-estimator": "not a marked function",
    }  # fmt: skip
    for name, word in told.items():
        assert status[name] != "ok" and word in status[name], (name, status[name])
    assert (_scores(out).loc[list(told), "failure_rate"] == 1).all()


def test_hostile_plugins_are_listed_with_the_reason(tmp_path: Path) -> None:
    _lay(tmp_path / "site", HOSTILE)
    listed = _beambench(tmp_path / "site", "estimators", "list", "--json")
    assert listed.returncode == 0, listed.stderr
    rows = {row["name"]: row for row in json.loads(listed.stdout)}
    assert "no licence" in rows["raises-at-import"]["error"] and "good bye" in rows["leaves-at-import"]["error"]
    assert "not a marked function" in rows["is-no-estimator"]["error"] and not rows["peak"]["error"]
    checked = _beambench(tmp_path / "site", "estimators", "check", "raises-at-import")
    assert checked.returncode == 2 and "no licence" in checked.stdout + checked.stderr


def test_a_taken_name_is_refused_and_both_owners_are_told(tmp_path: Path) -> None:
    _lay(tmp_path / "site", {"peak": ("hostile_calls", "prints")})
    done = _beambench(tmp_path / "site", "estimators", "list")
    said = done.stdout + done.stderr
    assert done.returncode == 2 and "Two estimators are named peak" in said
    assert "hostile_calls:prints" in said and "uninstall" in said


def test_a_list_outlives_plugins_that_hang_or_end_the_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    modules = {
        "listed_hangs": "import time\ntime.sleep(600)\n",
        "listed_ends": "import os\nos._exit(7)\n",
        "listed_prints": (
            "print('hello')\nfrom beambench.estimators import estimator\n"
            "@estimator('gated', cites='nobody')\ndef answer(capture, *, wide: float = 2.0): '''Says so.'''\n"
        ),
    }
    for name, text in modules.items():
        (tmp_path / f"{name}.py").write_text(text)
    info = tmp_path / "listed-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: listed\nVersion: 1.0\n")
    points = "".join(f"{name.replace('_', '-')} = {name}:answer\n" for name in modules)
    (info / "entry_points.txt").write_text(f"[beambench.estimators]\n{points}")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr("beambench.benchmarks.runner.confined.PLUGIN_IMPORT_S", 15.0)
    rows = {row["name"]: row for row in beambench.estimators_list()}
    assert "did not end within 15 s" in rows["listed-hangs"]["error"]
    assert "exit code 7" in rows["listed-ends"]["error"]
    assert rows["listed-prints"]["parameters"] == {"wide": 2.0} and not rows["listed-prints"]["error"]
    assert rows["listed-prints"]["origin"] == rows["listed-hangs"]["origin"] == "plug-in" and rows["peak"]["cites"]


@pytest.mark.parametrize("stage", ["line", "triangulation"])
def test_the_template_of_a_stage_keeps_the_laws_and_is_broken_on_its_own_scenes(stage: str, tmp_path: Path) -> None:
    """As typed: new, install, check; and a search for its failures, alone or behind a finder, begins with scenes of laser
    lines, not with those of the first modality."""
    name, site = f"my-{stage}", tmp_path / "site"
    _install(beambench.estimators_new(name, stage=stage, out=tmp_path / name), site)
    checked = _beambench(site, "estimators", "check", name, "--json")
    assert checked.returncode == 0, checked.stdout + checked.stderr
    assert json.loads(checked.stdout)["ok"]
    label = name if stage == "line" else f"line-ml+{name}"
    code = f"from beambench.benchmarks.search.break_plan import plan_break; print(*plan_break({label!r}).scenes)"
    planned = _python(site, "-c", code)
    assert planned.stdout.split() == ["spotscan-wall"], planned.stderr


def test_a_plugin_that_cannot_be_imported_is_not_broken(tmp_path: Path) -> None:
    package = beambench.estimators_new("my-broken", stage="line", out=tmp_path / "my-broken")
    (package / "beambench_my_broken.py").write_text("raise RuntimeError('on purpose')\n")
    _install(package, tmp_path / "site")
    done = _beambench(tmp_path / "site", "break", "my-broken", "-o", str(tmp_path / "out"))
    assert done.returncode == 2 and "cannot be imported" in done.stdout + done.stderr


@pytest.mark.parametrize("points", [b"\xff\xfe\x00[beambench.estimators]\n", b"[beambench.estimators]\nother\n= x:y\n"])
def test_a_package_without_a_readable_list_of_entry_points_is_named(tmp_path: Path, points: bytes) -> None:
    """Every command that listed estimators, or opened a store (xarray reads all lists), ended with an internal error."""
    info = tmp_path / "broken-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: broken\nVersion: 1.0\n")
    (info / "entry_points.txt").write_bytes(points)
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(tmp_path), *(path or os.getcwd() for path in sys.path)])
    }
    for words in (["estimators", "list"], ["generate", "flat-wall", "--out", str(tmp_path / "s.zarr")]):
        done = subprocess.run(
            [sys.executable, "-m", "beambench", *words], env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 2 and "no readable list of entry points" in done.stderr, done.stderr
        assert "broken-1.0.dist-info" in done.stderr and "Traceback" not in done.stderr
