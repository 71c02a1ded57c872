"""Data sets made by the workers of a Dask scheduler: the same files as by one process, also where workers die; clear refusals."""

from __future__ import annotations

import json
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from beambench.benchmarks.checks.data_set_dask import Machines
from beambench.benchmarks.datasets.cluster import Cluster
from beambench.benchmarks.datasets.crew import Task
from beambench.benchmarks.datasets.large import Force, make_dataset
from beambench.benchmarks.datasets.remote import about, look, make
from beambench.benchmarks.folders.progress import silent
from beambench.captures.provenance import cpu
from beambench.scenes.datasets.load import load_dataset
from beambench.scenes.errors import InputError

from ._data_sets import QUICK, tiny

pytest.importorskip("distributed", reason="the extra `dask` is not installed")


def made(out: Path, force: Force, resume: bool = False) -> Any:
    return make_dataset(load_dataset(tiny(QUICK)), out, force, resume=resume, overwrite=False, tell=silent)


def tree(root: Path) -> dict[str, bytes]:
    return {str(path.relative_to(root)): path.read_bytes() for path in root.rglob("*") if path.is_file()}


def test_workers_that_die_change_nothing(tmp_path: Path) -> None:
    """Two workers, one of which is killed with its first shard and replaced; every file is that of one process."""
    one = made(tmp_path / "one", Force(1))
    with Machines(tmp_path, 2) as machines:

        def kill() -> None:
            until = time.monotonic() + 300
            while not list((tmp_path / "many.partial").glob("*/*/c.*.partial")) and time.monotonic() < until:
                if (tmp_path / "many").exists() or list((tmp_path / "many.partial").glob("*/*/c.*")):
                    break
                time.sleep(0.01)
            machines.kill(0)
            machines.add()

        killer = threading.Thread(target=kill)
        killer.start()
        many = made(tmp_path / "many", Force(dask=machines.address))
        killer.join()
    assert many.content == one.content
    assert tree(tmp_path / "many") == tree(tmp_path / "one")


#: Where no scheduler listens.
NOBODY = "tcp://localhost:9"


def test_no_scheduler_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("beambench.benchmarks.datasets.cluster._SCHEDULER_S", 1.0)
    for address in (NOBODY, "nowhere"):
        with pytest.raises(InputError, match="No Dask scheduler"):
            cluster(tmp_path, address).__enter__()


def cluster(root: Path, address: str = NOBODY) -> Cluster:
    return Cluster({"root": str(root), "structures": {}}, address, limit_s=None, expected_s=0.0)


class Client:
    """What the scheduler would give: one worker that tells this."""

    def __init__(self, told: Any) -> None:
        self.told = told

    def run(self, *_: Any, **__: Any) -> dict[str, Any]:
        return {"tcp://far": self.told}


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"token": "", "problem": "no such folder"}, "does not see the folder"),
        ({"token": "of another run"}, "does not see the folder"),
        ({"about": {"numpy": "1.0"}}, "other versions"),
    ],
)
def test_workers_of_another_folder_or_version_are_refused(tmp_path: Path, changes: dict[str, Any], told: str) -> None:
    far = cluster(tmp_path)
    answer = {"token": far._token, "problem": "", "about": about(), "cpu": cpu()}
    far._client = Client(json.dumps(answer))  # type: ignore[assignment]
    far._check({"tcp://far": 1})
    changed = answer | {key: {**about(), **one} if key == "about" else one for key, one in changes.items()}
    far._client = Client(json.dumps(changed))  # type: ignore[assignment]
    with pytest.raises(InputError, match=told):
        far._check({"tcp://far": 1})
    far._client = Client(ModuleNotFoundError("beambench"))  # type: ignore[assignment]
    with pytest.raises(InputError, match="cannot run Beambench"):
        far._check({"tcp://far": 1})
    far._client = Client(json.dumps(answer | {"cpu": {"model": "another"}}))  # type: ignore[assignment]
    far._check({"tcp://far": 1})
    assert "other processors" in far.events[0]
    far._client = Client(ConnectionResetError("it has died"))  # type: ignore[assignment]
    far._check({"tcp://far": 1})


def test_a_worker_looks_at_the_folder_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("beambench.benchmarks.datasets.remote._LAG_S", 0.0)
    (tmp_path / "receipts").mkdir()
    assert json.loads(look(str(tmp_path), "t"))["token"] == ""
    (tmp_path / "workers.token").write_text("t")
    assert json.loads(look(str(tmp_path), "t"))["token"] == "t"
    assert list((tmp_path / "receipts").iterdir()) == []
    (tmp_path / "workers.token").unlink()
    (tmp_path / "workers.token").symlink_to("/etc/hostname")
    assert json.loads(look(str(tmp_path), "t"))["token"] == ""
    asked = {"begin": {"root": str(tmp_path)}, "token": "t", "about": about(), "limit_s": None, "expected_s": 0.0}
    line = json.dumps({"group": "g", "shard": 0})
    assert "does not see the folder" in json.loads(make(json.dumps(asked), line))["stopped"]["what"]
    (tmp_path / "workers.token").unlink()
    (tmp_path / "workers.token").write_text("t")
    late = asked | {"about": about() | {"numpy": "1.0"}}  # one that came after the others were asked
    assert "other versions" in json.loads(make(json.dumps(late), line))["stopped"]["what"]


def test_a_shard_that_ends_three_workers_is_set_aside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also one that a worker says is done, and that is not in the folder."""
    monkeypatch.setattr("beambench.benchmarks.datasets.cluster._SEEN_S", 0.0)
    for told in ({"failed": "a worker was ended by signal 9"}, {"done": {"cpu_s": 1.0}}):
        far, task = cluster(tmp_path), Task("shard 3", {"group": "g", "shard": 3, "rows": [1]})
        assert [far._judge(task, dict(told)) for _ in range(3)] == [False, False, True]
        assert task.done is None
        assert "ended 3 workers" in task.lost
        assert len(far.events) == 3
    far, task = cluster(tmp_path), Task("shard 3", {"group": "g", "shard": 3, "rows": [1]})
    assert far._judge(task, {"failed": "KilledWorker: …", "final": True})
    assert "as the scheduler allows" in task.lost
    with pytest.raises(InputError, match="full"):
        words = {"what": "The disk is full.", "where": "x", "value": None, "allowed": "", "next_step": ""}
        far._judge(task, {"stopped": words})
