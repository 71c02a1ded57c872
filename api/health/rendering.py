"""The renderer and its devices, tried apart from this process."""

from __future__ import annotations

import ctypes
import json
import subprocess
import sys

from .finding import Finding
from .packages import version_of

__all__ = ["cuda", "renderer"]

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


def renderer() -> Finding:
    """The renderer, tried in a child process, because a wrong libLLVM aborts the process that loads it."""
    if any(version_of(name) is None for name in ("mitsuba", "drjit")):
        return Finding(
            "rendering",
            "backend",
            "warning",
            "Mitsuba is not installed: `generate` and `run` do not work, `score` and `report` do.",
            "pip install 'mitsuba<3.10' drjit",
        )
    try:
        done = subprocess.run([sys.executable, "-c", _PROBE], capture_output=True, text=True, timeout=180, check=False)
    except subprocess.TimeoutExpired:
        return Finding(
            "rendering", "backend", "broken", "The trial took longer than 180 s.", "run `beambench doctor` again"
        )
    if done.returncode != 0:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        return Finding(
            "rendering",
            "backend",
            "broken",
            f"The trial process ended with exit code {done.returncode}: {last}",
            "unset DRJIT_LIBLLVM_PATH, or set it to the path of libLLVM 16 or newer; pip install karellen-llvm-core",
        )
    backend = json.loads(done.stdout.strip().splitlines()[-1])
    if "error" in backend:
        return Finding("rendering", "backend", "broken", backend["error"], backend["advice"])
    version = ".".join(map(str, backend["llvm_version"])) if backend.get("llvm_version") else "none"
    text = (
        f"{backend['variant']}; libLLVM {version} from {backend['llvm_source']}: {backend['llvm_path']}; "
        f"mitsuba {backend['mitsuba']}, drjit {backend['drjit']}"
    )
    return Finding("rendering", "backend", "ok", text)


def cuda() -> Finding:
    """A CUDA device, by its driver library."""
    try:
        driver = ctypes.CDLL("libcuda.so.1")
    except OSError:
        return Finding("rendering", "cuda", "missing", "There is no driver library; the CPU is used.")
    if driver.cuInit(0) != 0:
        return Finding("rendering", "cuda", "missing", "The driver library finds no device; the CPU is used.")
    return Finding("rendering", "cuda", "ok", "A device answers.")
