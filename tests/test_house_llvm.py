"""drjit uses the libLLVM of the wheel, unless the user sets another one."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Any

import pytest

CODE = """
import json
from beambench.generator.rays.backend import load
told = load()
mapped = sorted({line.split(maxsplit=5)[-1].strip() for line in open("/proc/self/maps") if "libLLVM" in line})
import drjit as dr
import mitsuba as mi
print(json.dumps({"told": told, "mapped": mapped, "sum": float(dr.sum(mi.Float(1, 2, 3))[0]), "variant": mi.variant()}))
"""


@pytest.fixture(scope="module")
def wheel() -> dict[str, Path]:
    """Name -> path of the wheel's libraries, from its own record."""
    try:
        files = distribution("karellen-llvm-core").files
    except PackageNotFoundError:
        pytest.skip("the LLVM wheel exists for Linux on x86-64 only, and is not installed here")
    return {f.name: Path(str(f.locate())) for f in files or [] if ".so" in f.name}


def loaded(environment: dict[str, str], folder: Path) -> dict[str, Any]:
    """What a fresh process loads, with DRJIT_LIBLLVM_PATH only as given."""
    clean = {k: v for k, v in os.environ.items() if k != "DRJIT_LIBLLVM_PATH"} | environment
    run = subprocess.run(
        [sys.executable, "-c", CODE], env=clean, cwd=folder, capture_output=True, text=True, timeout=120, check=False
    )
    assert run.returncode == 0, run.stderr
    told: dict[str, Any] = json.loads(run.stdout.splitlines()[-1])
    if told["told"]["cuda"]:
        pytest.skip("a CUDA device is used here, and LLVM is not")
    return told


def test_the_wheel_is_used(wheel: dict[str, Path], tmp_path: Path) -> None:
    told = loaded({}, tmp_path)
    ours = {path.resolve() for path in wheel.values()}
    assert told["sum"] == 6.0
    assert told["variant"].startswith("llvm")
    assert [Path(p).resolve() for p in told["mapped"]] == [Path(told["told"]["llvm_path"]).resolve()], (
        "one libLLVM is mapped"
    )
    assert Path(told["told"]["llvm_path"]).resolve() in ours
    # 14 and 15 abort the process; the wheel's own version is what drjit says it runs on.
    major = int(distribution("karellen-llvm-core").version.split(".")[0])
    assert told["told"]["llvm_version"][0] == major >= 19
    assert told["told"]["llvm_source"] == "wheel"


def test_the_users_library_is_respected(wheel: dict[str, Path], tmp_path: Path) -> None:
    theirs = tmp_path / "lib" / "libLLVM-mine.so"
    theirs.parent.mkdir()
    library = wheel["libLLVM.so"].resolve()
    shutil.copy2(library, theirs)
    # The library seeks its C++ runtime beside itself.
    runtime = wheel["libc++.so.1.0"].parent
    (theirs.parent / runtime.name).symlink_to(runtime)
    told = loaded({"DRJIT_LIBLLVM_PATH": str(theirs)}, tmp_path)
    assert told["sum"] == 6.0
    assert told["mapped"] == [str(theirs)]
    assert told["told"]["llvm_path"] == str(theirs)
    assert told["told"]["llvm_source"] == "user"


def test_a_library_that_is_none_is_told(wheel: dict[str, Path], tmp_path: Path) -> None:
    """A wrong DRJIT_LIBLLVM_PATH ends in a message that names it, not in a crash or in silence."""
    code = "from beambench.generator.rays.backend import load\nload()"
    environment = os.environ | {"DRJIT_LIBLLVM_PATH": str(tmp_path / "none.so")}
    run = subprocess.run(
        [sys.executable, "-c", code],
        env=environment,
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert run.returncode == 1, f"ended with {run.returncode}: {run.stderr[-500:]}"
    assert "InputError" in run.stderr
    assert "none.so" in run.stderr


def test_a_libllvm_that_is_too_old_is_refused_and_does_not_abort_later() -> None:
    """Mitsuba imported first finds the system's library; 14 and 15 would end the process at some kernel."""
    code = (
        "import mitsuba, sys\n"
        "from beambench.generator.rays.backend import load\n"
        "from beambench.scenes.errors import InputError\n"
        "try:\n    found = load()['llvm_version']\n"
        "except InputError as error:\n    print('refused', 'before importing' in str(error) or 'no libLLVM' in str(error))\n"
        "else:\n    print('accepted', found[0] >= 16)\n"
    )
    environment = {name: value for name, value in os.environ.items() if name != "DRJIT_LIBLLVM_PATH"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split()[1] == "True"


@pytest.mark.parametrize("home", ["", "/nowhere"])
def test_kernels_are_kept_where_there_is_no_home(tmp_path: Path, home: str) -> None:
    """drjit would compile its kernels in each process, and say so; they are kept beside those of Numba."""
    code = "import os; from beambench.generator.rays.backend import load; load(); print(os.environ['DRJIT_CACHE_DIR'])"
    environment = {name: value for name, value in os.environ.items() if name not in ("HOME", "DRJIT_CACHE_DIR")}
    environment |= {"XDG_CACHE_HOME": str(tmp_path)} | ({"HOME": home} if home else {})
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True, timeout=300
    )
    assert Path(done.stdout.strip()).is_relative_to(tmp_path) and Path(done.stdout.strip()).is_dir()
    assert "jit_init" not in done.stderr, done.stderr


def test_a_home_keeps_its_own_kernels(tmp_path: Path) -> None:
    code = (
        "import os; from beambench.generator.rays.backend import load; load(); print(os.environ.get('DRJIT_CACHE_DIR'))"
    )
    environment = {name: value for name, value in os.environ.items() if name != "DRJIT_CACHE_DIR"} | {
        "HOME": str(tmp_path)
    }
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True, timeout=300
    )
    assert done.stdout.strip() == "None"
