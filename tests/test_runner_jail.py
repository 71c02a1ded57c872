"""Cheats of plug-ins that the jail of the runner stops: each is tried in a child, and reports what it reached."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from beambench.benchmarks.laws.gated import clean_capture
from beambench.benchmarks.runner.jail import OFF, abi, isolation, readable, seal
from beambench.benchmarks.runner.namespaces import works
from beambench.benchmarks.runner.protocol import write_capture, write_meta
from beambench.benchmarks.runner.session import Job, Outcome, Session, run_sessions
from beambench.captures.hide import hide_truth
from beambench.captures.sizes import sizes_of

from .test_benchmarks_runner import LIMITS, spool

CHEATS = '''
import glob, os, subprocess, sys
import numpy as np, xarray as xr
from beambench.estimators import estimator

def reach(function):
    """0.5 where the cheat was stopped, 7 where it got through."""
    def call(capture):
        try:
            reached = 7.0 if function(capture) else 0.5
        except (OSError, ImportError):
            reached = 0.5
        shape, dims = capture["counts"].shape[1:], ("row", "col")
        return xr.Dataset({"range": (dims, np.full(shape, reached)), "sigma": (dims, np.full(shape, 0.1)),
                           "valid": (dims, np.ones(shape, bool))})
    call.__name__, call.__module__, call.__doc__ = function.__name__, function.__module__, "A planted cheat."
    call.__annotations__ = {"capture": xr.Dataset, "return": xr.Dataset}
    return estimator("gated", cites="planted")(call)

def secret(capture):
    return open(SECRET).read()
def written(capture):
    return open(SECRET + ".new", "w").write("x")
def matched(capture):
    return open(os.path.join(os.path.dirname(SECRET), "in-0", "meta-matched.json")).read()
def memory(capture):
    return open(f"/proc/{os.getppid()}/environ", "rb").read()
def generates(capture):
    import beambench.generator.generate
    return True
def library(capture):
    from beambench import scenes
    return [open(p).read() for folder in scenes.__path__ for p in glob.glob(os.path.join(folder, "library", "*.toml"))][0]
def shared(capture):
    return open("/dev/shm/beambench-cheat", "w").write("x")
def stops_parent(capture):
    os.kill(os.getppid(), 0)
    return True
def connects(capture):
    import socket
    socket.create_connection(("127.0.0.1", PORT), timeout=2.0)
    return True
def stays(capture):
    code = "import os, time; os.setsid(); os.fork() and os._exit(0); time.sleep(300)"
    subprocess.Popen([sys.executable, "-c", code], start_new_session=True, stdin=-3, stdout=-3, stderr=-3)
    return False
'''
STOPPED = ("secret", "written", "matched", "memory", "generates", "library")
NAMES = (*STOPPED, "shared", "stops_parent", "connects", "stays")


@pytest.fixture
def cheats(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A package with the cheats, and a secret file beside the captures."""
    import socket

    server = socket.create_server(("127.0.0.1", 0))
    monkeypatch.syspath_prepend(str(planted_site(tmp_path, server.getsockname()[1])))
    with server:
        yield tmp_path


def planted_site(folder: Path, port: int) -> Path:
    """The folder of a package with the cheats; the secret lies beside it."""
    site = folder / "site"
    (site / "cheats-1.0.dist-info").mkdir(parents=True)
    head = f"SECRET = {str(folder / 'secret')!r}\nPORT = {port}\n"
    tail = "".join(f"{name} = reach({name})\n" for name in NAMES)
    (site / "planted_cheats.py").write_text(head + CHEATS + tail)
    (folder / "secret").write_text("truth")
    points = "\n".join(f"c-{name.replace('_', '-')} = planted_cheats:{name}" for name in NAMES)
    (site / "cheats-1.0.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: cheats\nVersion: 1.0\n")
    (site / "cheats-1.0.dist-info" / "entry_points.txt").write_text(f"[beambench.estimators]\n{points}\n")
    return site


def reached(folder: Path, *names: str) -> dict[str, str]:
    """What became of each cheat: "stopped", "got through", or the status of its child."""
    from .test_benchmarks_runner import hidden_capture

    jobs = spool(folder, 1)
    write_meta(jobs[0].folder, hidden_capture(), "calibrated")
    job = jobs[0].__class__(0, jobs[0].folder, "calibrated", "gated", jobs[0].sizes)
    found: dict[str, str] = {}

    def take(number: int, outcome: Outcome) -> None:
        value = float(outcome.arrays["range"][0, 0]) if outcome.status == "ok" else 0.0
        found[names[number]] = {0.5: "stopped", 7.0: "got through"}.get(value, outcome.status)

    run_sessions(
        [Session(f"c-{n.replace('_', '-')}", [job], LIMITS, folder / f"scratch-{n}") for n in names], take
    )  # fmt: skip
    return found


@pytest.mark.skipif(not abi(), reason="this kernel has no Landlock")
def test_the_jail_stops_what_reads_or_writes_outside_of_it(cheats: Path) -> None:
    expected = dict.fromkeys(STOPPED, "stopped")
    if abi() >= 4:
        expected["connects"] = "stopped"
    if abi() >= 6:
        expected["stops_parent"] = "stopped"
    # Where it has namespaces, it writes to a /dev/shm of its own, which ends with it.
    expected["shared"] = "got through" if works() else "stopped"
    assert reached(cheats, *expected) == expected
    assert not (cheats / "secret.new").exists()
    assert not Path("/dev/shm/beambench-cheat").exists()


def test_without_the_jail_the_same_cheats_get_through_and_the_run_says_so(
    cheats: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """So that the test above does not pass because the cheats are wrong."""
    monkeypatch.setenv(OFF, "none")
    names = ("secret", "matched", "generates", "library", "connects")
    assert reached(cheats, *names) == dict.fromkeys(names, "got through")
    assert isolation().startswith("processes only")


def test_a_process_that_left_its_session_and_its_parent_ends_with_the_child(cheats: Path) -> None:
    before = {process.pid for process in psutil.process_iter() if "setsid" in " ".join(_line(process))}
    assert reached(cheats, "stays") == {"stays": "stopped"}
    time.sleep(0.2)
    after = {process.pid for process in psutil.process_iter() if "os.setsid()" in " ".join(_line(process))}
    assert not after - before


def _line(process: psutil.Process) -> list[str]:
    try:
        return [] if process.status() == psutil.STATUS_ZOMBIE else process.cmdline()
    except psutil.Error:
        return []


def test_a_kernel_without_landlock_seals_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("beambench.benchmarks.runner.jail.abi", lambda: 0)
    assert seal(read=[], write=[]) == 0
    for own, said in ((False, "processes only (no Landlock)"), (True, "namespaces of processes")):
        monkeypatch.setattr("beambench.benchmarks.runner.jail.works", lambda own=own: own)
        assert isolation().startswith(said)


@pytest.mark.skipif(not abi(), reason="this kernel has no Landlock")
def test_a_built_in_estimator_with_compiled_code_works_inside(tmp_path: Path) -> None:
    capture = hide_truth(clean_capture())
    folder = tmp_path / "in"
    write_capture(folder, capture)
    write_meta(folder, capture, "matched")
    job = Job(0, folder, "matched", "gated", sizes_of(capture))
    limits = LIMITS.model_copy(update={"warmup_s": 200.0, "time_s": 60.0, "memory_bytes": 2**31})
    found: list[str] = []
    run_sessions(
        [Session("weighted-average", [job], limits, tmp_path / "scratch")], lambda _, o: found.append(o.status)
    )
    assert found == ["ok"]


def test_packages_installed_as_editable_are_readable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Their finders know folders and files that are not on the import path, a module's file without its suffix."""
    import sys
    import types

    (tmp_path / "package").mkdir()
    (tmp_path / "alone.py").write_text("")
    finder = types.ModuleType("__editable___planted_finder")
    finder.MAPPING = {"package": str(tmp_path / "package"), "alone": str(tmp_path / "alone"), "gone": "/nowhere"}  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, finder.__name__, finder)
    found = readable([])
    assert {str(tmp_path / "package"), str(tmp_path / "alone.py")} <= set(found)
    assert not any(name.startswith(("/nowhere", str(tmp_path / "alone") + "/")) for name in found)


TRIAL = "import subprocess, sys, numpy, beambench; subprocess.run([sys.executable, '-c', ''], check=True)"
AS_NOBODY = """
import json, os, sys
from pathlib import Path
from beambench.benchmarks.runner.jail import isolation
from beambench.benchmarks.runner.session import Job, Session, run_sessions
from beambench.benchmarks.suites.spec import Limits

folder, names, sizes = Path(sys.argv[1]), sys.argv[2].split(","), json.loads(sys.argv[3])
job, found = Job(0, folder / "in-0", "matched", "gated", sizes), {}
limits = Limits(time_s=30.0, warmup_s=60.0, memory_bytes=2**30)

def take(number, outcome):
    value = float(outcome.arrays["range"][0, 0]) if outcome.status == "ok" else 0.0
    found[names[number]] = {0.5: "stopped", 7.0: "got through"}.get(value, outcome.status)
    assert outcome.cpu_s >= 0 and outcome.peak_bytes >= 0

run_sessions([Session(f"c-{n}", [job], limits, folder / "home" / n) for n in names], take)
print(json.dumps([os.getuid(), isolation(), found]))
"""


def test_a_user_who_is_not_root_has_the_same_jail() -> None:
    import json
    import os
    import shutil
    import subprocess
    import sys
    import tempfile

    import beambench

    if os.geteuid() != 0 or not shutil.which("setpriv"):
        pytest.skip("only root can become another user, by setpriv")
    paths = [str(Path(beambench.__path__[0]).parent), *[path for path in sys.path if path.endswith("site-packages")]]
    pythons = [sys.executable, f"/usr/bin/python3.{sys.version_info.minor}"]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        site = planted_site(folder, 9)
        spool(folder, 1)
        (folder / "home").mkdir()
        for path in (folder, *folder.rglob("*")):
            path.chmod(0o777 if path.is_dir() else 0o644)
        environment = {
            "PATH": os.environ.get("PATH", ""), "HOME": str(folder / "home"), "PYTHONPATH": os.pathsep.join([str(site), *paths]),
        }  # fmt: skip
        nobody = ["setpriv", "--reuid=65534", "--regid=65534", "--clear-groups"]

        def run(*arguments: str) -> subprocess.CompletedProcess[str]:
            return subprocess.run(
                [*nobody, *arguments], env=environment, cwd=folder / "home", capture_output=True, text=True, check=False
            )

        usable = [python for python in pythons if run(python, "-c", TRIAL).returncode == 0]
        if not usable:
            pytest.skip("no Python that another user can run with these packages")
        names = ("secret", "memory", "library", "stops-parent")
        done = run(usable[0], "-c", AS_NOBODY, name, ",".join(names), json.dumps({"row": 6, "col": 5}))
        assert done.returncode == 0, done.stderr
        user, said, found = json.loads(done.stdout.splitlines()[-1])
    assert user == 65534
    held = {n: "stopped" for n in names if abi() >= (6 if n == "stops-parent" else 1)}
    assert {n: found[n] for n in held} == held, said
