"""`beambench doctor`: what works on this machine, what is missing and how to get it."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from packaging.requirements import Requirement

__all__ = ["Finding", "doctor"]

#: Without these the rest still works: score, report and gate do not render.
_RENDERING = ("mitsuba", "drjit", "mitransient", "karellen-llvm-core")
#: Below this a quickstart run may not fit.
_DISK_BYTES = 2 * 2**30


@dataclass(frozen=True)
class Finding:
    """One thing looked at. `state`: "ok", "missing" (optional), "warning" or "broken" (required)."""

    group: str
    name: str
    state: str
    found: str
    advice: str = ""


def doctor() -> list[Finding]:
    """Look at Python, packages, rendering backends, caches, extras and disk; nothing is changed or downloaded.

    The renderer is tried in a child process, since a wrong libLLVM aborts the process that loads it.
    """
    return [*_python(), *_packages(), _rendering(), _cuda(), *_caches(), *_extras(), *_disks()]


def _version(name: str) -> str | None:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _python() -> list[Finding]:
    text = f"{platform.python_implementation()} {platform.python_version()} on {platform.system()} {platform.machine()}"
    good = sys.version_info >= (3, 11)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return [
        Finding("python", "python", "ok" if good else "broken", text, "" if good else "Python 3.11 or newer is needed"),
        Finding("python", "beambench", "ok", _version("beambench") or "not installed as a package"),
        Finding("python", "cores", "ok", str(cores)),
    ]


def _needs() -> dict[str, list[Requirement]] | None:
    """What the package says that it needs here: by extra, "" for what is always needed; None where it is not installed.

    Requirements for other platforms are left out.
    """
    from importlib.metadata import PackageNotFoundError, metadata, requires

    from packaging.requirements import Requirement

    try:
        told, extras = requires("beambench") or [], metadata("beambench").get_all("Provides-Extra") or []
    except PackageNotFoundError:
        return None
    needs: dict[str, list[Requirement]] = {"": []} | {extra: [] for extra in extras}
    for requirement in map(Requirement, told):
        marker = requirement.marker
        if marker is None or marker.evaluate({"extra": ""}):
            needs[""].append(requirement)
            continue
        for extra in extras:
            if marker.evaluate({"extra": extra}):
                needs[extra].append(requirement)
    return needs


def _trouble(requirement: Requirement) -> str:
    """Why a package does not meet its requirement, "" where it does."""
    version = _version(requirement.name)
    if version is None:
        return "not installed"
    if not requirement.specifier.contains(version, prereleases=True):
        return f"{version}, where {requirement.specifier} is needed"
    return ""


def _packages() -> list[Finding]:
    needs = _needs()
    if needs is None:
        text = "beambench is not installed as a package: what it needs is not known"
        return [Finding("packages", "requirements", "warning", text, "pip install beambench")]
    found = []
    for requirement in sorted(needs[""], key=lambda one: one.name.lower()):
        name, trouble = requirement.name, _trouble(requirement)
        bad = "warning" if name in _RENDERING else "broken"
        advice = f"pip install '{name}{requirement.specifier}'" if trouble else ""
        found.append(Finding("packages", name, bad if trouble else "ok", trouble or _version(name) or "", advice))
    return found


_PROBE = """
import json
from beambench.generator.rays.backend import load
from beambench.scenes.errors import InputError
try:
    told = load()
    import drjit, mitsuba
    assert float(drjit.sum(mitsuba.Float([1.0, 2.0]))[0]) == 3.0
except InputError as error:
    told = {"error": error.what, "advice": error.next_step}
print("\\n" + json.dumps(told))
"""


def _rendering() -> Finding:
    import json

    if any(_version(name) is None for name in ("mitsuba", "drjit")):
        return Finding(
            "rendering",
            "backend",
            "warning",
            "Mitsuba is not installed: generate and run do not work, score and report do",
            "pip install 'mitsuba<3.10' drjit",
        )
    try:
        done = subprocess.run([sys.executable, "-c", _PROBE], capture_output=True, text=True, timeout=180, check=False)
    except subprocess.TimeoutExpired:
        return Finding("rendering", "backend", "broken", "the trial took over 180 s", "beambench doctor, once more")
    if done.returncode != 0:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        return Finding(
            "rendering",
            "backend",
            "broken",
            f"the trial process ended with {done.returncode}: {last}",
            "unset DRJIT_LIBLLVM_PATH, or point it to libLLVM 16 or newer; pip install karellen-llvm-core",
        )
    told = json.loads(done.stdout.strip().splitlines()[-1])
    if "error" in told:
        return Finding("rendering", "backend", "broken", told["error"], told["advice"])
    version = ".".join(map(str, told["llvm_version"])) if told.get("llvm_version") else "none"
    text = (
        f"{told['variant']}; libLLVM {version} from {told['llvm_source']}: {told['llvm_path']}; "
        f"mitsuba {told['mitsuba']}, drjit {told['drjit']}"
    )
    return Finding("rendering", "backend", "ok", text)


def _cuda() -> Finding:
    """Looked for by its driver library only: without one there is nothing to try."""
    import ctypes

    try:
        driver = ctypes.CDLL("libcuda.so.1")
    except OSError:
        return Finding("rendering", "cuda", "missing", "no driver library; the CPU is used")
    if driver.cuInit(0) != 0:
        return Finding("rendering", "cuda", "missing", "a driver library that finds no device; the CPU is used")
    return Finding("rendering", "cuda", "ok", "a device answers")


def _caches() -> list[Finding]:
    from ..optics.jit import cache_folder

    folder = cache_folder()
    # Where the user's cache cannot be written the door to Numba takes a temporary folder: it works, but compiles anew.
    lasting = not folder.name.startswith("beambench-numba-")
    advice = (
        ""
        if lasting
        else "set XDG_CACHE_HOME to a folder that you may write to, or kernels are compiled in every process"
    )
    free = f"{shutil.disk_usage(folder).free / 2**30:.1f} GiB free"
    return [Finding("caches", "numba", "ok" if lasting else "warning", f"{folder}: {free}", advice)]


def _extras() -> list[Finding]:
    found = []
    for extra, requirements in (_needs() or {}).items():
        if not extra:
            continue
        troubles = [f"{one.name} {trouble}" for one in requirements if (trouble := _trouble(one))]
        if troubles:
            advice = f"pip install 'beambench[{extra}]'"
            found.append(Finding("extras", extra, "missing", "; ".join(troubles), advice))
        else:
            text = ", ".join(f"{one.name} {_version(one.name)}" for one in requirements)
            found.append(Finding("extras", extra, "ok", text))
    return found


def _disks() -> list[Finding]:
    import tempfile

    found = []
    for name, folder in (("working folder", Path.cwd()), ("temporary folder", Path(tempfile.gettempdir()))):
        free = shutil.disk_usage(folder).free
        writable = os.access(folder, os.W_OK)
        state = "ok" if writable and free > _DISK_BYTES else "warning"
        advice = "" if writable else "give --out in a folder that you may write to"
        if writable and free <= _DISK_BYTES:
            advice = "free some space: a run of the quickstart takes up to 2 GiB"
        found.append(Finding("disk", name, state, f"{folder}: {free / 2**30:.1f} GiB free", advice))
    return found
