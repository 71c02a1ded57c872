"""The shipped data sets can be made: captures of one group have one layout, whatever their scenes show."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import beambench
from beambench.benchmarks.datasets.worker import Maker
from beambench.captures import open_captures
from beambench.captures.layouts import layout_of
from beambench.captures.padding import padded
from beambench.captures.store.arrays import structure_of
from beambench.scenes.datasets.load import load_dataset
from beambench.scenes.datasets.spec import list_datasets
from beambench.scenes.errors import InputError

#: Captures of each data set that show what others do not: a step hides part of the sheet in capture 4 of the laser lines.
_TOLD = {"laser-line-10k": (0, 4)}


@pytest.mark.parametrize("name", list_datasets())
def test_captures_of_a_shipped_data_set_have_one_layout(name: str) -> None:
    """laser-line-10k could not be made: rows with two returns made its truth longer, which a plan of ten captures does not meet."""
    maker = Maker(load_dataset(name, {"captures": 24, "split": None}))
    made = [maker.capture(number)[0] for number in _TOLD.get(name, (0, 1))]
    assert structure_of(made[0]) == structure_of(made[1])


@pytest.mark.slow
@pytest.mark.parametrize("name", list_datasets())
def test_two_dozen_of_each_shipped_data_set_are_made(name: str, tmp_path: Path, long_run: None) -> None:
    beambench.generate(name, overrides={"captures": 24}, out=tmp_path / "set", workers=1)
    assert beambench.data_verify(tmp_path / "set") == []


def _rows(returns: int) -> xr.Dataset:
    capture = Maker(load_dataset("laser-line-10k", {"captures": 1, "split": None})).capture(0)[0]
    keep = [name for name in capture.variables if "return" in capture[name].dims]
    return capture.assign({name: capture[name].isel({"return": slice(0, returns)}) for name in keep})


def test_padding_adds_nothing_but_nan() -> None:
    size = layout_of("laser_line").padded["return"]
    whole = _rows(size)
    cut = whole.isel({"return": slice(0, 1)})
    again = padded(cut, "here")
    assert again.sizes["return"] == size and again.attrs == cut.attrs
    assert list(again.variables) == list(cut.variables)
    for name, variable in cut.variables.items():
        assert again[name].dtype == variable.dtype and again[name].attrs == variable.attrs
        if "return" in variable.dims:
            assert np.array_equal(again[name].isel({"return": [0]}).values, variable.values, equal_nan=True)
            assert np.isnan(again[name].isel({"return": slice(1, None)}).values).all()
    with pytest.raises(InputError, match="more along 'return'"):
        padded(
            xr.concat([whole, whole], "return", data_vars="minimal", coords="minimal", compat="override"), "capture 7"
        )


def test_a_data_set_of_laser_lines_repeats_from_its_records(tmp_path: Path) -> None:
    """`--like` makes captures as long as those of the data set."""
    beambench.generate("laser-line-10k", overrides={"captures": 2, "split": None}, out=tmp_path / "set", workers=1)
    assert open_captures(tmp_path / "set" / "laser_line")[0].sizes["return"] == layout_of("laser_line").padded["return"]
    assert beambench.generate(like=tmp_path / "set" / "laser_line").equal


def test_status_tells_a_folder_that_is_a_link_and_an_index_that_was_changed(tmp_path: Path) -> None:
    """Both were called complete; a group of a data set was no store to `verify`."""
    data = tmp_path / "set"
    beambench.generate("gated-1k", overrides={"captures": 2, "split": None}, out=data, workers=1)
    assert beambench.data_status(data)["state"] == "complete"
    assert beambench.data_verify(data / "gated") == []
    index = data / "index.parquet"
    sound = index.read_bytes()
    index.write_bytes(sound + b"x")
    assert (beambench.data_status(data)["state"], beambench.data_status(data)["damaged"]) == (
        "damaged",
        ["index.parquet"],
    )
    index.write_bytes(sound)
    (data / "gated" / "counts").rename(tmp_path / "elsewhere")
    (data / "gated" / "counts").symlink_to(tmp_path / "elsewhere")
    assert beambench.data_status(data)["state"] == "damaged"


def test_a_data_set_that_another_command_has_begun_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It ended with «File exists», and advised --resume to a command that had it."""
    from beambench.benchmarks.datasets import place

    real = place.pilot

    def slow(*given: Any) -> Any:
        made = real(*given)
        (tmp_path / "set.partial").mkdir()
        return made

    monkeypatch.setattr(place, "pilot", slow)
    with pytest.raises(InputError, match="Another command has begun this data set"):
        beambench.generate("gated-1k", overrides={"captures": 2, "split": None}, out=tmp_path / "set", workers=1)


def test_an_unknown_name_in_an_expression_is_told_with_its_place() -> None:
    """The message was at «(whole)» and held the whole file in place of the name that is meant."""
    albedo = {"kind": "uniform", "low": 0.1, "high": 0.9, "paths": ["target.0.material.albedo"]}
    wrong = {"kind": "expression", "text": "albdo * 2", "paths": ["rig.ambient_e_per_s"]}
    data = {
        "schema_version": 1, "dataset": "mine", "captures": 2, "seed": 1, "fidelity": "direct", "rtol": 0.01,
        "scenes": [{"scene": "flat-wall"}], "parameters": {"albedo": albedo, "ambient": wrong},
    }  # fmt: skip
    with pytest.raises(InputError, match="did you mean albedo") as caught:
        load_dataset(data)
    assert "parameters.ambient.text: albdo" in str(caught.value)
    assert "schema_version" not in str(caught.value)
