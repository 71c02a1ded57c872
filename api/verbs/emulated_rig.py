"""An emulated rig in a process of its own, for the length of a recording."""

from __future__ import annotations

import contextlib
import json
import select
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..captures.recording.plan import Planned, RigFile

__all__ = ["with_emulator"]

#: The first start compiles kernels.
_START_S = 300.0


@contextlib.contextmanager
def with_emulator(planned: Planned, rig: RigFile) -> Iterator[RigFile]:
    """The rig file with the addresses of the emulated instruments, which live as long as the `with` block; without a table
    `emulator`, the rig file as it is.

    Raises:
        InputError: The process does not start, e.g. because the plan's modality is not emulated.
    """
    if rig.emulator is None:
        yield rig
        return
    told = rig.emulator
    changes = [f"--set={path}={json.dumps(value)}" for path, value in planned.plan.changes.items()]
    # -P: the working folder may hold files with the names of modules.
    command = [
        sys.executable, "-P", "-m", "beambench.generator.emulators", planned.plan.instrument, *changes,
        f"--seed={told.seed}", f"--hidden={told.hidden}", f"--loss={told.loss}", f"--stall={told.stall}",
    ]  # fmt: skip
    with tempfile.TemporaryFile("w+") as said:
        # A session of its own: Ctrl-C in the terminal ends the recorder, which then lets the rig go.
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=said, text=True, start_new_session=True
        )
        try:
            yield _connected(rig, process, said)
        finally:
            with contextlib.suppress(OSError):
                assert process.stdin is not None
                process.stdin.close()
            try:
                process.wait(5.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            assert process.stdout is not None
            process.stdout.close()


def _connected(rig: RigFile, process: subprocess.Popen[str], said: object) -> RigFile:
    from ..captures.recording.plan import load_rig
    from ..scenes.errors import InputError

    assert process.stdout is not None
    ready, _, _ = select.select([process.stdout], [], [], _START_S)
    line = process.stdout.readline() if ready else ""
    if not line:
        process.kill()
        process.wait()
        said.seek(0)  # type: ignore[attr-defined]
        last = said.read().strip().removeprefix("error: ")  # type: ignore[attr-defined]
        raise InputError("The emulated rig does not start.", where=f"rig {rig.rig}", value=last[-400:] or "no answer")
    places = json.loads(line)
    data = rig.model_dump(mode="json")
    for role, options in data["devices"].items():
        if options.get("address") == "emulator":
            options["address"] = places[role]
    return load_rig(data)
