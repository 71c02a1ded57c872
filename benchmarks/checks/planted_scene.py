"""The captures on which planted cheats run, and what is around a run: servers, a process beside it, results of earlier runs."""

from __future__ import annotations

import contextlib
import ctypes
import math
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import xarray as xr

from ... import estimators
from ...optics.constants import C_M_PER_S
from ...optics.jit import cache_folder
from ...scenes.load import load_scene
from ...scenes.medium_index import group_index
from ...scenes.rigs.gated import gated_rig
from ...scenes.scene import Scene
from ..judges.bound import bounds_of, truths_of
from ..runner.result_cache import cache_root
from ..runner.spool import Spool
from ..scores.truth import Bound
from ..written.gated import written_capture
from .gated_cheats import LEFT

__all__ = ["Around", "captures"]

#: Half of the interval in which the wall is drawn, m.
_HALF_M = 0.3
#: Relief of the wall, rms: below the noise of a pixel, so that a mean over pixels still has the smaller error.
_RELIEF_M = 7e-4


def captures(seeds: Sequence[int]) -> tuple[Scene, list[xr.Dataset]]:
    """The scene, and per seed a capture (64, 12, 24) with its truth: a rough wall, drawn within .3 m of the window's middle."""
    scene = load_scene("flat-wall", {"rig.camera.rows": 12, "rig.camera.cols": 24, "rig.camera.focal_length_m": 1.0})
    rig = gated_rig(scene)
    half = C_M_PER_S / (2 * group_index(scene.medium, rig.laser.wavelength_m))
    middle = (rig.delays.start_s + rig.delays.step_s * 0.5 * (rig.delays.count - 1)) * half
    made = []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        place = middle + rng.uniform(-_HALF_M, _HALF_M) + _RELIEF_M * rng.standard_normal((12, 24))
        made.append(written_capture(scene, 4000.0, 4.0, place, seed=seed))
    return scene, made


class Around:
    """Within the block: what cheats reach for, and `facts`, what they know of it."""

    def __init__(self, spool: Spool, made: Sequence[xr.Dataset]) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="beambench-around-"))
        self._links = [socket.create_server(("127.0.0.1", 0)), socket.socket(socket.AF_INET, socket.SOCK_DGRAM)]
        self._links += [socket.socket(socket.AF_UNIX), socket.socket(socket.AF_UNIX)]
        tcp, udp, abstract, named = self._links
        udp.bind(("127.0.0.1", 0))
        abstract.bind(f"\0{LEFT}-{os.getpid()}")
        named.bind(str(self.folder / "socket"))
        for link in (abstract, named):
            link.listen(8)
        threading.Thread(target=self._reply, args=(udp,), daemon=True).start()
        self._sibling = subprocess.Popen([sys.executable, "-S", "-c", "import time; time.sleep(3600)"])
        self._secret = ctypes.create_string_buffer(b"secret..")
        for name in ("output/captures/c.zarr", "work/beambench-runs/earlier/scores.csv"):
            (self.folder / name).parent.mkdir(parents=True)
            (self.folder / name).write_text("truth")
        cache_root().mkdir(parents=True, exist_ok=True)
        self.facts: dict[str, Any] = {
            "truth": str(spool.closed), "spool": str(spool.open), "output": str(self.folder / "output"),
            "work": str(self.folder / "work"), "runner": os.getpid(), "sibling": self._sibling.pid,
            "address": ctypes.addressof(self._secret), "tcp": tcp.getsockname()[1], "udp": udp.getsockname()[1],
            "abstract": f"{LEFT}-{os.getpid()}", "named": str(self.folder / "socket"), "results": str(cache_root()),
            "kernels": str(cache_folder()), "key": 0x62656D00 + os.getpid() % 251,
            "sums": [float(one["counts"].values.astype(np.float64).sum()) for one in made],
            "truths": [truths_of(one)["range"].value.tolist() for one in made],
            "bounds": [bounds_of(one)["range"].sigma.tolist() for one in made],
        }  # fmt: skip

    @staticmethod
    def drawn(bounds: Mapping[str, Bound]) -> dict[str, Bound]:
        """The bounds, with the spread of the draw."""
        return {name: replace(bound, drawn=2.0 * _HALF_M / math.sqrt(12.0)) for name, bound in bounds.items()}

    @staticmethod
    def _reply(link: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while True:
                link.sendto(b"!", link.recvfrom(8)[1])

    def left(self) -> list[str]:
        """What cheats left behind; it is removed."""
        import psutil

        found = []
        for process in psutil.process_iter():
            with contextlib.suppress(psutil.Error):
                if any(LEFT.replace("-", "_") in part for part in process.cmdline()):
                    found.append(f"process {process.pid}")
                    process.kill()
        paths = [Path(place, LEFT) for place in ("/dev/shm", "/tmp", "/var/tmp")]
        found += [str(path) for path in paths if path.exists()]
        notes = [Path(place, f"{LEFT}-note") for place in ("/tmp", "/dev/shm", "/var/tmp", str(Path.home()))]
        planted = [
            cache_root() / f"{LEFT}.npz",
            cache_folder() / f"{LEFT}.nbc",
            Path(estimators.__path__[0], f"{LEFT}.py"),
        ]
        for path in (*paths, *notes, *planted):
            shutil.rmtree(path, ignore_errors=True)
            with contextlib.suppress(OSError):
                path.unlink()
        libc = ctypes.CDLL(None)
        if (number := libc.semget(self.facts["key"], 1, 0)) >= 0:
            found.append("semaphore")
            libc.semctl(number, 0, 0)
        if (number := libc.shmget(self.facts["key"], 0, 0)) >= 0:
            found.append("shared segment")
            libc.shmctl(number, 0, None)
        return found

    def __enter__(self) -> Around:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.left()
        for link in self._links:
            link.close()
        self._sibling.kill()
        self._sibling.wait()
        shutil.rmtree(self.folder, ignore_errors=True)
