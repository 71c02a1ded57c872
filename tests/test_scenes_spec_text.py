"""Text of specs: what is not data is refused, by its key and with its reason; what is harmless is read."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from beambench.cli import main
from beambench.estimators.labels import parse_label
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene
from beambench.scenes.overrides import parse_assignments
from beambench.scenes.spec_files import LIBRARY

WALL = (LIBRARY / "flat-wall.toml").read_text()


def scene_of(folder: Path, name: str, text: str) -> object:
    (folder / name).write_text(text, encoding="utf-8")
    return load_scene(folder / name)


def refusal(folder: Path, name: str, text: str) -> str:
    with pytest.raises(InputError) as caught:
        scene_of(folder, name, text)
    return str(caught.value)


def test_a_byte_order_mark_and_a_suffix_in_capitals_are_read(tmp_path: Path) -> None:
    plain = load_scene("flat-wall")
    data = plain.model_dump_json()
    for name, text in {
        "a.toml": "\ufeff" + WALL, "b.json": "\ufeff" + data, "C.TOML": WALL, "D.JSON": data, "E.Toml": WALL
    }.items():  # fmt: skip
        assert scene_of(tmp_path, name, text) == plain


@pytest.mark.parametrize("depth", ["top", "rig", "list"])
def test_a_json_key_given_twice_is_refused(tmp_path: Path, depth: str) -> None:
    """The last value held, without a word; TOML refuses it."""
    data = load_scene("flat-wall").model_dump_json()
    text = {
        "top": data[:-1] + ', "name": "other"}',
        "rig": data.replace('"pulses_per_slice":100', '"pulses_per_slice":1,"pulses_per_slice":100'),
        "list": data.replace('"albedo":', '"albedo":0.1,"albedo":'),
    }[depth]
    assert text != data
    assert "given twice" in refusal(tmp_path, "a.json", text)


def test_a_key_given_twice_in_an_override_is_refused() -> None:
    with pytest.raises(InputError, match="twice"):
        parse_assignments(['target.0.material={"kind": "lambert", "albedo": 0.1, "albedo": 0.2}'])


@pytest.mark.parametrize(
    ("line", "key", "says"),
    [
        ("ambient_e_per_s = inf", "rig.ambient_e_per_s", "finite"),
        ("ambient_e_per_s = nan", "rig.ambient_e_per_s", "finite"),
        ("ambient_e_per_s = 2026-11-28", "rig.ambient_e_per_s", "date"),
        ("ambient_e_per_s = 07:30:00", "rig.ambient_e_per_s", "time"),
        ("ambient_e_per_s = [1.0, -inf]", "rig.ambient_e_per_s.1", "finite"),
    ],
)
def test_a_value_that_no_spec_holds_is_named(tmp_path: Path, line: str, key: str, says: str) -> None:
    """«Out of range float values are not JSON compliant» named neither the key nor the cause."""
    old = next(row for row in WALL.splitlines() if row.startswith("ambient_e_per_s"))
    told = refusal(tmp_path, "a.toml", WALL.replace(old, line))
    assert key in told and says in told and "JSON" not in told


def test_a_number_of_thousands_of_digits_is_bad_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    digits = "9" * 5000
    (tmp_path / "a.toml").write_text(WALL.replace("pulses_per_slice = 100", f"pulses_per_slice = {digits}"))
    data = load_scene("flat-wall").model_dump_json()
    (tmp_path / "a.json").write_text(data.replace('"pulses_per_slice":100', f'"pulses_per_slice":{digits}'))
    for source in (["a.toml"], ["a.json"], ["flat-wall", "--set", f"rig.pulses_per_slice={digits}"]):
        source[0] = str(tmp_path / source[0]) if source[0].startswith("a.") else source[0]
        assert main(["generate", *source, "--plan"]) == 2
        assert "digits" in capsys.readouterr().err
    with pytest.raises(InputError, match="digits"):
        load_scene("flat-wall", {"rig.pulses_per_slice": 10**5000})
    # In the label of an estimator it is text, which no parameter takes.
    assert parse_label(f"peak[a={digits}]")[1]["a"] == digits


def test_a_spec_nested_without_end_is_refused() -> None:
    deep: dict[str, object] = {}
    for _ in range(5000):
        deep = {"a": deep}
    with pytest.raises(InputError, match="deeply"):
        load_scene(deep)
    with pytest.raises(InputError, match="text"):
        load_scene({1: 2})  # type: ignore[dict-item]


def test_plain_data_reads_as_its_json(tmp_path: Path) -> None:
    data = json.loads(load_scene("flat-wall").model_dump_json())
    assert load_scene(data) == load_scene("flat-wall")
