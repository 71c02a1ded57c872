"""A verb replaces only its own earlier output, and only when the new one is complete."""

from __future__ import annotations

import errno
import fcntl
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import beambench
from beambench import cli
from beambench.benchmarks.folders import kinds
from beambench.benchmarks.folders.kinds import Kind, verb_in
from beambench.benchmarks.folders.workplace import UNFINISHED, workplace
from beambench.benchmarks.laws.gated import clean_capture
from beambench.captures import write
from beambench.scenes.errors import InputError

from ._folders import a_run, plant, tree

ALL = [kinds.RUN, kinds.SWEEP, kinds.ESTIMATE, kinds.SCORE, kinds.REPRODUCE, kinds.BREAK, kinds.FIDELITY]

SUITE: dict[str, Any] = {
    "suite": "mine",
    "scenes": [{"scene": "flat-wall", "overrides": {"rig.camera.rows": 8, "rig.camera.cols": 8}}],
    "estimators": ["peak"],
    "stresses": [{"axis": "photons", "values": [1.0, 0.1]}],
    "seeds": {"test": [1]},
}


@pytest.mark.parametrize("kind", ALL, ids=lambda kind: kind.verb)
def test_a_folder_of_anybody_else_is_never_touched(kind: Kind, tmp_path: Path) -> None:
    marks = {"pyproject.toml": "", "manifest.json": "{}", "zarr.json": "{}", "run.json": "{}", "thesis.tex": "years"}
    before = plant(tmp_path / "home", marks | {"src/work.py": ""})
    for flag in ({"overwrite": True}, {"resume": True}, {}):
        with pytest.raises(InputError, match=r"did not write|not empty"), workplace(tmp_path / "home", kind, **flag):
            pytest.fail("let in")
    assert tree(tmp_path / "home") == before


def test_each_verb_replaces_its_own_output_only(tmp_path: Path) -> None:
    before = a_run(tmp_path / "run")
    assert verb_in(tmp_path / "run") == "run"
    for kind in ALL:
        if kind is not kinds.RUN:
            with pytest.raises(InputError, match="beambench run"), workplace(tmp_path / "run", kind, overwrite=True):
                pytest.fail("let in")
    assert tree(tmp_path / "run") == before


@pytest.mark.parametrize("verb", [kinds.RUN, kinds.SWEEP], ids=lambda kind: kind.verb)
def test_a_finished_run_is_not_to_be_finished(verb: Kind, tmp_path: Path) -> None:
    a_run(tmp_path, verb.verb)
    record = tmp_path / "run.json"

    def told() -> str:
        with pytest.raises(InputError, match="not empty") as caught, workplace(tmp_path, verb):
            pytest.fail("let in")
        return str(caught.value)

    assert "--resume to finish it" in told()
    record.write_text(json.dumps({"verb": verb.verb, "finished": "2026-01-02T03:04:05+00:00"}))
    assert f"a finished {verb.verb}" in told() and "--resume" not in told() and "--overwrite" in told()
    later = record.stat().st_mtime + 5
    os.utime(tmp_path / "journal.jsonl", (later, later))
    assert "--resume to finish it" in told(), "work was recorded after the end"


def test_the_new_takes_the_place_of_the_old_and_leaves_what_is_not_ours(tmp_path: Path) -> None:
    out = tmp_path / "run"
    before = a_run(out)
    with workplace(out, kinds.RUN, overwrite=True) as work:
        plant(work, {"run.json": "{}", "scores.csv": "new", "pictures/c__d.npz": "new", "new/part.txt": "new"})
        assert {name: data for name, data in tree(out).items() if not name.startswith(UNFINISHED)} == before
    kept = {name: before[name] for name in ("mine.txt", "pictures/my.png")}
    made = {"run.json": b"{}", "scores.csv": b"new", "pictures/c__d.npz": b"new", "new/part.txt": b"new"}
    assert tree(out) == kept | made
    assert sorted(path.name for path in out.iterdir() if path.is_dir()) == ["new", "pictures"]


@pytest.mark.parametrize("error", [KeyboardInterrupt(), InputError("no such rung"), MemoryError()])
def test_a_failure_leaves_the_old_as_it_was(error: BaseException, tmp_path: Path) -> None:
    out = tmp_path / "run"
    before = a_run(out)
    with pytest.raises(type(error)), workplace(out, kinds.RUN, overwrite=True) as work:
        plant(work, {"journal.jsonl": "{}\n"})
        raise error
    assert tree(out) == before, "nothing was finished, so nothing is left"
    with pytest.raises(type(error)) as caught, workplace(out, kinds.RUN, overwrite=True) as work:
        plant(work, {"journal.jsonl": '{"suite_hash": "h"}\n{}\n'})
        raise error
    assert before.items() <= tree(out).items() and (out / UNFINISHED / "journal.jsonl").exists()
    assert any(f"--resume and --out {out / UNFINISHED}" in note for note in caught.value.__notes__)
    with workplace(out / UNFINISHED, kinds.RUN, resume=True) as work:
        assert work == out / UNFINISHED
    with workplace(out, kinds.RUN, overwrite=True) as work:
        assert not any(work.iterdir()), "another attempt begins afresh"
        plant(work, {"run.json": "{}"})


def test_an_exchange_that_fails_half_way_is_taken_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "run"
    before = a_run(out)
    rename, calls = os.rename, []

    def failing(source: Any, target: Any) -> None:
        calls.append(source)
        if len(calls) == 7:
            raise OSError(errno.EIO, "Input/output error")
        rename(source, target)

    monkeypatch.setattr(os, "rename", failing)
    with pytest.raises(InputError, match="cannot be written"), workplace(out, kinds.RUN, overwrite=True) as work:
        plant(work, {"run.json": "{}", "scores.csv": "new", "journal.jsonl": "{}\n{}\n"})
    assert len(calls) > 7
    left = tree(out)
    assert before.items() <= left.items() and left[f"{UNFINISHED}/scores.csv"] == b"new"


def test_a_fresh_output_that_fails_leaves_nothing(tmp_path: Path) -> None:
    for kind in ALL:
        with pytest.raises(InputError), workplace(tmp_path / "a" / "b", kind) as work:
            names = [name for name in kind.owned if "*" not in name and name not in ("search.csv", "fidelity.csv")]
            plant(work, dict.fromkeys(names, "x"))
            raise InputError("bad")
        assert not (tmp_path / "a").exists()


def test_a_part_that_is_a_link_leads_elsewhere(tmp_path: Path) -> None:
    a_run(tmp_path / "run")
    before = plant(tmp_path / "archive", {"a__b.npz": "kept"})
    (tmp_path / "run" / "maps").symlink_to(tmp_path / "archive")
    (tmp_path / "archive" / "x.svg").write_text("kept")
    with workplace(tmp_path / "run", kinds.RUN, overwrite=True) as work:
        plant(work, {"run.json": "{}"})
    assert tree(tmp_path / "archive") == before | {"x.svg": b"kept"}


def test_the_folder_one_works_in_is_not_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = plant(tmp_path / "here", {"run.json": '{"verb": "reproduce"}', "reproduction.csv": "x"})
    (tmp_path / "here" / "below").mkdir()
    for place, out in (("here", "."), ("here/below", "..")):
        monkeypatch.chdir(tmp_path / place)
        assert cli.main(["reproduce", "--no-pictures", "-o", out, "--overwrite"]) == 2
    assert tree(tmp_path / "here") == before


def test_two_processes_do_not_write_one_folder(tmp_path: Path) -> None:
    out = tmp_path / "run"
    before = a_run(out)
    handle = os.open(
        out, os.O_RDONLY
    )  # a lock belongs to the opened file, so that another handle acts as another process
    fcntl.flock(handle, fcntl.LOCK_EX)
    try:
        for flags in ({"resume": True}, {"overwrite": True}):
            with pytest.raises(InputError, match="Another process"), workplace(out, kinds.RUN, **flags):
                pytest.fail("let in")
    finally:
        os.close(handle)
    assert tree(out) == before
    with workplace(out, kinds.RUN, resume=True):
        pass


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("data") / "made-up.zarr", clean_capture())


def test_an_input_is_never_an_output(store: Path, tmp_path: Path) -> None:
    before = tree(store)
    for out in (store, store / "below", store.parent):
        for overwrite in (False, True):
            with pytest.raises(InputError, match="would overwrite an input"):
                beambench.estimate(store, ["peak"], out=out, overwrite=overwrite)
            with pytest.raises(InputError, match="would overwrite an input"):
                beambench.score(store, tmp_path, out=out, overwrite=overwrite)
    plant(tmp_path / "estimates", {"estimates.json": '{"estimators": ["peak"]}', "peak.h5": "old"})
    with pytest.raises(InputError, match="would overwrite an input"):
        beambench.score(store, tmp_path / "estimates", out=tmp_path / "estimates", overwrite=True)
    assert tree(store) == before


def _written(path: Path) -> tuple[int, int, int]:
    """What changes when a file is written again; when it is read, only its time of access does."""
    found = path.stat()
    return found.st_ino, found.st_size, found.st_mtime_ns


def test_estimates_are_resumed_and_replaced(store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "estimates"
    for bad in ({"time_limit_s": -1.0}, {"time_limit_s": float("nan")}, {"memory_limit_bytes": 10}):
        with pytest.raises(InputError, match="limit"):
            beambench.estimate(store, ["peak"], out=out, **bad)
    with pytest.raises(InputError, match="nothing to resume"):
        beambench.estimate(store, ["peak"], out=out, resume=True)
    assert not out.exists()
    beambench.estimate(store, ["peak"], out=out)
    first = _written(out / "peak.h5")
    (out / "notes.h5").write_text("mine")
    asked: list[str] = []
    beambench.estimate(store, ["peak", "parabola"], out=out, resume=True, progress=lambda *step: asked.append(step[3]))
    assert [text.partition(":")[0] for text in asked] == ["parabola"]
    assert _written(out / "peak.h5") == first
    assert json.loads((out / "estimates.json").read_text())["estimators"] == ["peak", "parabola"]
    before = tree(out)

    def full(path: Path, label: str, modality: str, captures_sha256: str = "") -> None:
        raise InputError("the disk is full")

    with monkeypatch.context() as patch:
        patch.setattr(beambench.captures.estimates, "estimates_output", full)
        with pytest.raises(InputError, match="full"):
            beambench.estimate(store, ["peak"], out=out, overwrite=True)
    assert tree(out) == before, "the new is written before the old goes"
    beambench.estimate(store, ["peak"], out=out, overwrite=True)
    assert sorted(tree(out)) == ["estimates.json", "notes.h5", "peak.h5"]
    other = write(tmp_path / "other.zarr", clean_capture(seed=2))
    with pytest.raises(InputError, match="other captures"):
        beambench.estimate(other, ["peak"], out=out, resume=True)


@pytest.mark.parametrize(
    ("verb", "overrides"),
    [("run", {"fidelity": "best"}), ("sweep", {"fidelity": "best"}), ("sweep", {"stresses": []}),
     ("sweep", {"stresses": [{"axis": "photons", "values": [1.0]}]}),
     ("sweep", {"stresses": [{"axis": "photons", "values": [1.0, 0.1, 0.5]}]}),
     ("sweep", {"stresses": [{"axis": "photons", "values": [1.0, 0.0]}]}),
     ("run", {"stresses": [{"axis": "target.wall", "values": [1.0]}]}),
     ("run", {"stresses": [{"axis": "target.0", "values": [1.0]}]}),
     ("run", {"stresses": [{"axis": "target.nobody", "values": [1.0]}]})],
)  # fmt: skip
def test_a_bad_suite_costs_nothing(verb: str, overrides: dict[str, Any], tmp_path: Path) -> None:
    before = a_run(tmp_path / "run", verb)
    with pytest.raises(InputError):
        getattr(beambench, verb)(SUITE, overrides=overrides, out=tmp_path / "run", overwrite=True)
    with pytest.raises(InputError):
        getattr(beambench, verb)(SUITE, overrides=overrides, out=tmp_path / "new")
    assert tree(tmp_path / "run") == before and not (tmp_path / "new").exists()


@pytest.mark.parametrize("option", [{"budget": 0}, {"seed": -5}, {"side": 1}, {"neighbours": ["nobody"]}])
def test_a_bad_search_costs_nothing(option: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    before = plant(tmp_path / "brk", {"run.json": '{"verb": "break"}', "break-peak.toml": "the find"})
    with pytest.raises(InputError):
        beambench.break_("peak", out=tmp_path / "brk", overwrite=True, **option)
    with pytest.raises(InputError):
        beambench.break_("peak", **option)
    assert tree(tmp_path / "brk") == before and [path.name for path in tmp_path.iterdir()] == ["brk"]


def test_an_interrupted_search_keeps_what_it_judged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from beambench.benchmarks.search import break_run

    def answers(self: Any, candidate: Any, seed: int) -> dict[str, dict[str, Any]]:
        answers.calls += 1  # type: ignore[attr-defined]
        if answers.calls == 4:  # type: ignore[attr-defined]
            raise KeyboardInterrupt
        row = {"status": "ok", "rmse_full": 1.0, "bound": 0.1, "bound_kind": "exact"}
        return {"peak": row, "poisson-ml": row}

    answers.calls = 0  # type: ignore[attr-defined]
    monkeypatch.setattr(break_run._Judge, "answers", answers)
    with pytest.raises(KeyboardInterrupt) as caught:
        beambench.break_("peak", scenes=["flat-wall"], neighbours=["poisson-ml"], side=4, out=tmp_path / "brk")
    lines = (tmp_path / "brk" / "search.csv").read_text().splitlines()
    assert lines[0] == "scene,levels,badness" and len(lines) == 4 and lines[1] == "flat-wall,,0"
    assert any("search.csv" in note for note in caught.value.__notes__)
    assert verb_in(tmp_path / "brk") == "break"


@pytest.mark.parametrize("verb", ["run", "sweep"])
def test_only_what_was_begun_is_gone_on_with(verb: str, tmp_path: Path) -> None:
    from beambench.benchmarks.suites.suite import load_suite

    call = getattr(beambench, verb)
    with pytest.raises(InputError, match="needs the folder"):
        call(SUITE, resume=True)
    with pytest.raises(InputError, match="nothing to resume"):
        call(SUITE, out=tmp_path / "typo", resume=True)
    with pytest.raises(InputError, match="exclude"):
        call(SUITE, out=tmp_path / "typo", resume=True, overwrite=True)
    with pytest.raises(InputError, match="split"):
        call(SUITE, out=tmp_path / "typo", split="both")
    with pytest.raises(InputError, match="list of labels"):
        call(SUITE, out=tmp_path / "typo", estimators="peak")
    assert not (tmp_path / "typo").exists()
    other = {"run": "sweep", "sweep": "run"}[verb]
    before = a_run(tmp_path / "other", other)
    with pytest.raises(InputError, match=f"beambench {other}"):
        call(SUITE, out=tmp_path / "other", resume=True)
    assert tree(tmp_path / "other") == before
    header = {"suite_hash": load_suite(SUITE).hash, "verb": verb, "split": "test", "budget": 16, "depth": 2}
    before = plant(tmp_path / "mine", {"journal.jsonl": json.dumps(header) + "\n"})
    for changes, name in (({"split": "dev"}, "split"), ({"budget": 4}, "budget"), ({"depth": 1}, "depth")):
        if verb == "sweep" or name == "split":
            with pytest.raises(InputError, match=rf"another {name}|another suite"):
                suite = SUITE if name != "split" else SUITE | {"seeds": {"test": [1], "dev": [2]}}
                call(suite, out=tmp_path / "mine", resume=True, **changes)
    assert tree(tmp_path / "mine") == before


def test_a_measurement_of_rungs_is_guarded(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("x")
    broken = plant(tmp_path / "broken", {"fidelity.csv": "modality,scene,rung,\n", "fidelity-scenes.json": '{"seed": '})
    assert cli.main(["fidelity", "-o", str(tmp_path / "file")]) == 2
    assert cli.main(["fidelity", "-o", str(tmp_path / "broken"), "--resume"]) == 2
    assert "cannot be read" in capsys.readouterr().err
    assert cli.main(["fidelity", "-o", str(tmp_path / "broken")]) == 2
    assert cli.main(["fidelity", "-o", str(tmp_path / "broken"), "--resume", "--overwrite"]) == 2
    assert cli.main(["fidelity", "--resume"]) == 2
    assert cli.main(["fidelity", "--resume", "-o", str(tmp_path / "typo")]) == 2
    plant(tmp_path / "home", {"thesis.tex": "x"})
    assert cli.main(["fidelity", "--overwrite", "-o", str(tmp_path / "home")]) == 2
    assert tree(tmp_path / "broken") == broken and sorted(tree(tmp_path)) == [
        "broken/fidelity-scenes.json", "broken/fidelity.csv", "file", "home/thesis.tex",
    ]  # fmt: skip


def test_a_picture_is_whole_or_the_old_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import OpenImageIO as oiio

    from beambench.benchmarks.folders import files
    from beambench.generator.preview import picture as drawing

    picture = np.random.default_rng(1).integers(0, 256, (7, 5, 3), dtype=np.uint8)
    monkeypatch.setattr(drawing, "preview", lambda scene, size: drawing.Preview(picture, 0.5, (0.0, 1.0, 0.0), True))
    out = tmp_path / "a.png"
    out.write_text("no picture")
    with pytest.raises(InputError, match="Beambench did not write"):
        beambench.scenes_preview("step", out=out, overwrite=True)
    out.unlink()
    beambench.scenes_preview("step", out=out)
    image = oiio.ImageBuf(str(out))
    assert (image.get_pixels(oiio.UINT8) == picture).all()
    before = tree(tmp_path)

    def full(handle: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(files.os, "fsync", full)
    with pytest.raises(InputError, match="space"):
        beambench.scenes_preview("step", out=out, overwrite=True)
    assert tree(tmp_path) == before


@pytest.mark.parametrize(
    ("number", "told"), [(errno.EMFILE, "ulimit -n"), (errno.EAGAIN, "ulimit -u"), (errno.ENOMEM, "free memory")]
)
def test_a_limit_of_the_system_is_no_internal_error(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], number: int, told: str
) -> None:
    """`ulimit -n 20; beambench run …` ended with exit code 70, and asked for a report of the bug."""

    def limited(**options: Any) -> None:
        raise OSError(number, "planted")

    monkeypatch.setattr("beambench.benchmarks.reproduce.run.reproduce", lambda folder, **options: limited())
    assert cli.main(["reproduce", "-o", "never"]) == 2
    assert told in capsys.readouterr().err


def test_the_command_line_tells_what_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(folder: Path, **options: Any) -> None:
        plant(folder, {"reproduction.csv": ""})
        raise KeyboardInterrupt

    monkeypatch.setattr("beambench.benchmarks.reproduce.run.reproduce", interrupted)
    assert cli.main(["reproduce", "-o", str(tmp_path / "r")]) == 130
    assert capsys.readouterr().err.strip() == "interrupted" and not (tmp_path / "r").exists()

    def noted(*scenes: Any, **options: Any) -> None:
        with workplace(tmp_path / "f", kinds.FIDELITY) as work:
            plant(work, {"fidelity.csv": "x"})
            raise KeyboardInterrupt

    monkeypatch.setattr("beambench.benchmarks.fidelity.run.run_fidelity", noted)
    assert cli.main(["fidelity", "-o", str(tmp_path / "f")]) == 130
    assert f"--resume and --out {tmp_path / 'f'}" in capsys.readouterr().err

    def ended(*scenes: Any, **options: Any) -> None:
        raise SystemExit(0)

    monkeypatch.setattr("beambench.benchmarks.fidelity.run.run_fidelity", ended)
    assert cli.main(["fidelity", "-o", str(tmp_path / "g")]) == 70
