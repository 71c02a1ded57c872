"""Files of other programs: each reader gives the values that were written, the mapping places them, and faults are told."""

from __future__ import annotations

import importlib
import json
import sys
import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import beambench
from beambench import InputError, cli
from beambench.benchmarks.checks.fuzz_imports import SAMPLES, fuzzed, sample_trc
from beambench.captures import open_captures, verify
from beambench.captures.imports.files import READERS, read_recording
from beambench.captures.imports.mapping import LIBRARY, load_mapping
from beambench.captures.imports.recording import check_bytes

PIXELS = np.arange(12 * 16, dtype=np.uint16).reshape(12, 16)


@pytest.mark.parametrize("ending", [one for one in SAMPLES if one not in (".trc", ".csv")])
def test_a_reader_gives_the_values_that_another_library_wrote(ending: str, tmp_path: Path) -> None:
    if ending == ".fits":
        pytest.importorskip("astropy", reason="astropy is not installed (extra `imports`)")
    path = tmp_path / f"frame{ending}"
    SAMPLES[ending](path)
    found = read_recording(path).array("", "")
    assert np.array_equal(np.squeeze(found), PIXELS)
    assert found.dtype.isnative


def test_every_ending_has_a_reader() -> None:
    for _, home in READERS.values():
        module, _, name = home.partition(":")
        assert callable(getattr(importlib.import_module(f"beambench.captures.imports.{module}"), name))


def test_a_sequence_of_an_oscilloscope(tmp_path: Path) -> None:
    """V = code/1024 − .5; each segment's time is that of the first one plus its own offset, k·0.25 ns."""
    path = tmp_path / "C1.trc"
    sample_trc(path)
    found = read_recording(path)
    assert np.allclose(found.arrays["signal"].ravel(), np.arange(60) / 1024 - 0.5, atol=1e-12)
    assert np.allclose(found.arrays["time"], -5e-9 + 1e-9 * np.arange(20), atol=1e-15)  # the interval has 32 bits
    assert np.allclose(found.arrays["start"], 0.25e-9 * np.arange(3), atol=1e-16)
    assert np.allclose(found.arrays["trigger_time"], 0.001 * np.arange(3))


@pytest.mark.data
@pytest.mark.parametrize("name", ["pulse", "pulse_sequence", "issue_1"])
def test_volts_are_those_of_two_public_readers(name: str, real_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """lecroyscope: equal. lecroyparser computes in 32 bits, and spreads N samples over N intervals with both ends: its last
    sample is one interval late."""
    monkeypatch.setitem(
        sys.modules, "vxi11", types.SimpleNamespace(Instrument=object)
    )  # it would control an oscilloscope
    one = pytest.importorskip("lecroyparser", reason="the peer lecroyparser is not installed")
    other = pytest.importorskip("lecroyscope", reason="the peer lecroyscope is not installed")
    path = real_data / "wf_lecroy" / f"{name}.trc"
    found = read_recording(path)
    signal, time = found.arrays["signal"], found.arrays["time"]
    single, scope = one.ScopeData(str(path)), other.Trace(path.read_bytes())
    assert np.abs(single.y - signal.ravel()).max() < 2e-7
    assert np.array_equal(np.asarray(scope.voltage).ravel(), signal.ravel())
    assert np.array_equal(np.asarray(scope.time), time)
    interval, count = float(found.header["interval_s"]), signal.size
    late = float(single.x[-1] - (single.x[0] + (count - 1) * interval))
    assert late == pytest.approx(interval, rel=1e-6)


@pytest.mark.parametrize("ending", sorted(SAMPLES))
def test_damaged_files_are_refused(ending: str, tmp_path: Path) -> None:
    """Sixty of the ten thousand of `benchmarks.checks.fuzz_imports`."""
    if ending == ".fits":
        pytest.importorskip("astropy", reason="astropy is not installed (extra `imports`)")
    outcome = fuzzed(ending, 60, 7, tmp_path)
    assert outcome["wrong"] == 0, outcome.said
    assert outcome["refused"] > 5 and sum(outcome.values()) == 60


def test_sizes_are_bounded_before_memory_is_taken(tmp_path: Path) -> None:
    """An .spe of 4100 bytes that states 32767 × 65535 × 65535 pixels, and a sequence of 2³⁰ samples."""
    path = tmp_path / "big.spe"
    SAMPLES[".spe"](path)
    content = bytearray(path.read_bytes())
    content[42:44] = content[656:658] = b"\xff\xff"
    content[1446:1450] = b"\xff\x7f\0\0"
    path.write_bytes(content)
    with pytest.raises(InputError, match="cannot be read"):
        read_recording(path)
    with pytest.raises(ValueError, match="more than"):
        check_bytes((2**20, 2**11), 1)


def gated_mapping(folder: Path, **changes: str) -> Path:
    text = """schema_version = 1
modality = "gated"
truth_kind = "surveyed"
[data.counts]
axes = ["row", "col"]
stack = "slice"
units = "DN"
[coords]
delay = { even = { start = 20.0, step = 0.5 }, units = "ns" }
gate = { values = 0 }
laser_on = { values = true }
valid = { values = true }
time = { values = 0.0, units = "s" }
[truth.truth_range]
files = ["range.npy"]
units = "mm"
invalid = [0.0]
[rig]
scene = "flat-wall"
overrides = { "rig.camera.rows" = 12, "rig.camera.cols" = 16 }
"""
    for old, new in (one.split(" => ") for one in changes.values()):
        assert old in text
        text = text.replace(old, new)
    path = folder / "mapping.toml"
    path.write_text(text)
    return path


@pytest.fixture
def recording(tmp_path: Path) -> list[Path]:
    import OpenImageIO as oiio

    paths = []
    for k in range(3):
        path = tmp_path / f"slice-{k}.tif"
        file = oiio.ImageOutput.create(str(path))
        file.open(str(path), oiio.ImageSpec(16, 12, 1, oiio.UINT16))
        file.write_image((PIXELS + np.uint16(k))[..., None])
        file.close()
        paths.append(path)
    depth = np.full((12, 16), 5000.0)
    depth[0, 0] = 0.0
    np.save(tmp_path / "range.npy", depth)
    return [*paths, tmp_path / "range.npy"]


def test_a_stack_of_pictures_becomes_a_capture(recording: list[Path], tmp_path: Path) -> None:
    mapping = gated_mapping(
        tmp_path, files='axes = ["row" => files = ["slice-0.tif", "slice-1.tif", "slice-2.tif"]\naxes = ["row"'
    )
    out = tmp_path / "real.zarr"
    typed = ["import", *map(str, recording), "--map", str(mapping), "-o", str(out)]
    assert cli.main(typed) == 0
    assert not verify(out)
    capture = open_captures(out)[0]
    assert np.array_equal(capture["counts"].values, PIXELS + np.arange(3, dtype=np.uint16)[:, None, None])
    assert np.allclose(capture["delay"].values, [20e-9, 20.5e-9, 21e-9], atol=1e-20)
    assert np.isnan(capture["truth_range"].values[0, 0]) and capture["truth_range"].values[3, 3] == 5.0
    told = json.loads(capture.attrs["provenance"])["arguments"]["import"]
    assert set(told["files"]) == {path.name for path in recording} and len(told["files"]["range.npy"]) == 64
    assert json.loads(capture.attrs["rig"])["kind"] == "gated"
    assert cli.main(typed) == 2  # the output exists


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ('units = "ns" => units = "nanoseconds"', "does not fit"),
        ('units = "ns" => units = "mm"', "does not fit"),
        ('stack = "slice"\nunits = "DN" => stack = "slice"', "not declared"),
        ('axes = ["row", "col"] => axes = ["row", "colour"]', "axes are not those"),
        ('axes = ["row", "col"] => axes = ["row"]', "axes do not fit"),
        ('files = ["range.npy"] => files = ["other.npy"]', "not in the folder"),
        ('files = ["range.npy"] => files = ["../range.npy"]', "given folder only"),
        ('scene = "flat-wall" => scene = "?"', "question marks"),
        ('scene = "flat-wall" => scene = "spotscan-wall"', "leads nowhere|another kind"),
        ("[data.counts] => [data.count]", "no such variable"),
        ("schema_version = 1 => schema = 1", "Unknown key"),
        ('"rig.camera.rows" = 12 => "rig.camera.row" = 12', "Unknown key"),
        ('"rig.camera.rows" = 12 => "rig.camera.rows" = 64', "another size than the rig's camera"),
    ],
)
def test_a_wrong_mapping_is_refused(change: str, said: str, recording: list[Path], tmp_path: Path) -> None:
    mapping = gated_mapping(
        tmp_path,
        files='axes = ["row" => files = ["slice-0.tif", "slice-1.tif", "slice-2.tif"]\naxes = ["row"',
        change=change,
    )
    with pytest.raises(InputError, match=said):
        beambench.import_([tmp_path], map=mapping, out=tmp_path / "out.zarr")
    assert not (tmp_path / "out.zarr").exists()


def test_frames_that_are_no_counts_are_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "range.npy", np.full((12, 16), 5.0))
    np.save(tmp_path / "frames.npy", PIXELS[None] + 0.5)
    change = 'axes = ["row", "col"]\nstack = "slice" => files = ["frames.npy"]\naxes = ["slice", "row", "col"]'
    mapping = gated_mapping(tmp_path, axes=change)
    with pytest.raises(InputError, match="not whole counts"):
        beambench.import_([tmp_path], map=mapping, out=tmp_path / "out.zarr")


def test_time_tags_become_a_histogram(tmp_path: Path) -> None:
    """Two shots; a tag at the edge of two bins counts in the later one, one outside in none."""
    (tmp_path / "tags.csv").write_text("shot,ps\n0,0\n0,49\n0,50\n1,100\n1,151\n1,999\n1,-60\n")
    (tmp_path / "m.toml").write_text("""schema_version = 1
modality = "waveform"
truth_kind = "none"
[data.signal]
files = ["tags.csv"]
units = "electron"
tags = { time = "ps", units = "ps", shot = "shot", shots = 2, start_s = 0.0, step_s = 1.0e-10, samples = 4 }
[coords.time]
even = { start = 0.0, step = 0.1 }
units = "ns"
[rig]
scene = "single-photon"
""")
    made = beambench.import_([tmp_path], map=tmp_path / "m.toml", out=tmp_path / "tags.zarr")
    capture = open_captures(next(iter(made.stores)))[0]
    assert capture["signal"].values.tolist() == [[2, 1, 0, 0], [0, 1, 1, 0]]
    assert capture["signal"].attrs["units"] == "electron"
    assert np.allclose(capture["time"].values, 1e-10 * np.arange(4))


def test_a_scaffold_says_what_is_left(
    recording: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "new.toml"
    typed = ["import", *map(str, recording[:3]), "--scaffold", "--modality", "gated", "-o", str(out)]
    assert cli.main(typed) == 0
    text = out.read_text()
    assert "uint16 (12, 16)" in text and 'axes = ["row", "col"]' in text and "[coords.delay]" in text
    capsys.readouterr()
    assert cli.main(["import", *map(str, recording[:3]), "--map", str(out)]) == 2
    told = capsys.readouterr().err
    assert "question marks" in told and "coords.delay.values" in told and "rig.scene" in told


def test_surfaces_and_unknown_files_are_told_apart(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "bunny.obj").write_text("v 0 0 0\n")
    with pytest.raises(InputError, match="target of a scene"):
        read_recording(tmp_path / "bunny.obj")
    (tmp_path / "x.docx").write_text("")
    with pytest.raises(InputError, match="not read"):
        read_recording(tmp_path / "x.docx")
    assert cli.main(["import", str(tmp_path / "bunny.obj")]) == 2
    assert "--scaffold" in capsys.readouterr().err
    assert cli.main(["import", str(tmp_path / "none.png"), "--map", "gated_g2d"]) == 2


@pytest.mark.parametrize("name", sorted(path.stem for path in LIBRARY.glob("*.toml")))
def test_the_shipped_mappings_are_whole(name: str) -> None:
    mapping = load_mapping(name)
    assert mapping.title
    assert all((LIBRARY / f"{one}.toml").is_file() for one in mapping.collection)
    assert mapping.collection or (mapping.source and mapping.licence and mapping.caution)


@pytest.mark.data
def test_real_captures_are_imported(real_data: Path, tmp_path: Path) -> None:
    """The folders of gated frames, of an oscilloscope and of single photons, each by one command."""
    made: dict[str, Any] = {}
    for name in ("gated_g2d", "wf_lecroy", "wf_spad_irf"):
        assert cli.main(["import", str(real_data / name), "--map", name, "-o", str(tmp_path / name)]) == 0
        made[name] = sorted(tmp_path.glob(f"{name}/*.zarr")) or [tmp_path / name]
    assert [len(made[name]) for name in made] == [1, 3, 2]
    for stores in made.values():
        assert all(not verify(store) for store in stores)
    day = open_captures(made["gated_g2d"][0])[0]
    assert day["counts"].shape == (3, 720, 1280) and int(day["counts"].values.max()) == 1023
    assert np.isfinite(day["truth_depth"].values).sum() == 5600 and day.attrs["truth_kind"] == "reference-instrument"
    from beambench.estimators import run_estimator

    with pytest.raises(InputError, match=r"missing or cannot be used|unknown"):
        run_estimator("poisson-ml", day)
    segments = open_captures(next(store for store in made["wf_lecroy"] if "sequence" in store.name))[0]
    found = run_estimator("waveform-ml", segments)["range"].values
    # Equal pulses of 20 segments scatter by less than a sample, 1 ns = 150 mm, about the 100 ns that the mapping sets.
    assert np.abs(found - 14.9896).max() < 0.15 and 0.0 < found.std() < 0.03


@pytest.mark.data
def test_the_unusable_frame_is_refused(real_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("astropy", reason="astropy is not installed (extra `imports`)")
    folder = str(real_data / "sh_mmtwfs")
    assert cli.main(["import", folder, "--map", "sh_mmtwfs-bogus", "-o", str(tmp_path / "bad.zarr")]) == 2
    assert "too few spots" in capsys.readouterr().err
    assert not (tmp_path / "bad.zarr").exists()


def _commands(page: Path) -> list[list[str]]:
    found = [line.split("#")[0].split() for line in page.read_text().splitlines() if line.startswith("    beambench ")]
    return [words[1:] for words in found]


def test_the_commands_of_the_page_run(
    project: Path, recording: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first three of docs/importing.md, as typed, on frames of that place; its mapping is the one that they need."""
    page = project / "docs" / "importing.md"
    first = [words for words in _commands(page) if not any(word.startswith("real/") for word in words)]
    assert [words[0] for words in first] == ["import", "import", "data"]
    frames = tmp_path / "frames"
    frames.mkdir()
    for path in recording:
        path.rename(frames / path.name)
    monkeypatch.chdir(tmp_path)
    for words in first:
        typed = [name for word in words for name in (sorted(map(str, Path().glob(word))) if "*" in word else [word])]
        assert cli.main(typed) == 0
        if "--scaffold" in words:
            text = page.read_text()
            begin = text.index("```toml\n") + len("```toml\n")
            (tmp_path / "mapping.toml").write_text(text[begin : text.index("```", begin)])


@pytest.mark.data
@pytest.mark.slow
def test_the_pages_commands_import_every_folder(
    project: Path, real_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, long_run: None
) -> None:
    pytest.importorskip("astropy", reason="astropy is not installed (extra `imports`)")
    (tmp_path / "real").symlink_to(real_data)
    monkeypatch.chdir(tmp_path)
    commands = [words for words in _commands(project / "docs" / "importing.md") if words[1].startswith("real/")]
    assert len(commands) == 5
    for words in commands:
        assert cli.main(words) == 0
    stores = [*tmp_path.glob("*.zarr"), *tmp_path.glob("*/*.zarr")]
    assert len(stores) == 11
    assert all(not verify(store) for store in stores)
