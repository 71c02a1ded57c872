"""Files of estimates and exports: complete or absent on a full disk, bound to their captures; malformed ones are refused."""

from __future__ import annotations

import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

import beambench
from beambench import InputError, cli
from beambench.captures import open_captures, write
from beambench.captures.estimates import Estimates, read_estimates, write_estimates
from beambench.captures.example import example_capture
from beambench.captures.hdf5 import hdf5_output

COUNT, SHAPE = 2, (6, 5)
SIZES = {"row": 6, "col": 5}


def estimates(**changes: Any) -> Estimates:
    one = {"range": np.ones(SHAPE), "sigma": np.ones(SHAPE), "valid": np.ones(SHAPE, bool)}
    values: dict[str, Any] = {
        "label": "peak", "modality": "gated", "arrays": [one, one], "cpu_s": [0.1] * 2, "wall_s": [0.1] * 2,
        "peak_bytes": [1.0] * 2, "status": ["ok"] * 2, "captures_sha256": "ab" * 32,
    }  # fmt: skip
    return Estimates(**(values | changes))


# ---------------------------------------------------------------- full disks

#: A limit on the size of a file refuses its blocks as a full disk does, and needs no root. HDF5 that cannot write on
#: closing ends the process with SIGSEGV when it tries again at its end, so that only a process of its own shows it.
LIMITED = """
import resource, sys
import numpy as np
from pathlib import Path
from beambench import cli
from beambench.scenes.errors import InputError
from beambench.captures.estimates import Estimates, write_estimates
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[1]),) * 2)
if sys.argv[2] == "export":
    sys.exit(cli.main(["export", sys.argv[3], "-o", sys.argv[4]]))
rng = np.random.default_rng(1)
one = {"range": rng.random((90, 90)), "sigma": rng.random((90, 90)), "valid": np.ones((90, 90), bool)}
try:
    write_estimates(Path(sys.argv[4]), Estimates("peak", "gated", [one], [0.0], [0.0], [0.0], ["ok"]))
except InputError as error:
    sys.exit(f"error: {error}")
"""


@pytest.mark.parametrize("what", ["export", "estimates"])
@pytest.mark.parametrize("limit", [100, 20_000])
def test_a_full_disk_is_told_and_leaves_nothing(tmp_path: Path, what: str, limit: int) -> None:
    store = write(tmp_path / "store", example_capture("gated", sizes={"slice": 8, "row": 60, "col": 60}))
    (tmp_path / "disk").mkdir()
    out = tmp_path / "disk" / "out.h5"
    done = subprocess.run(
        [sys.executable, "-c", LIMITED, str(limit), what, str(store), str(out)], capture_output=True, text=True
    )
    assert done.returncode == (2 if what == "export" else 1), done.stderr
    assert "File too large" in done.stderr and "Traceback" not in done.stderr
    assert list((tmp_path / "disk").iterdir()) == []


def test_the_earlier_file_stays_where_the_new_one_fails(tmp_path: Path) -> None:
    out = tmp_path / "peak.h5"
    write_estimates(out, estimates())
    before = out.read_bytes()
    with pytest.raises(RuntimeError), hdf5_output(out) as output:
        output.h5["x"] = np.zeros(3)
        raise RuntimeError
    assert out.read_bytes() == before and list(tmp_path.iterdir()) == [out]
    with pytest.raises(InputError, match="writing the file failed"):
        write_estimates(tmp_path / "none" / "x.h5", estimates())


def test_blocks_that_were_refused_are_read_back() -> None:
    """After the first refusal the sink still answers HDF5 with what was written, so that it can close."""
    import io

    from beambench.captures.hdf5 import _Sink

    with open("/dev/full", "rb+", buffering=0) as full:
        assert isinstance(full, io.FileIO)
        sink = _Sink(full)
        sink.seek(10)
        assert sink.write(b"abcdef") == 6 and sink.error is not None
        sink.seek(12)
        sink.write(b"XY")
        sink.seek(8)
        found = bytearray(8)
        assert sink.readinto(found) == 8 and found[2:] == b"abXYef" and sink.seek(0, 2) == 16


def test_an_export_that_meets_damage_leaves_nothing(tmp_path: Path) -> None:
    store = write(tmp_path / "store", [example_capture("gated", seed=seed) for seed in range(2)])
    chunk = store / "counts" / "c.1.0.0.0"
    content = bytearray(chunk.read_bytes())
    content[10] ^= 1
    chunk.write_bytes(content)
    (tmp_path / "out").mkdir()
    with pytest.raises(InputError, match="damaged"):
        beambench.export(store, out=tmp_path / "out" / "a.h5")
    assert list((tmp_path / "out").iterdir()) == []


# ---------------------------------------------------------------- whose estimates


def read(path: Path, **changes: Any) -> Estimates:
    return read_estimates(path, COUNT, SIZES, **({"modality": "gated", "captures_sha256": "ab" * 32} | changes))


def test_estimates_of_other_captures_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "peak.h5"
    write_estimates(path, estimates())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert read(path).label == "peak"
    with pytest.raises(InputError, match="made from other captures"):
        read(path, captures_sha256="cd" * 32)
    with pytest.raises(InputError, match="another modality"):
        read(path, modality="amcw")
    write_estimates(path, estimates(captures_sha256=""))
    with pytest.warns(UserWarning, match="does not state from which captures"):
        read(path)


def test_a_store_has_one_name_and_hands_it_on(tmp_path: Path) -> None:
    import hashlib

    store = write(tmp_path / "store", [example_capture("gated", seed=seed) for seed in range(2)])
    other = write(tmp_path / "other", [example_capture("gated", seed=seed) for seed in (0, 2)])
    name = open_captures(store).sha256
    assert name == hashlib.sha256((store / "manifest.json").read_bytes()).hexdigest() != open_captures(other).sha256
    with h5py.File(beambench.export(store, out=tmp_path / "a.h5")) as file:
        assert file.attrs["captures_sha256"] == name


# ---------------------------------------------------------------- odd content


def _group(file: h5py.File) -> None:
    del file["range"]
    file.create_group("range")


def _text(file: h5py.File) -> None:
    del file["range"]
    file["range"] = np.full((COUNT, *SHAPE), b"far", dtype="S3")


def _empty_dataset(file: h5py.File) -> None:
    del file["sigma"]
    file["sigma"] = h5py.Empty("f8")


def _replace(name: str, value: Any) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        if name in file:
            del file[name]
        file[name] = value

    return change


def _version(value: Any) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        file.attrs["schema_version"] = value

    return change


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (_group, "no array"),
        (_text, "holds no numbers"),
        (_empty_dataset, "no array"),
        (_replace("range", np.zeros((COUNT, *SHAPE), complex)), "holds no numbers"),
        (_replace("wall_s", np.array([b"fast", b"slow"])), "cannot be read"),
        (lambda file: (_replace("status", 1)(file), file.pop("status"), file.create_group("status"))[0], "no array"),
        (_version(np.array([], "i8")), "schema version"),
        (_version(h5py.Empty("i8")), "schema version"),
        (_version("one"), "schema version"),
        (_version(2), "schema version"),
        (_version(np.nan), "schema version"),
    ],
)
def test_odd_content_is_bad_input(tmp_path: Path, change: Callable[[h5py.File], None], told: str) -> None:
    path = tmp_path / "odd.h5"
    write_estimates(path, estimates())
    with h5py.File(path, "a") as file:
        change(file)
    with pytest.raises(InputError, match=told):
        read(path)


def test_score_refuses_them_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    store = write(tmp_path / "store", example_capture("gated"))
    sizes = open_captures(store).load(0).sizes
    shape = (sizes["row"], sizes["col"])
    one = {"range": np.ones(shape), "sigma": np.ones(shape), "valid": np.ones(shape, bool)}
    path = tmp_path / "peak.h5"
    for changes, told in (({"captures_sha256": "cd" * 32}, "other captures"), ({"modality": "amcw"}, "modality")):
        write_estimates(
            path, estimates(arrays=[one], cpu_s=[0.0], wall_s=[0.0], peak_bytes=[0.0], status=["ok"], **changes)
        )
        assert cli.main(["score", str(store), str(path), "-o", str(tmp_path / "s")]) == 2
        assert told in capsys.readouterr().err and not (tmp_path / "s").exists()


# ---------------------------------------------------------------- captures that no estimator reads


@pytest.mark.parametrize("modality", ["laser_line", "wavefront", "amcw"])
def test_captures_that_no_named_estimator_reads_are_bad_input(
    modality: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    store = write(tmp_path / "store", example_capture(modality))
    assert cli.main(["estimate", str(store), "-e", "peak", "-o", str(tmp_path / "out")]) == 2
    shown = capsys.readouterr().err
    assert "None of the named estimators reads captures of this modality." in shown and modality in shown
    assert "captures of modality gated" in shown and "beambench estimators list" in shown
    assert not (tmp_path / "out").exists()
    with pytest.raises(InputError, match="None of the named estimators"):
        beambench.estimate(store, ["peak", "weighted-average"], out=tmp_path / "out")


def test_one_estimator_that_reads_the_captures_is_enough(tmp_path: Path) -> None:
    """The others are skipped, and their file says why."""
    store = write(tmp_path / "store", example_capture("gated"))
    folder = beambench.estimate(store, ["peak", "amcw-phase"], out=tmp_path / "out")
    with h5py.File(folder / "amcw-phase.h5") as file:
        assert [text.decode() for text in file["status"][()]] == ["skip: reads amcw captures, not gated"]
    with h5py.File(folder / "peak.h5") as file:
        assert not file["status"][()][0].startswith(b"skip")


def test_captures_are_laid_out_one_at_a_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A data set of any size needs the temporary space of one capture; each estimator reads all of them."""
    import beambench
    from beambench.benchmarks.datasets.estimate import _Captures

    store = write(tmp_path / "store", [example_capture("gated", seed=seed) for seed in range(4)])
    seen: list[list[str]] = []
    lay = _Captures.lay

    def counted(self: _Captures, job: Any) -> None:
        lay(self, job)
        seen.append(sorted(path.name for path in self._scratch.iterdir() if path.name.isdigit()))

    monkeypatch.setattr(_Captures, "lay", counted)
    beambench.estimate(store, ["peak", "parabola"], out=tmp_path / "out")
    assert {tuple(names) for names in seen} == {(f"{index:06d}",) for index in range(4)}
    sizes = {str(name): size for name, size in open_captures(store).load(0).sizes.items()}
    for name in ("peak", "parabola"):
        found = read_estimates(tmp_path / "out" / f"{name}.h5", 4, sizes, modality="gated")
        assert len(found.status) == 4


def test_a_longer_answer_makes_room_for_all(tmp_path: Path) -> None:
    """Estimates written one after the other are those written at once: NaN where one is shorter, or there is none."""
    from beambench.captures.estimates import estimates_output
    from beambench.captures.layouts import layout_of

    stage = layout_of("laser_line").stages[0]
    names = [name for quantity in stage.gives for name in stage.variables(quantity).all]
    short = {name: np.zeros((2, 3, 1), "?" if name == "valid" else "f8") for name in names}
    long = {name: np.ones((2, 3, 2), "?" if name == "valid" else "f8") for name in names}
    with estimates_output(tmp_path / "x.h5", "x", "laser_line", "s") as output:
        for arrays in (None, short, long, None):
            output.add(arrays, stage, (1.0, 2.0, 3.0), "ok" if arrays else "error: none")
    import h5py

    with h5py.File(tmp_path / "x.h5") as file:
        for name in names:
            values = file[name][()]
            assert values.shape == (4, 2, 3, 2)
            assert (values[2] == 1).all()
            assert (values[1, ..., 0] == 0).all()
            empty = values[[0, 3]]
            assert not empty.any() if name == "valid" else np.isnan(empty).all()
            assert not values[1, ..., 1].any() if name == "valid" else np.isnan(values[1, ..., 1]).all()
        assert list(file["cpu_s"]) == [1.0] * 4
