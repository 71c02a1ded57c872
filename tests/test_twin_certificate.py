"""The certificate: verdicts on made-up evidence, a short version of the power check, and the command as typed."""

from __future__ import annotations

import csv
import json
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import beambench
from beambench import InputError, cli
from beambench.benchmarks.checks.twin import FAULTS, Bench, exact_interval, tried
from beambench.benchmarks.twin.certificate import Certificate
from beambench.benchmarks.twin.clause import Evidence
from beambench.benchmarks.twin.gated_clauses import CLAUSES
from beambench.benchmarks.twin.gated_curves import kendall
from beambench.benchmarks.twin.gated_rig import uncertain_of as gated_uncertain_of
from beambench.benchmarks.twin.page import certificate_page, interval_svg, sentence
from beambench.benchmarks.twin.run import twin_kind_of
from beambench.benchmarks.twin.uncertain import uncertain_of
from beambench.benchmarks.twin.verdict import ALPHA, judged, with_tolerances
from beambench.scenes.load import load_scene

GAIN = next(clause for clause in CLAUSES if clause.name == "gain")


def _evidence(real: float, spread: float, draws: int = 40) -> Evidence:
    twins = [{"gain": 1.0 + spread * z} for z in np.random.default_rng(1).standard_normal(draws)]
    return Evidence({"gain": real}, twins, {"gain": 0.001}, {}, {}, ())


@pytest.mark.parametrize(
    ("real", "spread", "verdict"),
    [
        (1.0, 0.001, "pass"),
        (1.03, 0.003, "fail"),
        (1.0, 0.02, "cannot tell"),
        (1.008, 0.0005, "pass"),
        (0.97, 0.003, "fail"),
    ],
)
def test_verdicts(real: float, spread: float, verdict: str) -> None:
    """A difference that is shown but tolerable passes; what is neither shown nor shown to be small cannot be told."""
    assert judged([GAIN], _evidence(real, spread))[0].verdict == verdict


def test_what_cannot_be_told_says_how_much_more_to_record() -> None:
    """Noise falls with the root of the frames: an interval of ten tolerances takes a hundred times as many, and never less than
    twice as many; dark clauses take frames without the laser."""
    dark = next(clause for clause in CLAUSES if clause.name == "dsnu")
    for clause, name in ((GAIN, "repeats"), (dark, "laser-off frames")):
        clause = replace(clause, relative=0.0, absolute=0.015)
        real = {clause.name: 1.0}
        for spread in (0.02, 0.2):
            twins = [{clause.name: 1.0 + spread * z} for z in np.random.default_rng(1).standard_normal(40)]
            one = judged([clause], Evidence(real, twins, {}, {}, {}, ()))[0]
            said = re.search(rf"at least (\d+) times as many {name}$", one.remark)
            assert one.verdict == "cannot tell" and said, one.remark
            asked = (max(one.high, -one.low) / 0.015) ** 2
            assert asked <= int(said[1]) <= 1.1 * asked + 1


def test_right_twins_fail_no_more_often_than_stated() -> None:
    """3000 certificates of ten independent clauses: the share with any failure is α at most, within four standard errors."""
    rng, clauses = (
        np.random.default_rng(2),
        [replace(GAIN, name=f"c{i}", absolute=1e-9, relative=0.0) for i in range(10)],
    )
    failed = 0
    for _ in range(3000):
        held = 1.0 + 0.01 * rng.standard_normal((17, 10))
        rows = [{f"c{i}": float(row[i]) for i in range(10)} for row in held]
        failed += any(one.verdict == "fail" for one in judged(clauses, Evidence(rows[0], rows[1:], {}, {}, {}, ())))
    assert failed / 3000 < ALPHA + 4 * np.sqrt(ALPHA / 3000)
    assert failed > 0


def test_tolerances_of_the_user_are_checked() -> None:
    assert with_tolerances([GAIN], {"gain": 0.5})[0].absolute == 0.5
    with pytest.raises(InputError, match="tolerance"):
        with_tolerances([GAIN], {"gian": 0.5})


def test_kendall_counts_pairs() -> None:
    a = np.array([1.0, 2.0, 3.0, 4.0])
    assert kendall(a, a) == 1.0
    assert kendall(a, -a) == -1.0
    assert kendall(a, np.array([1.0, 2.0, 4.0, 3.0])) == pytest.approx(4 / 6)


def test_the_page_escapes_names_and_loads_nothing() -> None:
    found = Certificate(tuple(judged(CLAUSES, _evidence(1.03, 0.003))), _evidence(1.03, 0.003), "m")
    page = certificate_page(found, "<script>x</script>", ["beambench", "twin", "<b>"])
    assert "<script" not in page
    assert "http" not in page.replace("http-equiv", "").replace("http://www.w3.org", "")
    assert "default-src 'none'" in page
    assert "does not agree" in page
    assert "nan" not in interval_svg(found.clauses[0])


def test_the_page_names_what_is_undecided_and_calls_an_agreement_no_difference() -> None:
    """The ranking stood under «rig − twin» as «1 … 1, > 0 tolerated», with a least error of 1."""
    ranking = next(clause for clause in CLAUSES if clause.name == "ranking")
    twins = [{"gain": 1.0 + 0.02 * z, "ranking": 1.0} for z in np.random.default_rng(1).standard_normal(40)]
    found = judged(
        [GAIN, ranking],
        Evidence({"gain": 1.0, "ranking": 1.0}, twins, {"ranking": 1.0}, {}, {}, (), intervals={"ranking": (1.0, 1.0)}),
    )
    certificate = Certificate(tuple(found), Evidence({}, twins, {}, {}, {}, ()), "m")
    page = certificate_page(certificate, "real.zarr", [])
    assert "noise is too great for the tolerance: Photon transfer." in page
    assert "agreement of the two: 1 … 1<br>it must be above 0" in page
    assert "> 0 tolerated" not in page
    assert '<td class="num" data-is="least error">–</td>' in page


@pytest.mark.parametrize(
    ("gain", "offset", "required", "verdict"),
    [
        (0.02, 0.001, (), "pass"),
        (0.02, 0.001, ("offset",), "pass"),
        (0.02, 0.001, ("offset", "gain"), "cannot tell"),
        (0.001, 0.001, ("offset", "gain"), "pass"),
        (0.001, math.nan, ("offset",), "cannot tell"),  # not measured
    ],
)
def test_what_is_required_must_be_decided(gain: float, offset: float, required: tuple[str, ...], verdict: str) -> None:
    normal = np.random.default_rng(1).standard_normal((40, 2))
    twins = [{"gain": 1.0 + gain * a, "offset": 1.0 + offset * b} for a, b in normal]
    evidence = Evidence({"gain": 1.0, "offset": 1.0}, twins, {}, {}, {}, ())
    clauses = [GAIN, replace(GAIN, name="offset", title="Offset: of the converter.")]
    found = Certificate(tuple(judged(clauses, evidence)), evidence, "m", required)
    assert found.verdict == verdict
    assert ("What was required could not be decided: " in sentence(found)) == (verdict == "cannot tell")


def test_arrows_of_wide_intervals_are_whole() -> None:
    """Their tips lay outside of the picture."""
    drawn = interval_svg(judged([GAIN], _evidence(1.0, 0.2))[0])
    starts = re.findall(r"M([\d.]+) 5 l(-?\d+) 5", drawn)
    assert len(starts) == 2
    assert all(1.0 <= float(x) + int(by) <= 149.0 for x, by in starts)


def test_a_modality_without_clauses_says_so() -> None:
    with pytest.raises(InputError, match="no clauses"):
        twin_kind_of("amcw")


@pytest.mark.parametrize("index", ["9", "x", "-1", "²"])
def test_an_uncertainty_of_no_element_of_a_list_is_refused(index: str) -> None:
    """It was an internal error, or another element's."""
    data = {"rig": {"laser": {"position_m": [0.2, 0.0, 0.02]}}}
    with pytest.raises(InputError, match="of no number"):
        uncertain_of(data, {f"rig.laser.position_m.{index}": 1e-3})


@pytest.mark.parametrize("path", ["rig.gates.9.step_s", "rig.gates.99999999999.step_s", "rig.laser.pulse.step_s.x"])
def test_a_gated_twin_refuses_an_uncertainty_of_no_element_too(path: str) -> None:
    with pytest.raises(InputError, match="of no number"):
        gated_uncertain_of(load_scene("flat-wall"), {path: 1e-12})


def test_exact_intervals() -> None:
    """Clopper and Pearson's interval of 0 in 10 ends at 1 − 0.025^(1/10)."""
    assert exact_interval(0, 10) == (0.0, pytest.approx(1 - 0.025**0.1))
    assert exact_interval(10, 10)[0] == pytest.approx(0.025**0.1)


def test_power_in_short() -> None:
    """One emulated rig: its right twin fails in nothing, and wrong ones fail the clause that names what is wrong.

    A gain of 3 % and the backscatter need the longer recordings and the more draws of `benchmarks.checks.twin`.
    """
    faults = tuple(name for name, (clause, _) in FAULTS.items() if clause in ("pulse", "t0", "read-noise"))
    outcome = tried(Bench(repeats=64, dark=128), 0, 8, faults)
    assert "fail" not in outcome.verdicts["right"].values()
    for name in faults:
        assert outcome.verdicts[name][FAULTS[name][0]] == "fail", name


SETTINGS = {
    "rig.camera.rows": 12, "rig.camera.cols": 12, "rig.camera.pixel_pitch_m": 70e-6, "rig.laser.pulse_energy_j": 6e-7,
    "rig.delays.start_s": 30.4e-9, "rig.delays.step_s": 0.25e-9, "rig.delays.count": 18, "rig.delays.repeats": 16,
    "rig.delays.laser_off": 16, "rig.laser.pulse.fwhm_s": 0.8e-9,
    "rig.gates": [{"kind": "trapezoidal", "width_s": 1.5e-9, "rise_s": 0.3e-9, "fall_s": 0.4e-9, "transmission": 1.0}],
}  # fmt: skip


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("twin") / "real.zarr"
    hidden: dict[str, Any] = SETTINGS | {
        "rig.t0_s": 30e-12, "rig.detector.gain_dn_per_e": 1.1, "declared": {"t0_s": 0.0, "detector.gain_dn_per_e": 1.0},
    }  # fmt: skip
    beambench.generate("flat-wall", overrides=hidden, out=place)
    return place


def test_calibrate_and_twin_as_typed(recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The rig that is calibrated has the hidden values, and its twin fails in nothing; one with another gain fails."""
    rig, out = tmp_path / "my-rig.toml", tmp_path / "certificate"
    assert cli.main(["calibrate", str(recording), "-o", str(rig)]) == 0
    assert "rig.detector.gain_dn_per_e" in capsys.readouterr().out
    common = ["twin", str(recording), "--rig", str(rig), "--draws", "16", "--estimator", "peak"]
    assert cli.main([*common, "-o", str(out)]) == 0
    rows = {row["clause"]: row for row in csv.DictReader((out / "clauses.csv").open())}
    assert rows["t0"]["verdict"] == "pass"
    assert abs(float(rows["gain"]["difference"])) < 0.15
    assert json.loads((out / "run.json").read_text())["verdict"] == "pass"
    assert "certificate" in (out / "certificate.html").read_text(encoding="utf-8")
    wrong = rig.read_text(encoding="utf-8").replace("gain_dn_per_e = 1.", "gain_dn_per_e = 2.", 1)
    rig.write_text(wrong, encoding="utf-8")
    assert cli.main([*common, "-o", str(tmp_path / "wrong"), "--json"]) == 1
    assert '"verdict": "fail"' in capsys.readouterr().out


def test_a_scene_beside_the_recording(recording: Path, tmp_path: Path) -> None:
    """With the scene the twin's geometry is traced, and the first half calibrates."""
    scene = beambench.scenes_show("flat-wall", overrides=SETTINGS)
    place = tmp_path / "wall.json"
    place.write_text(json.dumps(scene if isinstance(scene, dict) else scene.model_dump(mode="json")), encoding="utf-8")
    found = beambench.twin(recording, scene=place, draws=16, estimator=["peak"], out=tmp_path / "c").found
    held = {one.clause.name: one for one in found.clauses}
    assert held["t0"].verdict == "pass"
    assert "fail" not in {one.verdict for one in found.clauses}


def test_bad_input_is_told(recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["twin", str(recording), "--tolerance", "gain", "-o", str(tmp_path / "a")]) == 2
    assert "tolerance" in capsys.readouterr().err
    assert cli.main(["twin", str(recording), "--require", "gian", "-o", str(tmp_path / "a")]) == 2
    assert "gain" in capsys.readouterr().err
    assert not (tmp_path / "a").exists()
    assert cli.main(["twin", str(recording), "--index", "3", "-o", str(tmp_path / "b")]) == 2
    assert cli.main(["twin", str(recording), "--draws", "3", "-o", str(tmp_path / "c")]) == 2
    assert not (tmp_path / "c" / "certificate.html").exists()
