"""Measured pulses and gates in text files: what they become, what is told, and what is refused."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beambench import InputError
from beambench.generator.generate import generate
from beambench.scenes.declared import declared_rig
from beambench.scenes.load import load_scene
from beambench.scenes.measured import MeasuredNote
from beambench.scenes.rig_files import read_rig_file
from beambench.scenes.spec_files import LIBRARY
from beambench.scenes.waveforms import SampledGate, SampledPulse

TIME = np.arange(-3.0, 9.0, 0.05)


def pulse_values(noise: float = 0.0, baseline: float = 0.0) -> Any:
    """A Gaussian of σ = .4 ns at t = 0, of height 2."""
    rng = np.random.default_rng(1)
    return baseline + 2.0 * np.exp(-0.5 * (TIME / 0.4) ** 2) + rng.normal(0.0, 1.0, TIME.size) * noise


def write(file: Path, time: Any, value: Any, head: str = "", mark: str = ",", comma: bool = False) -> Path:
    lines = [f"{t:.9g}{mark}{v:.9g}" for t, v in zip(time, value, strict=True)]
    file.write_text(head + "\n".join(line.replace(".", ",") if comma else line for line in lines) + "\n")
    return file


def pulse_of(file: Path, **more: Any) -> SampledPulse:
    changes = {"rig.laser.pulse": {"kind": "measured", "file": str(file), "time_unit": "ns"} | more}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeasuredNote)
        found = load_scene("flat-wall", changes).rig.laser.pulse  # type: ignore[attr-defined]
    assert isinstance(found, SampledPulse)
    return found


def gate_of(file: Path, **more: Any) -> SampledGate:
    changes = {
        "rig.gates": [{"kind": "measured", "file": str(file), "time_unit": "ns", "transmission": 0.9} | more],
        "rig.pulses_per_slice": 10,
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeasuredNote)
        found = load_scene("flat-wall", changes).rig.gates[0]  # type: ignore[attr-defined]
    assert isinstance(found, SampledGate)
    return found


def moments(pulse: SampledPulse) -> tuple[float, float]:
    """Area of a curve of height 1 [ns], and standard deviation [ns]."""
    value, t = np.asarray(pulse.value), np.arange(len(pulse.value)) * pulse.step_s * 1e9
    mean = (t * value).sum() / value.sum()
    return float(value.sum() * pulse.step_s * 1e9), float(np.sqrt(((t - mean) ** 2 * value).sum() / value.sum()))


def test_a_clean_curve_keeps_its_shape(tmp_path: Path) -> None:
    """A Gaussian: area σ√(2π) of a curve of height 1, width σ; what is cut off below 0.1 % lies beyond 3.7 σ, which holds 2e-4 of
    the area and .4 % of the variance."""
    area, sigma = moments(pulse_of(write(tmp_path / "p.csv", TIME, pulse_values())))
    assert area == pytest.approx(0.4 * np.sqrt(2.0 * np.pi), rel=1e-3)
    assert sigma == pytest.approx(0.4, rel=3e-3)


def test_baseline_and_noise_are_taken_off_and_told(tmp_path: Path) -> None:
    """A baseline of a tenth and noise of 1 % of the height: the width is that of the pulse within 5 %, where with the baseline it
    would be that of the record, 2.6 ns or so."""
    file = write(tmp_path / "p.csv", TIME, pulse_values(noise=0.02, baseline=0.2))
    with pytest.warns(MeasuredNote) as told:
        load_scene("flat-wall", {"rig.laser.pulse": {"kind": "measured", "file": str(file), "time_unit": "ns"}})
    text = str(told[0].message)
    for part in ("flat-wall: rig.laser.pulse: p.csv, 240 samples", "baseline 0.2", "kept", "zero outside"):
        assert part in text, text
    found = pulse_of(file)
    assert min(found.value) == 0.0 == found.value[0] == found.value[-1]
    assert moments(found)[1] == pytest.approx(0.4, rel=0.05)


@pytest.mark.parametrize(
    ("head", "mark", "comma"),
    [
        ("", ",", False),
        ("", " ", False),
        ("# time, volts\n", ",", False),
        ("Model;MSO\n\nt [ns];volts\n", ";", True),
        ("\ufefft\tvolts\n", "\t", True),
    ],
)
def test_files_as_instruments_and_spreadsheets_write_them(tmp_path: Path, head: str, mark: str, comma: bool) -> None:
    plain = pulse_of(write(tmp_path / "plain.csv", TIME, pulse_values()))
    other = write(tmp_path / "other.csv", TIME, pulse_values(), head, mark, comma)
    assert pulse_of(other) == plain
    if "volts" in head:
        assert pulse_of(other, value_column="volts") == plain


def test_units_columns_uneven_steps_and_downward_light(tmp_path: Path) -> None:
    plain = pulse_of(write(tmp_path / "plain.csv", TIME, pulse_values()))
    assert pulse_of(write(tmp_path / "ps.csv", TIME * 1e3, pulse_values()), time_unit="ps").step_s == pytest.approx(
        plain.step_s
    )
    swapped = write(tmp_path / "swapped.csv", pulse_values(), TIME)
    assert pulse_of(swapped, time_column=2, value_column=1).value == pytest.approx(plain.value, abs=2e-6)
    down = write(tmp_path / "down.csv", TIME, -pulse_values())
    assert pulse_of(down, inverted=True).value == pytest.approx(plain.value, abs=2e-6)
    with pytest.raises(InputError, match="inverted = true"):
        pulse_of(down)
    uneven = np.sort(np.random.default_rng(2).uniform(-3.0, 9.0, 2000))
    file = write(tmp_path / "uneven.csv", uneven, 2.0 * np.exp(-0.5 * (uneven / 0.4) ** 2))
    assert moments(pulse_of(file))[1] == pytest.approx(0.4, rel=0.01)


def test_a_gate_has_its_level_and_its_zero(tmp_path: Path) -> None:
    """Edges of .4 ns, open for 2 ns between half heights, in volts: the level becomes the transmission, and time zero is at half of
    the opening edge, to the .02 ns that noise of 1 % moves it on a slope of 1/.4 ns and five times over."""
    t = np.arange(5.0, 15.0, 0.02)
    volts = 0.3 + 4.0 * np.clip(np.minimum(t - 8.0, 10.4 - t) / 0.4, 0.0, 1.0)
    found = gate_of(write(tmp_path / "g.csv", t, volts + np.random.default_rng(3).normal(0.0, 0.02, t.size)))
    value = np.asarray(found.value)
    time = found.start_s + np.arange(value.size) * found.step_s
    assert np.median(value[value > 0.5]) == pytest.approx(0.9, rel=0.01)
    assert np.interp(0.0, time[:60], value[:60]) == pytest.approx(0.45, abs=0.05)
    assert value.sum() * found.step_s * 1e9 == pytest.approx(0.9 * 2.0, rel=0.03)
    whole = gate_of(tmp_path / "g.csv", transmission=1.0)
    assert max(whole.value) == 1.0


def test_noise_above_one_is_told(tmp_path: Path) -> None:
    t = np.arange(0.0, 10.0, 0.05)
    file = write(tmp_path / "g.csv", t, ((t > 3) & (t < 5)) + np.random.default_rng(3).normal(0.0, 0.02, t.size))
    gate = {"kind": "measured", "file": str(file), "time_unit": "ns", "transmission": 1.0}
    with pytest.warns(MeasuredNote, match=r"samples above 1, up to 1\.0\d+, set to 1"):
        load_scene("flat-wall", {"rig.gates": [gate]})


@pytest.mark.parametrize(
    ("text", "more", "said", "where"),
    [
        ("1,2\n" * 9, {}, "should increase", "rig.laser.pulse.file"),
        ("1,2\n2,3\n", {}, "too few numbers", "rig.laser.pulse.file"),
        ("t,v\n" + "".join(f"{i},x\n" for i in range(9)), {}, "not numbers", "rig.laser.pulse.file"),
        ("".join(f"{i},{i}\n" for i in range(30)), {}, "baseline is unclear", "rig.laser.pulse.baseline"),
        ("".join(f"{i},5\n" for i in range(30)), {}, "no light", "rig.laser.pulse"),
        ("".join(f"{i},{int(i == 9)}\n" for i in range(30)), {"value_column": 3}, "no such column", "rig.laser.pulse.file"),
        ("".join(f"{i},{int(i == 9)}\n" for i in range(30)), {"value_column": "v"}, "no such column", "rig.laser.pulse.file"),
        ("".join(f"{i},{int(i == 9)}\n" for i in range(30)), {"keep": [40, 50]}, "too few samples", "rig.laser.pulse.keep"),
        ("\0" * 40, {}, "too few numbers", "rig.laser.pulse.file"),
    ],
)  # fmt: skip
def test_what_cannot_be_used_is_refused(tmp_path: Path, text: str, more: dict[str, Any], said: str, where: str) -> None:
    file = tmp_path / "p.csv"
    file.write_text(text)
    with pytest.raises(InputError, match=said) as error:
        pulse_of(file, **more)
    assert error.value.where == f"flat-wall: {where}"


def test_a_given_baseline_and_stretch_are_used(tmp_path: Path) -> None:
    """A record that begins within the light has no baseline of its own at both ends."""
    late = TIME > -0.2
    file = write(tmp_path / "p.csv", TIME[late], pulse_values(baseline=0.5)[late])
    with pytest.raises(InputError, match="baseline is unclear"):
        pulse_of(file)
    level, window = pulse_of(file, baseline=0.5), pulse_of(file, baseline=[4.0, 9.0])
    assert level.value == pytest.approx(window.value, abs=1e-5)
    kept = pulse_of(file, baseline=0.5, keep=[-0.2, 1.0])
    assert (len(kept.value) - 3) * kept.step_s == pytest.approx(1.2e-9, rel=0.05)


def scene_file(folder: Path, pulse: str) -> Path:
    text = (LIBRARY / "flat-wall.toml").read_text(encoding="utf-8")
    line = 'pulse = { kind = "gaussian", fwhm_s = 1.0e-9 }'
    assert line in text
    file = folder / "scene.toml"
    file.write_text(text.replace(line, f"pulse = {pulse}"), encoding="utf-8")
    return file


@pytest.mark.filterwarnings("ignore::beambench.scenes.measured.MeasuredNote")
def test_a_scene_file_finds_its_curve_beside_it_and_nowhere_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "here"
    folder.mkdir()
    write(folder / "p.csv", TIME, pulse_values())
    write(tmp_path / "outside.csv", TIME, pulse_values())
    monkeypatch.chdir(tmp_path)
    rig: Any = load_scene(scene_file(folder, '{ kind = "measured", file = "p.csv", time_unit = "ns" }')).rig
    assert isinstance(rig.laser.pulse, SampledPulse)
    for name in ("../outside.csv", str(tmp_path / "outside.csv")):
        file = scene_file(folder, f'{{ kind = "measured", file = "{name}", time_unit = "ns" }}')
        with pytest.raises(InputError, match="should lie in its folder") as error:
            load_scene(file)
        assert error.value.where == "rig.laser.pulse.file"
    own = {"rig.laser.pulse.file": "outside.csv"}
    assert isinstance(load_scene(file, own).rig.laser.pulse, SampledPulse)  # type: ignore[attr-defined]


@pytest.mark.filterwarnings("ignore::beambench.scenes.measured.MeasuredNote")
def test_declared_pulses_and_rig_files_may_be_measured(tmp_path: Path) -> None:
    file = write(tmp_path / "p.csv", TIME, pulse_values())
    curve = {"kind": "measured", "file": str(file), "time_unit": "ns"}
    declared = declared_rig(load_scene("flat-wall", {"declared": {"laser.pulse": curve}}))
    assert declared["pulse"]["value"] != declared_rig(load_scene("flat-wall"))["pulse"]["value"]
    rig = tmp_path / "rig.toml"
    rig.write_text(
        'schema_version = 1\nkind = "gated"\n[rig.laser]\npulse = { kind = "measured", file = "p.csv", time_unit = "ns" }\n'
    )
    scene: Any = load_scene("flat-wall", read_rig_file(rig).overrides())
    assert isinstance(scene.rig.laser.pulse, SampledPulse)


@pytest.mark.filterwarnings("ignore::beambench.scenes.measured.MeasuredNote")
def test_a_capture_holds_the_samples_and_needs_no_file(tmp_path: Path) -> None:
    file = write(tmp_path / "p.csv", TIME, pulse_values(noise=0.01))
    small = {"rig.camera.rows": 4, "rig.camera.cols": 4}
    scene = load_scene(
        "flat-wall", small | {"rig.laser.pulse": {"kind": "measured", "file": str(file), "time_unit": "ns"}}
    )
    capture = generate(scene, seed=1)
    file.unlink()
    again = generate(load_scene(scene.model_dump(mode="json")), seed=1)
    assert np.array_equal(capture["counts"].values, again["counts"].values)
    assert "p.csv" not in capture.attrs["truth_scene"]
