"""The command line: help, messages, exit codes and completion."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

import beambench
from beambench import cli

#: Every command, as typed.
COMMANDS = (
    "run", "scenes list", "scenes show", "scenes preview", "generate", "data status", "data verify", "data repair", "data finalize",
    "estimate",
    "score", "estimators list", "estimators check", "estimators new", "report", "compare", "doctor",
    "export", "bound", "design", "twin", "sweep", "break", "fidelity", "reproduce",
    "record", "drivers list",
)  # fmt: skip


def typed(*words: str, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Type a command into a process of its own."""
    return subprocess.run(
        [sys.executable, "-m", "beambench", *words], capture_output=True, text=True, cwd=cwd, timeout=120, check=False
    )


def test_help_is_fast() -> None:
    """0.4 s from a warm file cache: CPU time always, wall time where no other work keeps the cores busy."""
    walls, cpus = [], []
    for _ in range(5):
        start, before = time.perf_counter(), os.times()
        done = typed("--help")
        walls.append(time.perf_counter() - start)
        after = os.times()
        cpus.append(after.children_user + after.children_system - before.children_user - before.children_system)
        assert done.returncode == 0
    print(f"--help: best wall {min(walls):.3f} s, best CPU {min(cpus):.3f} s")
    assert min(cpus) <= 0.4
    if os.getloadavg()[0] < 0.5 * (os.cpu_count() or 1):
        assert min(walls) <= 0.4


def test_help_loads_nothing_heavy() -> None:
    code = (
        "import sys; from beambench.cli import main; main(['--help'])\n"
        "heavy = {'numpy', 'xarray', 'pydantic', 'pandas', 'numba', 'scipy', 'zarr', 'h5py', 'altair', 'mitsuba'}\n"
        "print('HEAVY', sorted(heavy & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.strip().endswith("HEAVY []")


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself_with_an_example(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main([*command.split(), "--help"]) == 0
    shown = capsys.readouterr().out
    assert "Example" in shown
    assert f"beambench {command}" in shown


def test_every_command_is_listed(capsys: pytest.CaptureFixture[str]) -> None:
    """Also without any argument."""
    assert cli.main([]) == 0
    shown = capsys.readouterr().out
    for command in COMMANDS:
        assert f" {command.split()[0]} " in shown
    assert "130" in shown


def test_commands_are_functions_of_the_same_name_and_arguments() -> None:
    """`beambench scenes list` is `beambench.scenes_list`; --set is `overrides`."""
    import inspect

    for command in COMMANDS:
        words = command.split()
        app = cli.app
        for word in words:
            app = app[word]
        assert app.default_command is not None
        typed_names = list(inspect.signature(app.default_command).parameters)
        typed_names = ["overrides" if name == "set_" else name for name in typed_names if name != "common"]
        name = "_".join(words)
        function = getattr(beambench, "break_" if name == "break" else name)  # a keyword of Python takes an underscore
        names = [name for name in inspect.signature(function).parameters if name not in {"progress", "command"}]
        assert typed_names == names, command


def test_the_package_lists_its_verbs() -> None:
    assert set(beambench.__all__) <= set(dir(beambench))
    assert beambench.__version__
    for name in beambench.__all__:
        assert getattr(beambench, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'sweeep'"):
        beambench.sweeep  # noqa: B018


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["nope"], "nope"),
        (["run", "quickstart", "--nope"], "--nope"),
        (["run"], "suite"),
        (["run", "no-such-suite"], "no-such-suite"),
        (["scenes", "show", "flat-wal"], "flat-wall"),
        (["scenes", "show", "flat-wall", "--set", "rig.camera.rowz=3"], "rowz"),
        (["scenes", "show", "flat-wall", "--set", "rig.nothing.rows=3"], "nothing"),
        (["scenes", "show", "flat-wall", "--set", "no-equals-sign"], "PATH=VALUE"),
        (["scenes", "show", "flat-wall", "--set", "rig.camera.rows=-3"], "rig.camera.rows"),
        (["scenes", "show", "flat-wall", "--set", "rig.laser.pulse_energy_j=NaN"], "finite"),
        (["generate"], "--like"),
        (["generate", "flat-wall", "--rtol", "much"], "rtol"),
        (["generate", "no-such-scene", "--plan"], "no-such-scene"),
        (["report", "no-such-folder"], "no-such-folder"),
        (["compare", "no-a", "no-b"], "no-a"),
        (["data", "verify", "no-such-store"], "no-such-store"),
        (["estimate", "no-such-store", "-e", "peak"], "no-such-store"),
        (["estimate", "no-such-store", "-e", "peek"], "peak"),
        (["estimators", "check", "no-such-estimator"], "no-such-estimator"),
        (["estimators", "new", "Not A Name"], "lower-case"),
        (["completion", "tcsh"], "bash"),
    ],
)
def test_bad_usage_and_input_exit_2(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The message names the offender on standard error, without a traceback; nothing is left behind."""
    monkeypatch.chdir(tmp_path)
    assert cli.main(words) == 2
    shown = capsys.readouterr()
    assert said.lower() in shown.err.lower()
    assert "Traceback" not in shown.err
    assert shown.out == ""
    assert not list(tmp_path.iterdir())


def test_debug_shows_the_traceback(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["scenes", "show", "flat-wal", "--debug"]) == 2
    assert "Traceback" in capsys.readouterr().err


def test_json_beside_text(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["scenes", "list", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert cli.main(["scenes", "list"]) == 0
    shown = capsys.readouterr().out
    assert rows and all(row["name"] in shown for row in rows)


def test_a_shown_scene_loads_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:  # config and Python give the same spec
    assert cli.main(["scenes", "show", "flat-wall", "--set", "rig.camera.rows=48", "--set", "name=mine"]) == 0
    path = tmp_path / "scene.json"
    path.write_text(capsys.readouterr().out)
    assert beambench.scenes_show(path) == beambench.scenes_show(
        "flat-wall", overrides={"rig.camera.rows": 48, "name": "mine"}
    )


def test_python_m_and_the_version() -> None:
    done = typed("--version")
    assert (done.returncode, done.stdout.strip()) == (0, beambench.__version__)


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_script(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["completion", shell]) == 0
    script = capsys.readouterr().out
    assert "beambench" in script
    for word in ("scenes", "estimators", "doctor"):
        assert word in script


def test_the_bash_script_is_valid(capsys: pytest.CaptureFixture[str]) -> None:
    cli.main(["completion", "bash"])
    script = capsys.readouterr().out
    done = subprocess.run(["bash", "-n"], input=script, capture_output=True, text=True, timeout=30, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("words", ["--help", "scenes show flat-wall", "scenes list"])
def test_a_reader_that_stops_early_is_no_error(words: str) -> None:
    """`beambench … | head -1`: the pipe is closed before anything is written."""
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(
        [sys.executable, "-m", "beambench", *words.split()], stdout=writer, stderr=subprocess.PIPE, text=True,
        timeout=60, check=False,
    )  # fmt: skip
    os.close(writer)
    assert (done.returncode, done.stderr) == (0, "")


def test_an_interruption_exits_130(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def interrupted(*args: object, **options: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("beambench.scenes.load.list_scenes", interrupted)
    assert cli.main(["scenes", "list"]) == 130
    assert "Traceback" not in capsys.readouterr().err


def test_an_internal_error_exits_70(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def broken(*args: object, **options: object) -> None:
        raise RuntimeError("a bug")

    monkeypatch.setattr("beambench.scenes.load.list_scenes", broken)
    assert cli.main(["scenes", "list"]) == 70
    shown = capsys.readouterr().err
    assert "RuntimeError: a bug" in shown and "--debug" in shown and "Traceback" not in shown
    assert cli.main(["scenes", "list", "--debug"]) == 70
    assert "Traceback" in capsys.readouterr().err


def test_a_full_disk_is_the_users_to_mend(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def full(*args: object, **options: object) -> None:
        raise OSError(28, "No space left on device", "/somewhere/scores.csv")

    monkeypatch.setattr("beambench.scenes.load.list_scenes", full)
    assert cli.main(["scenes", "list"]) == 2
    shown = capsys.readouterr().err
    assert "No space left on device" in shown and "/somewhere/scores.csv" in shown
