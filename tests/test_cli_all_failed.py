"""`run` and `estimate` exit with 1 where no estimator gave a result, and say why; with 0 where one did."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import beambench
from beambench import cli
from beambench.benchmarks.scores.tables import read_scores

SUITE = """schema_version = 1
suite = "all-failed"
scenes = ["wave"]
fidelity = "geometric"
estimators = [{names}]
[variants.wave]
scene = "gated-turbulence"
[variants.wave.overrides]
"rig.propagation" = "phase-screens"
"rig.turbulence" = {{ kind = "none" }}
"rig.frames.count" = 1
"rig.lenslets.across" = 3
"rig.pupil.diameter_m" = 4.5e-4
"rig.camera.rows" = 48
"rig.camera.cols" = 48
[seeds]
dev = [1]
test = [101]
"""
FEW = "spot-ml+slope-cell+zernike-ls"


def run(folder: Path, *names: str) -> int:
    suite = folder / "suite.toml"
    suite.write_text(SUITE.format(names=", ".join(f'"{name}"' for name in names)))
    return cli.main(["run", str(suite), "--no-report", "-o", str(folder / "run")])


@pytest.mark.parametrize(
    ("names", "reason"),
    [
        ((FEW,), "There are fewer slopes than modes"),
        (("poisson-ml",), "reads gated captures"),
        ((FEW, "peak"), "fewer slopes"),
    ],
)
def test_a_run_without_any_result_exits_with_one(
    names: tuple[str, ...], reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(tmp_path, *names) == 1
    assert reason in capsys.readouterr().out
    assert not (read_scores(tmp_path / "run")["status"] == "ok").any()


def test_a_run_with_one_result_exits_with_zero(tmp_path: Path) -> None:
    assert run(tmp_path, "spot-centroid", FEW, "poisson-ml") == 0


def test_estimates_of_which_none_succeeded_exit_with_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    changes = {
        "rig.propagation": "phase-screens", "rig.turbulence": {"kind": "none"}, "rig.frames.count": 1, "rig.lenslets.across": 3,
        "rig.pupil.diameter_m": 4.5e-4, "rig.camera.rows": 48, "rig.camera.cols": 48,
    }  # fmt: skip
    store, out = tmp_path / "store.zarr", tmp_path / "out"
    beambench.generate("gated-turbulence", overrides=changes, fidelity="geometric", out=store)

    def estimate(*names: str) -> int:
        labels = [part for name in names for part in ("-e", name)]
        return cli.main(["estimate", str(store), *labels, "-o", str(out), "--overwrite"])

    assert estimate(FEW) == 1
    told = capsys.readouterr().out
    assert f"failed    {FEW}, 1 of 1 captures" in told and "fewer slopes than modes" in told
    assert estimate(FEW, "spot-centroid") == 0
    asked = json.loads((out / "estimates.json").read_text())["asked"]
    assert {name: one["answered"] for name, one in asked.items()} == {FEW: 0, "spot-centroid": 1}
    # What an earlier call answered does not count for the estimators that this one was asked for.
    assert cli.main(["estimate", str(store), "-e", FEW, "-o", str(out), "--resume"]) == 1
    assert cli.main(["estimate", str(store), "-e", "spot-centroid", "-o", str(out), "--resume"]) == 0
    assert beambench.estimate(store, [FEW], out=out, overwrite=True) == out, "in Python a failure is a status"
