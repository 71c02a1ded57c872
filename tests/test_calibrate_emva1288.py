"""EMVA 1288 from generated series: the planted values come back, and the reference package finds the same."""

from __future__ import annotations

import importlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import beambench
from beambench import InputError, cli
from beambench.captures import make_capture, write
from beambench.captures.hide import hide_truth
from beambench.estimators.calibration.emva1288 import EMVA1288, emva_figures
from beambench.estimators.calibration.series import read_series
from beambench.generator.detector import detect, fixed_pattern
from beambench.scenes.declared import declared_rig
from beambench.scenes.load import load_scene
from beambench.scenes.rig_files import read_rig_file
from beambench.scenes.rigs.parts import Detector

SIDE, OPEN_S = 128, 1e-7
TRUE = {
    "gain_dn_per_e": 0.7, "offset_dn": 200.0, "read_noise_e": 5.0, "dark_current_e_per_s": 2000.0, "prnu": 0.01, "dsnu_e": 3.0,
    "full_well_e": 20000.0,
}  # fmt: skip
DETECTOR = Detector(adc_bits=14, exposure_s=1e-3, fixed_pattern_seed=1, **TRUE)


def capture(light_e: float, exposure_s: float, frames: int, key: int, **changes: Any) -> Any:
    """Frames of even light without the laser, by the generator's detector. `changes`: of the declared rig."""
    detector = DETECTOR.model_copy(update={"exposure_s": exposure_s})
    expected = np.full((frames, SIDE, SIDE), light_e, np.float32)
    counts = detect(expected, detector, fixed_pattern(detector, SIDE, SIDE), 1, key)
    rig = declared_rig(load_scene("flat-wall")) | {"ambient_e_per_s": light_e / OPEN_S}
    rig["detector"] |= {"exposure_s": exposure_s, "adc_bits": 14} | changes
    coords = {
        "delay": np.zeros(frames), "gate": np.zeros(frames, np.int32), "laser_on": False, "time": np.zeros(frames),
        "valid": True,
    }  # fmt: skip
    return make_capture("gated", {"counts": counts}, coords, {}, {"rig": rig, "truth_kind": "none"})


LIGHTS = [0.0, *(1000.0 * k for k in range(1, 25))]


def series(frames: int) -> list[Any]:
    dark = [(0.0, time) for time in (0.05, 0.1, 0.2)]
    settings = [*((light, 1e-3) for light in LIGHTS), *dark]
    return [capture(*one, frames, key) for key, one in enumerate(settings)]


@pytest.fixture(scope="module")
def many() -> list[Any]:
    return [hide_truth(one) for one in series(16)]


def test_planted_values_come_back(many: list[Any]) -> None:
    """Gain and noise within 1 %, non-uniformities within 3 %, and each within five of its standard errors.

    The realised spread of 16384 pixels differs from the planted one by 1/√(2·16384) = .6 %.
    """
    found = {one.path.removeprefix("rig.detector."): one for one in EMVA1288.run(many).figures if one.path}
    assert set(found) == set(TRUE)
    limits = {"prnu": 0.03, "dsnu_e": 0.03, "dark_current_e_per_s": 0.02}
    for name, value in TRUE.items():
        figure = found[name]
        assert figure.value == pytest.approx(value, rel=limits.get(name, 0.01)), name
        spread = value / np.sqrt(2 * SIDE**2) if name in ("prnu", "dsnu_e") else 0.0
        assert abs(figure.value - value) < 5.0 * np.hypot(figure.sigma, spread), name
        assert 0 < figure.sigma < 0.02 * value


def test_the_reference_package_finds_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """emva1288 on pairs of frames, as the standard takes them. It needs `np.asfarray`, which NumPy 2 does not have."""
    monkeypatch.setattr(np, "asfarray", lambda values: np.asarray(values, np.float64), raising=False)
    for name in ("lxml", "emva1288"):
        pytest.importorskip(name, reason="the reference package emva1288 is not installed")
    data = importlib.import_module("emva1288.process.data")
    results = importlib.import_module("emva1288.process.results")
    routines = importlib.import_module("emva1288.process.routines")
    pairs = [hide_truth(capture(light, 1e-3, 2, key)) for key, light in enumerate(LIGHTS)]
    ours = emva_figures(read_series(pairs))
    # The package takes the main exposure's levels; half of saturation is the spatial pair.
    sums = {light: routines.get_int_imgs(list(one["counts"].values)) for light, one in zip(LIGHTS, pairs, strict=True)}
    temporal = {
        light: {"sum": one["sum"].sum(), "pvar": one["pvar"].sum(), "dmean": one["dmean"]}
        for light, one in sums.items()
    }
    first = data.Data1288(
        {"width": SIDE, "height": SIDE, "temporal": {1e6: temporal}, "spatial": {1e6: {0.0: sums[0.0], 1e3: sums[1e3]}}}
    )
    at = results.Results1288(first.data).index_u_ysat
    mean = np.array([one["sum"].mean() / 2 for one in sums.values()]) - sums[0.0]["sum"].mean() / 2
    half = LIGHTS[int(np.argmin(np.abs(mean - 0.5 * mean[at + 1])))]
    judged = results.Results1288(
        data.Data1288(
            {
                "width": SIDE,
                "height": SIDE,
                "temporal": {1e6: temporal},
                "spatial": {1e6: {0.0: sums[0.0], half: sums[half]}},
            }
        ).data
    )
    assert ours.gain_dn_per_e == pytest.approx(judged.K, rel=1e-5)
    assert ours.dark_noise_e == pytest.approx(judged.sigma_d, rel=1e-5)
    # The package leaves what the frames have in common in the variance that it takes off here, 1e-5 of it.
    assert ours.dsnu_e == pytest.approx(judged.DSNU1288, rel=1e-4)
    assert ours.prnu == pytest.approx(judged.PRNU1288 / 100, rel=1e-4)
    assert ours.saturation_e == pytest.approx(judged.u_e_sat, rel=1e-5)
    assert ours.linearity_low == pytest.approx(judged.LE_min / 100, abs=1e-7)
    assert ours.linearity_high == pytest.approx(judged.LE_max / 100, abs=1e-7)


def test_a_planted_bend_is_a_linearity_error(many: list[Any]) -> None:
    """y + 2e-6 y²: 1.3 % of bend over 13000 DN; the rest without it is a tenth of that."""
    bent = []
    for one in many[:25]:
        values = one["counts"].values.astype(float)
        changed = np.round(values + 2e-6 * (values - 200.0) ** 2).astype(np.uint16)
        bent.append(one.assign(counts=one["counts"].copy(data=changed)))
    straight, curved = emva_figures(read_series(many[:25])), emva_figures(read_series(bent))
    assert max(-straight.linearity_low, straight.linearity_high) < 1e-3
    assert curved.linearity_high - curved.linearity_low > 4e-3


def test_the_verb_writes_a_rig_file_that_a_scene_takes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    store, rig = tmp_path / "series.zarr", tmp_path / "my-rig.toml"
    write(store, series(4))
    assert cli.main(["calibrate", str(store), "-o", str(rig), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert {one["name"] for one in told["found"]["emva1288"]} >= {"gain K", "PRNU", "DSNU", "full well"}
    file = read_rig_file(rig, "gated")
    assert file.rig["detector"]["gain_dn_per_e"] == pytest.approx(0.7, rel=0.01)
    assert 0 < file.uncertainty["rig.detector.gain_dn_per_e"] < 0.01
    assert file.calibration[0]["procedure"] == "emva1288"
    scene = load_scene("flat-wall", file.overrides())
    assert scene.rig.detector.prnu == file.rig["detector"]["prnu"]  # type: ignore[attr-defined]
    assert scene.rig.detector.adc_bits == 16  # type: ignore[attr-defined]  # what the file lacks stays
    assert cli.main(["generate", "flat-wall", "--rig", str(rig), "--plan"]) == 0
    capsys.readouterr()
    assert cli.main(["generate", "spotscan-wall", "--rig", str(rig), "--plan"]) == 2
    assert "another kind of rig" in capsys.readouterr().err
    assert cli.main(["calibrate", str(store), "-o", str(rig)]) == 2
    assert "exists" in capsys.readouterr().err
    again = beambench.calibrate([store], rig=rig, out=tmp_path / "second.toml")
    assert [one["procedure"] for one in again.rig.calibration] == ["emva1288", "emva1288"]


def test_captures_that_cannot_be_used_are_refused(tmp_path: Path) -> None:
    lit = tmp_path / "lit.zarr"
    write(lit, [capture(1000.0 * (k + 1), 1e-3, 2, k) for k in range(4)])
    with pytest.raises(InputError, match="dark frames"):
        beambench.calibrate([lit])
    few = tmp_path / "few.zarr"
    write(few, [capture(light, 1e-3, 2, k) for k, light in enumerate((0.0, 1000.0, 2000.0))])
    with pytest.raises(InputError, match="4 levels of light"):
        beambench.calibrate([few], procedures=["emva1288"])
    with pytest.raises(InputError, match="no such procedure"):
        beambench.calibrate([few], procedures=["emva"])
    tube = {"gain": 100.0, "excess_noise_factor": 1.4, "phosphor_sigma_px": 0.0}
    with pytest.raises(InputError, match="tube adds noise"):
        EMVA1288.run([hide_truth(capture(1000.0, 1e-3, 2, 0, intensifier=tube))])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("schema_version = 1\nkind = 'gated'\nrig = {}\n", "rig"),
        ("schema_version = 1\nkind = 'sonar'\n[rig]\nt0_s = 0.0\n", "another kind"),
        ("schema_version = 1\nkind = 'gated'\n[rig]\nt0_s = 0.0\n[uncertainty]\nx = -1.0\n", "uncertainty"),
        ("kind = [\n", "not well formed"),
    ],
)
def test_a_wrong_rig_file_is_refused(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=said):
        read_rig_file(path)
