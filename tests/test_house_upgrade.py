"""Files of other versions are refused with a next step: an older one is made anew, a newer one asks for a newer Beambench.

What version 0.1.0 wrote is read by `test_house_old_files.py`; stores of version 1 by `test_captures_recovery.py`.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from beambench import InputError
from beambench.benchmarks.gate.figures import read_baseline
from beambench.benchmarks.suites.suite import SUITES, load_suite
from beambench.captures.imports.mapping import load_mapping
from beambench.captures.layouts.schema import SCHEMA_VERSION
from beambench.captures.recording.plan import load_plan
from beambench.captures.store.manifest import MANIFEST, MANIFEST_SUM, load_manifest, sum_text
from beambench.captures.validate import check_schema_version
from beambench.scenes.datasets.load import load_dataset
from beambench.scenes.load import load_scene
from beambench.scenes.rig_files import read_rig_file
from beambench.scenes.spec_files import LIBRARY

from .test_house_old_files import old as old  # the files of 0.1.0, a fixture

NEWER = "pip install --upgrade beambench"

#: Kind of file -> (an example in the project, its reader).
FILES: dict[str, tuple[Path | str, Callable[[Path], Any]]] = {
    "scene": (LIBRARY / "flat-wall.toml", load_scene),
    "suite": (SUITES / "quickstart.toml", load_suite),
    "data set": ("scenes/datasets/library/gated-1k.toml", load_dataset),
    "plan": ("captures/recording/library/plans/gated-demo.toml", load_plan),
    "mapping": ("captures/imports/library/wf_spad_irf.toml", load_mapping),
    "rig": ('schema_version = 1\nkind = "gated"\n[rig.detector]\ngain_dn_per_e = 1.0\n', read_rig_file),
}


@pytest.mark.parametrize("kind", FILES)
@pytest.mark.parametrize("version", [0, 99])
def test_a_file_of_another_version_says_what_to_do(project: Path, tmp_path: Path, kind: str, version: int) -> None:
    source, read = FILES[kind]
    text = source if isinstance(source, str) and "\n" in source else (project / source).read_text(encoding="utf-8")
    assert tomllib.loads(text)["schema_version"] == 1, "a new version needs a conversion, or a line in docs/releases.md"
    path = tmp_path / "file.toml"
    path.write_text(re.sub(r"^schema_version = 1", f"schema_version = {version}", text, flags=re.M), encoding="utf-8")
    with pytest.raises(InputError, match="another version of its format") as error:
        read(path)
    assert error.value.where.endswith("schema_version") and error.value.value == version
    assert (NEWER in error.value.next_step) == (version == 99)
    assert error.value.next_step


@pytest.mark.parametrize(("version", "newer"), [(SCHEMA_VERSION - 1, False), (SCHEMA_VERSION + 1, True), (None, False)])
def test_captures_of_another_schema(version: int | None, newer: bool) -> None:
    with pytest.raises(InputError) as error:
        check_schema_version(version, "capture")
    assert (NEWER in error.value.next_step) is newer and error.value.next_step


@pytest.mark.parametrize(("version", "newer"), [(0, False), (99, True)])
def test_stores_of_another_version(old: Path, tmp_path: Path, version: int, newer: bool) -> None:
    body = json.loads((old / "gated.zarr" / MANIFEST).read_text(encoding="utf-8"))
    assert load_manifest(old / "gated.zarr").count == 1
    text = json.dumps(body | {"store_version": version}).encode()
    (tmp_path / MANIFEST).write_bytes(text)
    (tmp_path / MANIFEST_SUM).write_bytes(sum_text(text))
    with pytest.raises(InputError, match="another version of the format") as error:
        load_manifest(tmp_path)
    assert (NEWER in error.value.next_step) is newer and error.value.next_step


@pytest.mark.parametrize(("version", "newer"), [(0, False), (99, True)])
def test_baselines_of_another_version(project: Path, tmp_path: Path, version: int, newer: bool) -> None:
    data = json.loads((project / ".ci" / "gate" / "baseline.json").read_text(encoding="utf-8"))
    path = tmp_path / "baseline.json"
    path.write_text(json.dumps(data), encoding="utf-8")
    assert read_baseline(path).head["suite"] == "ci-gate"
    path.write_text(json.dumps(data | {"version": version}), encoding="utf-8")
    with pytest.raises(InputError, match="another version of its format") as error:
        read_baseline(path)
    assert (NEWER in error.value.next_step) is newer
    assert newer or f"--baseline {path} --update" in error.value.next_step


def test_the_page_on_releases_names_every_version_number(project: Path) -> None:
    """Numbers of formats that the code writes stand on the page, so that a change of one is told there."""
    from beambench.benchmarks.folders.record import TABLES_VERSION
    from beambench.captures.store.manifest import STORE_VERSION
    from beambench.captures.store.shard_manifest import SHARDED_VERSION

    text = (project / "docs" / "releases.md").read_text(encoding="utf-8")
    for name, number in (
        ("captures: `schema_version`", SCHEMA_VERSION),
        ("stores: `store_version`", STORE_VERSION),
        ("data sets in shards: `store_version`", SHARDED_VERSION),
        ("tables of a run: `tables_version`", TABLES_VERSION),
    ):
        assert re.search(rf"^\| {re.escape(name)} \| {number} \|", text, re.M), name


def test_the_version_is_the_same_in_all_places(project: Path) -> None:
    version = tomllib.loads((project / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    assert re.search(rf"^version: {re.escape(version)}$", (project / "CITATION.cff").read_text(encoding="utf-8"), re.M)
    assert re.search(
        rf"^## \[(Unreleased\] )?{re.escape(version)}", (project / "CHANGELOG.md").read_text(encoding="utf-8"), re.M
    )
