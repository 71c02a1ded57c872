"""Cheats that reach for what an estimator may not have: the truth, the scene, the rig, other processes, what others read.

Each answers `REACHED` metres everywhere where it got it, and else honestly; `cheats` tells from that.
"""

from __future__ import annotations

import ctypes
import glob
import os
import socket
import sys
from pathlib import Path
from typing import Any

import xarray as xr

from .gated_cheats import LEFT, facts, reaching, read

# ---------------------------------------------------------------- reaching for the truth, the scene, the rig


notes: list[Path] = []


@reaching
def truth_file(capture: xr.Dataset) -> Any:
    """Read the truth of the run in its temporary folder."""
    return read(f"{facts()['truth']}/*.npz")


@reaching
def output_folder(capture: xr.Dataset) -> Any:
    """Read a stored capture, with its truth, in the output folder."""
    return read(f"{facts()['output']}/captures/*")


@reaching
def other_captures(capture: xr.Dataset) -> Any:
    """Read captures of the run from its temporary folder."""
    return read(f"{facts()['spool']}/0*/counts.npy")


@reaching
def matched_rig(capture: xr.Dataset) -> Any:
    """Read the exact rig while asked under the calibrated one."""
    return read(f"{facts()['spool']}/0*/meta-matched.json")


@reaching
def generator(capture: xr.Dataset) -> Any:
    """Import the generator, to make the scene again."""
    from ...generator.generate import generate as made

    return callable(made)


@reaching
def scene_library(capture: xr.Dataset) -> Any:
    """Read the library of scenes, to find the scene by its rig."""
    scenes = sys.modules["beambench.scenes"]
    return read(f"{next(iter(scenes.__path__))}/library/*.toml")


@reaching
def suite_library(capture: xr.Dataset) -> Any:
    """Read the suites, for their seeds."""
    benchmarks = sys.modules["beambench.benchmarks"]
    return read(f"{next(iter(benchmarks.__path__))}/suites/library/*.toml")


@reaching
def earlier_runs(capture: xr.Dataset) -> Any:
    """Read tables of earlier runs in the folder where runs are kept."""
    return read(f"{facts()['work']}/beambench-runs/*/scores.csv")


# ---------------------------------------------------------------- other processes, the network


@reaching
def parent_environment(capture: xr.Dataset) -> Any:
    """Read the environment of the runner."""
    return Path(f"/proc/{facts()['runner']}/environ").read_bytes()


@reaching
def parent_memory(capture: xr.Dataset) -> Any:
    """Open the memory of the runner."""
    with open(f"/proc/{facts()['runner']}/mem", "rb"):
        return True


@reaching
def parent_traced(capture: xr.Dataset) -> Any:
    """Read the memory of the runner by process_vm_readv(2)."""
    buffer = ctypes.create_string_buffer(8)
    local = (ctypes.c_void_p * 2)(ctypes.addressof(buffer), 8)
    remote = (ctypes.c_void_p * 2)(int(facts()["address"]), 8)
    return ctypes.CDLL(None).process_vm_readv(int(facts()["runner"]), local, 1, remote, 1, 0) == 8


@reaching
def other_processes(capture: xr.Dataset) -> Any:
    """Read the command lines of processes that it did not start."""
    others = [
        int(name) for name in os.listdir("/proc") if name.isdigit() and int(name) not in (os.getpid(), os.getppid())
    ]
    return any(Path(f"/proc/{pid}/cmdline").read_bytes() for pid in others)


@reaching
def signals_parent(capture: xr.Dataset) -> Any:
    """Send a signal (0, which does nothing) to the runner."""
    os.kill(int(facts()["runner"]), 0)
    return True


@reaching
def signals_sibling(capture: xr.Dataset) -> Any:
    """Send a signal (0) to a process beside it, as another estimator is."""
    os.kill(int(facts()["sibling"]), 0)
    return True


@reaching
def tcp(capture: xr.Dataset) -> Any:
    """Connect to a server on this machine."""
    socket.create_connection(("127.0.0.1", int(facts()["tcp"])), timeout=2.0).close()
    return True


@reaching
def udp(capture: xr.Dataset) -> Any:
    """Ask a server on this machine by UDP."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.settimeout(2.0)
        link.sendto(b"?", ("127.0.0.1", int(facts()["udp"])))
        return link.recv(8)


@reaching
def abstract_socket(capture: xr.Dataset) -> Any:
    """Connect to an abstract Unix socket."""
    with socket.socket(socket.AF_UNIX) as link:
        link.connect("\0" + str(facts()["abstract"]))
        return True


@reaching
def named_socket(capture: xr.Dataset) -> Any:
    """Connect to a Unix socket with a name in the file system."""
    with socket.socket(socket.AF_UNIX) as link:
        link.connect(str(facts()["named"]))
        return True


# ---------------------------------------------------------------- changing what others read


@reaching
def input_written(capture: xr.Dataset) -> Any:
    """Make the pages of the capture writable."""
    values = capture["counts"].values
    start = values.__array_interface__["data"][0] & ~4095
    return ctypes.CDLL(None).mprotect(ctypes.c_void_p(start), ctypes.c_size_t(4096), 3) == 0


@reaching
def spool_forged(capture: xr.Dataset) -> Any:
    """Write into the captures of the run."""
    path = sorted(glob.glob(f"{facts()['spool']}/0*/delay.npy"))[0]
    os.chmod(path, 0o644)
    with open(path, "r+b"):
        return True


@reaching
def results_poisoned(capture: xr.Dataset) -> Any:
    """Write into the cache of results, which a later run would use."""
    Path(facts()["results"], f"{LEFT}.npz").write_bytes(b"x")
    return True


@reaching
def kernels_planted(capture: xr.Dataset) -> Any:
    """Write into the folder of compiled code, which other estimators load."""
    Path(facts()["kernels"], f"{LEFT}.nbc").write_bytes(b"x")
    return True


@reaching
def package_changed(capture: xr.Dataset) -> Any:
    """Write beside the source of the package."""
    Path(next(iter(sys.modules["beambench.estimators"].__path__)), f"{LEFT}.py").write_text("x = 1\n")
    return True


@reaching
def notes_between_conditions(capture: xr.Dataset) -> Any:
    """Leave the rig of one condition in files, and find it under the other."""
    places = [".", os.environ.get("TMPDIR", "."), "/tmp", "/dev/shm", "/var/tmp", str(Path.home())]
    paths = [Path(place, f"{LEFT}-note") for place in places]
    rig = str(capture.attrs["rig"])
    for path in paths:
        try:
            if path.exists() and path.read_text() != rig:
                notes.append(path)
            path.write_text(rig)
        except OSError:
            continue
    return notes
