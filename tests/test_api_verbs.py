"""The verbs, from a scene to a comparison, as functions and as commands: both give the same."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest

import beambench
from beambench import cli
from beambench.estimators.package import is_package
from beambench.output import claim, default_out, slug

SMALL = {"rig.camera.rows": 20, "rig.camera.cols": 24}
SET = ["--set", "rig.camera.rows=20", "--set", "rig.camera.cols=24"]


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two seeds of a small wall."""
    if importlib.util.find_spec("mitsuba") is None:  # importing it here would let it find a libLLVM of its own
        pytest.skip("Mitsuba is not installed")
    path = tmp_path_factory.mktemp("data") / "wall.zarr"
    made = beambench.generate("flat-wall", overrides=SMALL, seeds=[1, 2], out=path)
    assert made.paths == [path]
    return path


@pytest.fixture(scope="module")
def estimates(store: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("estimates") / "made"
    return beambench.estimate(store, ["peak", "weighted-average"], out=out)


@pytest.fixture(scope="module")
def scores(store: Path, estimates: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("scores") / "made"
    table = beambench.score(store, estimates, out=out)
    assert table.attrs["folder"] == str(out)
    return out


def test_scenes(capsys: pytest.CaptureFixture[str]) -> None:
    rows = {row["name"]: row for row in beambench.scenes_list()}
    assert rows["flat-wall"]["rows"] == beambench.scenes_show("flat-wall").rig.camera.rows
    assert all(row["slices"] > 0 for row in rows.values())


def test_a_command_and_a_function_give_the_same_bits(store: Path, tmp_path: Path) -> None:
    from beambench.captures.compare import compare_stores

    assert (
        cli.main(["generate", "flat-wall", *SET, "--seeds", "1", "--seeds", "2", "-o", str(tmp_path / "cli.zarr")]) == 0
    )
    assert all(item.equal for item in compare_stores(store, tmp_path / "cli.zarr"))


def test_a_plan_makes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    made = beambench.generate("quickstart", plan=True)
    assert len(made.plan) >= 3 and not made.paths and not list(tmp_path.iterdir())
    stacks = [item for item in made.plan if item["scene"] in ("relief-tank", "object1", "object2")]
    assert len(stacks) == 3 and all(
        item["rows"] >= 256 and item["cols"] >= 256 and item["slices"] >= 64 for item in stacks
    )


def test_like_repeats_a_store(store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = beambench.generate(like=store)
    assert made.equal and made.differing == 0 and len(made.comparison) == 2
    assert cli.main(["generate", "--like", str(store), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["like"]["equal"] is True


def test_like_counts_what_differs(store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from beambench.captures import open_captures, write

    capture = open_captures(store)[0]
    counts = capture["counts"].values.copy()
    counts[3, 2, 1] += 1
    changed = capture.assign(counts=capture["counts"].copy(data=counts))
    path = write(tmp_path / "changed.zarr", changed)
    assert cli.main(["generate", "--like", str(path)]) == 1
    assert f"1 of {counts.size} values differ" in capsys.readouterr().out


def test_status_and_verify(store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status = beambench.data_status(store)
    assert (status["count"], status["modality"]) == (2, "gated")
    assert [row["seed"] for row in status["captures"]] == [1, 2]
    assert cli.main(["data", "status", str(store)]) == 0
    assert cli.main(["data", "verify", str(store)]) == 0
    assert "sound" in capsys.readouterr().out


def test_a_flipped_bit_fails_verify_and_is_repaired(
    store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    import shutil

    copy = tmp_path / "copy.zarr"
    shutil.copytree(store, copy)
    chunk = sorted((copy / "counts").glob("c.1.*"))[0]
    content = bytearray(chunk.read_bytes())
    content[len(content) // 2] ^= 4
    chunk.write_bytes(content)
    assert cli.main(["data", "verify", str(copy)]) == 1
    assert "counts" in capsys.readouterr().out
    assert cli.main(["data", "repair", str(copy), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["dropped"] == [1]
    assert beambench.data_verify(copy) == []


def test_estimates_are_plain_hdf5(estimates: Path) -> None:
    with h5py.File(estimates / "peak.h5") as file:
        assert file["range"].shape == (2, 20, 24)
        assert file["valid"].dtype == bool and np.nanmin(file["range"][()]) > 1
        assert (file["cpu_s"][()] > 0).all() and [s.decode() for s in file["status"][()]] == ["ok", "ok"]


def test_scores_of_estimates(scores: Path) -> None:
    table = pd.read_csv(scores / "scores.csv")
    assert set(table["estimator"]) == {"peak", "weighted-average"}
    assert set(table["seed"]) == {1, 2}
    unmixed = table[table["quantity"] == "range"]
    assert (unmixed["status"] == "ok").all() and (unmixed["coverage"] > 0.99).all()
    # No unbiased estimator beats the bound; 3 standard errors of the rms of 480 errors are 10 %.
    assert (unmixed["rmse"] > 0.9 * unmixed["bound"]).all()


def test_estimates_of_another_program_are_scored(store: Path, tmp_path: Path) -> None:
    """A file with the three datasets is sufficient. It holds the truth, so that the error is zero."""
    from beambench.captures import open_captures

    truth = np.stack([capture["truth_range"].values for capture in open_captures(store)])
    with h5py.File(tmp_path / "oracle.h5", "w") as file:
        file["range"], file["sigma"], file["valid"] = truth, np.full(truth.shape, 1e-3), np.isfinite(truth)
    table = beambench.score(store, tmp_path / "oracle.h5", out=tmp_path / "scores")
    assert (table[table["quantity"] == "range"]["rmse_full"] == 0).all()


@pytest.mark.parametrize("fault", ["shape", "missing", "no file", "two of one name", "claims"])
def test_wrong_estimates_are_told(store: Path, tmp_path: Path, fault: str) -> None:
    def write(name: str, shape: tuple[int, ...], sigma: float = 1e-3) -> None:
        with h5py.File(tmp_path / name, "w") as file:
            file["valid"], file["sigma"] = np.ones(shape, bool), np.full(shape, sigma)
            file.attrs["estimator"] = "same"
            if fault != "missing":
                file["range"] = np.ones(shape)

    if fault != "no file":
        write("a.h5", (2, 20, 23) if fault == "shape" else (2, 20, 24), -1.0 if fault == "claims" else 1e-3)
    if fault == "two of one name":
        write("b.h5", (2, 20, 24))
    if fault == "claims":  # a negative sigma of a valid element makes the answer invalid, which is a row and no error
        table = beambench.score(store, tmp_path, out=tmp_path / "scores")
        assert table["status"].str.startswith("invalid").all() and (table["coverage"] == 0).all()
        return
    with pytest.raises(beambench.InputError):
        beambench.score(store, tmp_path, out=tmp_path / "scores")
    assert not (tmp_path / "scores").exists()


def test_compare_pairs_rows(scores: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = pd.read_csv(scores / "scores.csv")
    table.loc[table["estimator"] == "peak", "rmse_full"] *= 1.5
    table = table[~((table["estimator"] == "weighted-average") & (table["seed"] == 2))]
    table.to_csv(tmp_path / "scores.csv", index=False)
    changes = beambench.compare(scores, tmp_path)
    changes = changes[changes["quantity"] == "range"].set_index("estimator")
    assert changes.loc["peak", "error_ratio"] == pytest.approx(1.5, rel=1e-6)
    assert changes.loc["peak", "error_lo"] == pytest.approx(1.5, rel=1e-6) and changes.loc["peak", "pairs"] == 2
    assert changes.loc["weighted-average", "error_ratio"] == pytest.approx(1.0, rel=1e-12)
    assert np.isnan(changes.loc["weighted-average", "error_lo"]), "one seed has no interval"
    assert cli.main(["compare", str(scores), str(tmp_path)]) == 0
    assert "without a partner" in capsys.readouterr().out


def test_estimators_are_listed_with_sources() -> None:
    rows = beambench.estimators_list()
    assert {"peak", "parabola", "weighted-average", "poisson-ml"} <= {row["name"] for row in rows}
    assert all(row["cites"] and not row["error"] for row in rows if row["origin"] == "built-in")


def test_check_holds_a_good_one_and_tells_a_bad_one(capsys: pytest.CaptureFixture[str]) -> None:
    import xarray as xr

    from beambench.benchmarks.laws.check import check_laws, maker_of
    from beambench.benchmarks.laws.suite import laws_for

    assert beambench.estimators_check("weighted-average", compare=False).ok

    def bad(capture: xr.Dataset) -> xr.Dataset:
        shape = capture["counts"].shape[1:]
        values = np.random.default_rng().random(shape)
        dims = ("row", "col")
        return xr.Dataset({"range": (dims, values), "sigma": (dims, -values), "valid": (dims, np.ones(shape, bool))})

    broken = {result.law for result in check_laws(bad, "gated") if not result.holds}
    assert {"same answer twice", "shift: later delays, farther ranges", "finite or invalid: constant"} <= broken

    def crashing(capture: xr.Dataset) -> xr.Dataset:
        raise IndexError("out of range")

    results = check_laws(crashing, "gated")
    assert [result.law for result in results] == list(laws_for(maker_of("gated")))
    assert all("IndexError" in result.seen for result in results)
    assert cli.main(["estimators", "check", "weighted-average", "--no-compare"]) == 0


def test_a_new_estimator_works(tmp_path: Path) -> None:
    """The package that `new` writes keeps every law as it stands, and finds the range of the made-up stack."""
    import importlib.util

    from beambench.benchmarks.laws.check import check_laws
    from beambench.benchmarks.laws.gated import clean_capture

    folder = beambench.estimators_new("my-median", out=tmp_path / "mine")
    assert sorted(path.name for path in folder.iterdir()) == [
        "README.md", "beambench_my_median.py", "pyproject.toml", "test_beambench_my_median.py",
    ]  # fmt: skip
    spec = importlib.util.spec_from_file_location("mine", folder / "beambench_my_median.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert [result for result in check_laws(module.my_median, "gated") if not result.holds] == []
    mine, known = (
        module.my_median(clean_capture()),
        beambench.estimators.run_estimator("poisson-ml", clean_capture()),
    )
    # The echo is symmetric, so its median is its centre; clipped noise pulls by a part of the step, 22 mm.
    assert np.abs(mine["range"] - known["range"]).max() < 0.01


def test_outputs_are_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("years of work")
    with pytest.raises(beambench.InputError, match="exists"):
        claim(tmp_path / "mine", "x")
    for ours in (None, is_package):
        with pytest.raises(beambench.InputError, match="Beambench did not write"):
            claim(tmp_path / "mine", "x", overwrite=True, ours=ours)
    assert (tmp_path / "mine" / "thesis.tex").read_text() == "years of work"
    ours = beambench.estimators_new("my-median", out=tmp_path / "ours")
    (ours / "notes.txt").write_text("mine")
    assert beambench.estimators_new("my-median", out=ours, overwrite=True) == ours
    assert (ours / "notes.txt").read_text() == "mine", "nothing is removed"
    (ours / "pyproject.toml").write_text('[project]\nname = "thesis"\n')
    with pytest.raises(beambench.InputError, match="Beambench did not write"):
        beambench.estimators_new("my-median", out=ours, overwrite=True)


def test_default_output_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    first = default_out("my scene/../x")
    assert first.parent == Path("beambench-runs") and ".." not in first.name
    first.mkdir(parents=True)
    assert default_out("my scene/../x") != first
    assert slug("weighted-average[background=subtract]") == "weighted-average-background-subtract"


def test_an_unwritable_place_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("")
    assert cli.main(["estimators", "new", "my-median", "-o", str(tmp_path / "file" / "x")]) == 2
    assert "file" in capsys.readouterr().err


def test_doctor() -> None:
    findings = beambench.doctor()
    named = {(finding.group, finding.name): finding for finding in findings}
    assert {finding.state for finding in findings} <= {"ok", "missing", "warning", "broken"}
    assert named["packages", "numpy"].found == np.__version__
    assert all(
        finding.advice
        for finding in findings
        if finding.state == "broken" or (finding.group == "extras" and finding.state != "ok")
    )
    backend = named["rendering", "backend"]
    assert backend.state == "ok" and "mono" in backend.found and "libLLVM" in backend.found


def test_doctor_without_a_renderer(monkeypatch: pytest.MonkeyPatch) -> None:
    """Scoring works without Mitsuba, so its absence is a warning with the command that mends it."""
    from beambench.health import machine, packages, rendering

    real = packages.version_of

    def version_of(name: str) -> str | None:
        return None if name in {"mitsuba", "drjit", "pyvisa"} else real(name)

    for module in (machine, packages, rendering):
        monkeypatch.setattr(module, "version_of", version_of)
    findings = {finding.name: finding for finding in beambench.doctor()}
    assert findings["backend"].state == "warning" and "pip install" in findings["backend"].advice
    assert findings["drivers"].advice == "pip install 'beambench[drivers]'"
    assert not [finding for finding in findings.values() if finding.state == "broken"]


def test_doctor_survives_a_backend_that_aborts(monkeypatch: pytest.MonkeyPatch) -> None:
    """A wrong libLLVM kills the process that loads it: the trial's, not the doctor's."""
    from beambench.health import rendering

    monkeypatch.setattr(rendering, "_PROBE", "import os; os.abort()")
    assert rendering.renderer().state == "broken"


def test_scoring_needs_no_renderer(store: Path, estimates: Path, tmp_path: Path) -> None:
    code = (
        "import sys\nfor name in ('mitsuba', 'drjit'): sys.modules[name] = None\n"
        "import beambench\n"
        f"beambench.score({str(store)!r}, {str(estimates)!r}, out={str(tmp_path / 's')!r})\n"
        f"beambench.report({str(tmp_path / 's')!r})"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "s" / "report.html").is_file()
