"""The process that a command runs in: closed streams, a deleted folder, a fork after use, and names of outputs."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import beambench
from beambench.cli import main
from beambench.scenes.errors import InputError
from beambench.scenes.places import local_path

SMALL = ["--set", "rig.camera.rows=4", "--set", "rig.camera.cols=4"]


def test_a_closed_stream_is_the_null_device(tmp_path: Path) -> None:
    """The next file opened would take the number 0, and the chart converter ended at it, after all had been measured."""
    code = (
        "import os, sys\nfrom beambench.process import open_standard_streams\n"
        "open_standard_streams()\n"
        "ends = [os.path.realpath(f'/proc/self/fd/{n}') for n in (0, 1, 2)]\n"
        "held = os.open(sys.argv[1], os.O_WRONLY | os.O_CREAT)\n"
        "os.write(held, repr((held > 2, ends, sys.stdin.read(), sys.stdin is None)).encode())\n"
    )
    told = tmp_path / "told"
    shell = f'exec "{sys.executable}" -c "$0" "$1" <&- >&- 2>&-'
    subprocess.run(["bash", "-c", shell, code, str(told)], check=True, timeout=120)
    assert told.read_text() == repr((True, [os.devnull] * 3, "", False))


def test_a_deleted_working_folder_is_named(tmp_path: Path) -> None:
    """Mitsuba was to be installed, and the interpreter aborted with 134."""
    shell = 'cd "$1" && rmdir "$1" && exec "$0" -m beambench scenes list'
    gone = tmp_path / "gone"
    gone.mkdir()
    done = subprocess.run(
        ["bash", "-c", shell, sys.executable, str(gone)], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 2 and "working folder no longer exists" in done.stderr


POOL = """
import multiprocessing, sys
import beambench
from beambench.scenes.errors import InputError
from beambench.estimators.registry import get_estimator
from beambench.scenes.load import load_scene

SMALL = {"rig.camera.rows": 8, "rig.camera.cols": 8}

def make(seed):
    try:
        beambench.generate("flat-wall", seeds=[seed], out=f"p{seed}.zarr", overrides=SMALL)
    except InputError as error:
        return error.next_step
    return "made"

def call(_):
    try:
        get_estimator("peak")(None)
    except InputError as error:
        return error.next_step
    return "called"

if __name__ == "__main__":
    if sys.argv[1] == "after":
        make(0)
    with multiprocessing.get_context(sys.argv[2]).Pool(2) as pool:
        print(pool.map_async(make, [1, 2]).get(timeout=240))
        print(pool.map_async(call, [1]).get(timeout=240) if sys.argv[1] == "after" else "")
"""


@pytest.mark.parametrize(("when", "how", "refused"), [("after", "fork", True), ("before", "fork", False)])
def test_a_pool_forked_after_use_says_so_at_once(tmp_path: Path, when: str, how: str, refused: bool) -> None:
    """Its workers hung or died and were started again: `map` never returned."""
    (tmp_path / "pool.py").write_text(POOL)
    done = subprocess.run(
        [sys.executable, "pool.py", when, how], cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("spawn") == (3 if refused else 0)
    assert done.stdout.count("made") == (0 if refused else 2)


def test_an_error_survives_a_pool() -> None:
    import pickle

    error = InputError("No.", where="here", value=3, allowed="2", next_step="do")
    again = pickle.loads(pickle.dumps(error))
    assert (str(again), again.where, again.value, again.next_step) == (str(error), "here", 3, "do")


@pytest.mark.parametrize("name", ["a::b.zarr", "memory:x.zarr", "a#b?c.zarr", "file:y.zarr", "é %41.zarr"])
def test_a_path_is_a_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """A name with "::" was taken for a chained URL: no module named fsspec."""
    monkeypatch.chdir(tmp_path)
    assert main(["generate", "flat-wall", *SMALL, "-o", name]) == 0
    from beambench.captures import open_captures

    assert open_captures(tmp_path / name)[0].load()["counts"].size > 0
    assert sorted(path.name for path in tmp_path.iterdir()) == [name]


@pytest.mark.parametrize("verb", ["generate", "run", "export", "score"])
def test_a_url_is_no_output(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], verb: str
) -> None:
    """It became a local folder "s3:", with exit code 0."""
    monkeypatch.chdir(tmp_path)
    typed = {"generate": ["flat-wall", *SMALL], "run": ["quickstart"], "export": ["x.zarr"], "score": ["x.zarr", "e"]}[
        verb
    ]
    assert main([verb, *typed, "-o", "s3://bucket/x.zarr"]) == 2
    assert "URL" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_urls_given_as_paths_are_known_too() -> None:
    with pytest.raises(InputError, match="URL"):
        local_path(Path("s3://bucket/x.zarr"))
    with pytest.raises(InputError, match="null"):
        local_path("a\0b")
    assert local_path("c:x") == Path("c:x") and local_path(Path("a::b")) == Path("a::b")


def test_a_url_as_python_argument_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match="URL"):
        beambench.generate(
            "flat-wall", out="https://a.b/c.zarr", overrides={"rig.camera.rows": 4, "rig.camera.cols": 4}
        )


ENDED = """
import os, signal, sys
from beambench import cli
signal.signal(int(sys.argv[1]), signal.SIG_DFL)  # a process in the background, as this test may be, is born deaf to it
def command(tokens):
    # As the import of a module that defines a dataclass does, which `exec`s the text of its methods.
    exec("os.kill(os.getpid(), int(sys.argv[1]))\\nfor _ in range(10**7): pass")
cli._run = command
sys.exit(cli.main())
"""


@pytest.mark.parametrize("sign", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize("debug", [[], ["--debug"]])
def test_an_end_within_the_exec_of_a_text_is_130(sign: signal.Signals, debug: list[str], tmp_path: Path) -> None:
    """CPython took the handled interrupt for an unhandled one, and ended the process by SIGINT."""
    (tmp_path / "ended.py").write_text(ENDED)
    path = os.pathsep.join([str(tmp_path), *sys.path])
    done = subprocess.run(
        [sys.executable, "-m", "ended", str(int(sign)), *debug], env=os.environ | {"PYTHONPATH": path},
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 130 and "interrupted" in done.stderr, done.stderr


def test_signs_that_a_terminal_lacks_are_plain() -> None:
    """What the tables print reads in a terminal that knows ASCII or Latin-1 alone; other signs keep their number."""
    from beambench.plain_signs import PLAIN_SIGNS

    text = "2.60 µs ± 3 %, 1 × 2 – 3 σ ≥ 4 m²"
    assert text.encode("ascii", PLAIN_SIGNS) == b"2.60 us +- 3 %, 1 x 2 - 3 sigma >= 4 m^2"
    assert text.encode("latin-1", PLAIN_SIGNS) == "2.60 µs ± 3 %, 1 × 2 - 3 sigma >= 4 m²".encode("latin-1")
    assert "漢".encode("ascii", PLAIN_SIGNS) == b"\\u6f22"


def test_a_command_prints_plain_signs_where_the_locale_is_c() -> None:
    environment = {"PATH": os.environ["PATH"], "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    environment |= {name: os.environ[name] for name in ("PYTHONPATH", "HOME", "XDG_CACHE_HOME") if name in os.environ}
    done = subprocess.run(
        [sys.executable, "-m", "beambench", "scenes", "list"],
        env=environment,
        capture_output=True,
        check=True,
        timeout=120,
    )
    assert b" x (" in done.stdout and b"\\x" not in done.stdout
