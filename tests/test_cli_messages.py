"""What a wrong file or option is told in: plain words, the right unit, the right next step."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

import beambench
from beambench.cli import main
from beambench.estimators.labels import each_label
from beambench.scenes import errors
from beambench.scenes.load import load_scene
from beambench.scenes.overrides import apply_overrides
from beambench.scenes.scene import Scene
from beambench.scenes.validate import validate_spec

#: Words of the validating library that no user should read.
FOREIGN = re.compile(
    r"Input should|Field required|Extra inputs|not permitted|\[Errno|Value error|discriminator|union_tag"
)


def plain(name: str = "flat-wall") -> dict[str, Any]:
    return load_scene(name).model_dump(mode="json")


def told(data: dict[str, Any]) -> str:
    with pytest.raises(beambench.InputError) as error:
        validate_spec(Scene, data, "a.toml")
    assert not FOREIGN.search(str(error.value)), str(error.value)
    return str(error.value)


@pytest.mark.parametrize(
    ("path", "value", "wanted"),
    [
        ("rig.laser.wavelength_m", 532, r"below 2e-05\. Lengths are in metres: 532 nm is 532e-9"),
        ("rig.laser.wavelength_m", 0.532, r"Lengths are in metres: 0\.532 um is 0\.532e-6"),
        ("rig.laser.pulse.fwhm_s", 7, r"Times are in seconds: 7 ns is 7e-9"),
        ("rig.laser.illumination.half_angle_rad", 30, r"Angles are in radians: 30 deg is 0\.523599"),
        ("rig.camera.rows", 2.5, "a whole number"),
        ("rig.camera.rows", "64", "a whole number"),
        ("rig.camera.vignetting", "cos3", "'none', 'cos4'"),
        ("rig.laser.position_m", [0.0, 0.0], "must be given|at least 3 values"),
        ("rig.gates", [], "at least 1 values; there are 0"),
        ("rig.laser.pulse", {"kind": "square"}, "one of the kinds"),
        ("name", "a b", "text of the form"),
        ("rig.camera", 3, "a table"),
    ],
)
def test_a_wrong_value_is_told_in_plain_words_with_its_unit(path: str, value: Any, wanted: str) -> None:
    message = told(apply_overrides(plain(), {path: value}))
    assert re.search(wanted, message), message
    assert path in message


def test_a_key_in_another_unit_names_the_right_one() -> None:
    data = plain()
    data["rig"]["laser"]["wavelength_nm"] = data["rig"]["laser"].pop("wavelength_m") * 1e9
    message = told(data)
    assert "write wavelength_m. Lengths are in metres (1 nm is 1e-09)" in message
    data = plain()
    data["rig"]["laser"]["pulse"] = {"kind": "gaussian", "fwhm_ns": 7.0}
    assert "write fwhm_s. Times are in seconds (1 ns is 1e-09)" in told(data)


def test_a_lost_header_is_one_message_that_names_it(tmp_path: Path) -> None:
    text = (Path(beambench.scenes.__file__).parent / "library" / "flat-wall.toml").read_text(encoding="utf-8")
    assert text.count("[rig.detector]\n") == 1
    path = tmp_path / "lost.toml"
    path.write_text(text.replace("[rig.detector]\n", ""), encoding="utf-8")
    with pytest.raises(beambench.InputError) as error:
        load_scene(path)
    message = str(error.value)
    assert "A table is missing; its keys stand elsewhere." in message
    assert f"{path}: rig.detector" in message
    assert "[rig.detector] above" in message
    assert "full_well_e" in message
    assert "also" not in message


def test_a_file_with_a_byte_order_mark_and_foreign_line_ends_is_read(tmp_path: Path) -> None:
    text = (Path(beambench.scenes.__file__).parent / "library" / "flat-wall.toml").read_text(encoding="utf-8")
    path = tmp_path / "windows.toml"
    path.write_bytes(b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode())
    assert load_scene(path) == load_scene("flat-wall")


@pytest.mark.parametrize(
    ("typed", "wanted"),
    [
        (["scenes", "show", "flat-wal.toml"], "There is no such file."),
        (["scenes", "show", "near.tml"], "did you mean near.toml"),
        (["run", "flat-wall"], "next:    beambench generate flat-wall"),
        (["run", "gated-1k"], "This is a data set, not a suite."),
        (["run", "near.toml"], "This is a scene, not a suite."),
        (["run", "many.toml"], "This is a data set, not a suite."),
        (["generate", "flat-wall", "--rtol", "5p"], '"5p" is not a fraction: 0.05, 5%, noise'),
        (["scenes", "new", "mine", "--like", "flat-wal"], "did you mean flat-wall"),
        (["suites", "new", "a/b"], "letters, digits"),
    ],
)
def test_a_wrong_command_line_says_what_to_type(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], typed: list[str], wanted: str
) -> None:
    monkeypatch.chdir(tmp_path)
    beambench.scenes_new("near", like="step")
    Path("many.toml").write_text('schema_version = 1\ndataset = "many"\ncaptures = 2\nseed = 1\n', encoding="utf-8")
    assert main(typed) == 2
    message = capsys.readouterr().err
    assert wanted in message, message
    assert not FOREIGN.search(message)


def test_a_percentage_is_a_fraction(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["generate", "flat-wall", "--rtol", "5%", "--plan"]) == 0
    assert main(["generate", "flat-wall", "--rtol", "500%", "--plan"]) == 2  # five times everything
    assert "5.0" in capsys.readouterr().err


def test_labels_may_be_joined_by_commas() -> None:
    assert each_label(["a,b[x=1,y=2]", "c+d"]) == ["a", "b[x=1,y=2]", "c+d"]


def test_new_files_are_valid_and_keep_their_comments(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    scene = beambench.scenes_new("my-tank", like="relief-tank")
    assert scene.read_text(encoding="utf-8").count("#") > 3
    found = load_scene(scene)
    assert found.name == "my-tank"
    assert found.model_dump()["rig"] == load_scene("relief-tank").model_dump()["rig"]
    suite = beambench.suites_new("mine", like="waveform")
    shown = beambench.suites_show(suite)
    assert (shown["suite"]["suite"], shown["suite"]["version"]) == ("mine", 1)
    assert shown["captures"] == 200
    assert "# " in shown["text"]
    with pytest.raises(beambench.InputError, match="exists"):
        beambench.suites_new("mine")
    assert {row["name"] for row in beambench.suites_list()} >= {"quickstart", "gated", "full"}


def test_the_reason_of_a_system_error_is_its_words() -> None:
    assert errors.reason(FileNotFoundError(2, "No such file or directory", "x")) == "No such file or directory"
    assert errors.reason(ValueError()) == "ValueError"
