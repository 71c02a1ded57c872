"""Parts of the report page: styles, pairs, surfaces, budget of pictures, opening charts, and files for a paper."""

from __future__ import annotations

import base64
import csv
import re
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from beambench.benchmarks.report.citations import citations_of, latex
from beambench.benchmarks.report.data import base_cells, cells_of
from beambench.benchmarks.report.exports import write_exports
from beambench.benchmarks.report.fidelity_chart import effects_spec, effects_words, rungs_spec
from beambench.benchmarks.report.opening import charts_of
from beambench.benchmarks.report.pairs import pairs_section
from beambench.benchmarks.report.picture_files import picture_index
from beambench.benchmarks.report.picture_section import RELIEF_BUDGET, picture_scenes, reliefs_of
from beambench.benchmarks.report.pictures import Picture
from beambench.benchmarks.report.sources import KNOWN, source_of
from beambench.benchmarks.report.styles import PALETTE, styles_of
from beambench.benchmarks.report.surfaces import MISSING, coarse, packed
from beambench.benchmarks.report.table import score_table
from beambench.benchmarks.scores.tables import read_scores
from beambench.benchmarks.suites.suite import load_suite
from beambench.captures.layouts import LAYOUTS, layout_of
from beambench.estimators.builtin import BUILTIN
from beambench.estimators.registry import get_estimator
from beambench.scenes.errors import InputError

from . import _api_fixtures as made_up


def test_a_style_depends_on_the_set_of_names_only() -> None:
    names = [f"e{k:02d}" for k in range(36)]
    styles = styles_of(names)
    assert styles_of(reversed(names)) == styles and styles_of([*names, "e07"]) == styles
    assert len(set(styles.values())) == 36
    assert len({styles[name][0] for name in names[:6]}) == len(PALETTE) == len({styles[name][1] for name in names[:6]})


PAIRS = """\
modality,stage,quantity,condition,a,b,scenes,ratio,ratio_lo,ratio_hi,p,p_holm,winner
gated,range,range,matched,slow,fast,8,4,3,5,.001,.003,fast
gated,range,range,matched,slow,other,8,1.1,,,,,
gated,range,range,matched,other,fast,8,3.6,3,4,.001,.003,fast
gated,range,range-mixed,matched,other,fast,8,1,1,1,.5,.5,
"""


def test_the_matrix_of_pairs_is_reciprocal(tmp_path: Path) -> None:
    assert pairs_section(tmp_path) == []
    (tmp_path / "pairs.csv").write_text(PAIRS)
    (group,) = pairs_section(tmp_path)
    assert group["names"] == ["fast", "other", "slow"], "the best first"
    cells = {
        (row["name"], name): cell
        for row in group["rows"]
        for name, cell in zip(group["names"], row["cells"], strict=True)
    }
    assert cells["slow", "fast"]["text"] == "4.00" and cells["slow", "fast"]["kind"] == "worse"
    assert cells["fast", "slow"]["text"] == "0.250" and cells["fast", "slow"]["kind"] == "better"
    assert "[0.200, 0.333]" in cells["fast", "slow"]["more"], "an interval turns over"
    assert cells["other", "slow"]["kind"] == "open" and cells["other", "slow"]["more"] == ""
    assert cells["slow", "slow"] is None
    (tmp_path / "pairs.csv").write_text("a,b\n1,2\n")
    with pytest.raises(InputError, match="pairs"):
        pairs_section(tmp_path)


def test_a_coarse_grid_holds_medians_and_a_profile_keeps_more_samples() -> None:
    values = np.arange(128 * 130, dtype=float).reshape(128, 130)
    values[:3, :3] = np.nan
    grid = coarse(values)
    assert grid.shape == (43, 44) and np.isnan(grid[0, 0])
    assert grid[5, 5] == np.median(values[15:18, 15:18])
    assert grid[-1, -1] == np.median(values[126:, 129:]), "the last block is smaller"
    assert coarse(np.zeros((1, 200))).shape == (1, 200) and coarse(np.zeros((1, 1000))).shape == (1, 250)
    partly = np.array([[1.0, np.nan], [3.0, np.nan]])
    assert coarse(partly, side=1)[0, 0] == 2.0, "the median of what is known"


def test_packed_numbers_come_back() -> None:
    values = np.array([[1.0, 2.0], [np.nan, 3.0]])
    codes = np.frombuffer(base64.b64decode(packed(values, 1.0, 2.0)), "<u2")
    assert codes.tolist() == [0, 65534, MISSING, 65534]


def _picture(side: int, seed: int, estimator: str = "peak") -> Picture:
    rng = np.random.default_rng(seed)
    truth = np.full((side, side), 5.0, np.float32)
    error = rng.normal(0, 1e-3, truth.shape).astype(np.float32)
    return Picture("wall", estimator, "matched", truth + error, truth, error, np.ones(truth.shape, bool))


def test_pictures_are_reduced_until_they_fit() -> None:
    pictures = [_picture(200, seed, name) for seed, name in enumerate("abc")]
    whole = sum(len(e["value"]) + len(e["error"]) for e in picture_scenes(pictures, list("abc"))[0]["entries"])
    (scene,) = picture_scenes(pictures, ["c", "a"], budget=whole // 3)
    assert sum(len(e["value"]) + len(e["error"]) for e in scene["entries"]) <= whole // 3
    assert [e["label"] for e in scene["entries"]] == ["c", "a", "b"]
    (relief,) = reliefs_of(pictures, ["c", "a"])
    assert (relief["rows"], relief["cols"]) == (50, 50) and list(relief["estimates"]) == ["c", "a", "b"]


def test_many_reliefs_become_coarser() -> None:
    pictures = [_picture(64, 1, f"e{k}") for k in range(200)]
    (relief,) = reliefs_of(pictures, [])
    assert 30 < relief["rows"] < 64
    assert sum(len(e["value"]) + len(e["error"]) for e in relief["estimates"].values()) <= RELIEF_BUDGET


def test_images_profiles_and_wavefronts_have_a_picture() -> None:
    """Of each layout's quantities, those that extend in two directions, whole or reduced to the first frame or return."""
    quantities = {q.name: q for m in LAYOUTS for stage in layout_of(m).stages for q in stage.gives if len(q.dims) > 1}
    shapes = {"range": (4, 5), "column": (3, 6, 2), "point": (3, 6, 2, 3), "phase": (2, 7, 8), "image": (2, 9, 5)}
    expected = {"range": (4, 5), "column": (3, 6), "point": (3, 6), "phase": (7, 8), "image": (9, 5)}
    shapes["level_point"], expected["level_point"] = shapes["point"], expected["point"]
    for name, quantity in quantities.items():
        index = picture_index(quantity)
        assert (index is not None) == (name in expected), name
        if index is not None:
            assert np.zeros(shapes[name])[index].shape == expected[name]
    values = np.zeros((1, 1, 1, 3))
    values[..., 2] = 7.0
    index = picture_index(quantities["point"])
    assert index is not None and values[index] == 7.0, "of a point the depth"


def test_a_missing_chart_says_which_command_makes_it(tmp_path: Path) -> None:
    folder = made_up.make_run(tmp_path / "my run", pictures=False)
    cells = cells_of(read_scores(folder))
    styles = styles_of(c.label for c in cells)
    first, second, third = charts_of(folder, base_cells(cells), cells, styles, "'my run'").opening
    assert first["choices"] and not first["missing"] and "<svg" in first["static"]
    assert not second["choices"] and second["missing"]
    suite = second["command"].removeprefix("beambench sweep ")
    assert set(made_up.ESTIMATORS) & set(load_suite(suite).suite.estimators), (
        "a suite of the library for these estimators"
    )
    assert third["command"] == "beambench fidelity --modality gated -o 'my run'/fidelity" and third["missing"]


EFFECTS = {
    "rung": "direct", "rtol": 1e-3,
    "effects": [
        {"name": "first bounce", "modelled": True, "predicted_relative_size": 1.0, "basis": "b"},
        {"name": "halo", "modelled": False, "predicted_relative_size": 0.02, "basis": "b"},
        {"name": "speckle", "modelled": False, "predicted_relative_size": None, "basis": "b"},
        {"name": "motion", "modelled": False, "predicted_relative_size": 0.0, "basis": "b"},
    ],
}  # fmt: skip


def test_fidelity_is_drawn_from_effects_and_from_rungs() -> None:
    spec = str(effects_spec(EFFECTS, page=True))
    assert "first bounce" in spec and "halo" in spec and "speckle" not in spec and "0.001" in spec
    assert "Neglected, of unknown size: speckle." in effects_words(EFFECTS) and "1 catalogued" in effects_words(EFFECTS)
    assert effects_spec({"effects": EFFECTS["effects"][2:]}, page=True) is None
    row = {"scene": "near", "rung": "full", "cpu_s": 3.0, "rel_error": 1e-3, "lo": float("nan"), "hi": float("nan")}
    assert "near" in str(rungs_spec([row], page=False))
    assert rungs_spec([row | {"rel_error": float("nan")}], page=False) is None


def test_sources_become_entries_without_remarks() -> None:
    found = citations_of(["poisson-ml", "spot-centroid+slope-cell", "weighted-average[background=outside]", "stranger"])
    assert found.without == ["stranger"] and set(found.keys) >= {"poisson-ml", "spot-centroid+slope-cell"}
    entries = re.findall(r"@\w+\{([a-z0-9]+),\n(.*?)\n\}", found.bibtex, re.DOTALL)
    keys = [key for key, _ in entries]
    assert keys[0] == "beambench" and f"version {version('beambench')}" in entries[0][1]
    assert len(set(keys)) == len(keys) and {k for mine in found.keys.values() for k in mine} == set(keys[1:])
    assert all("year " in text and text.count("{") == text.count("}") for _, text in entries[1:])
    assert re.search(
        r"osborne1992.*author = \{Osborne\}.*title  = \{Fisher's method of scoring\}", found.bibtex, re.DOTALL
    )


def test_known_sources_are_those_of_built_in_estimators() -> None:
    """Each known source is cited, its title or DOI is of one entry, and unknown ones keep the free form of their reference."""
    text = citations_of(BUILTIN).bibtex
    entries = dict(re.findall(r"@\w+\{([a-z0-9]+),\n(.*?)\n\}", text, re.DOTALL))
    dois = re.findall(r"doi    = \{(.*)\}", text)
    assert len(dois) == len(set(dois)) >= 20 and all(re.fullmatch(r"10\.\d{4,5}/\S+", doi) for doi in dois)
    for words, fields in KNOWN.items():
        own = [
            one
            for one in entries.values()
            if any(f"{{{fields[key]}}}" in one for key in ("doi", "title") if key in fields)
        ]
        assert len(own) == 1, words
    assert all("note " in one or "title " in one or "doi " in one for one in entries.values())
    assert "Final report" in entries["guo2017"] and "Woods Hole" in entries["kusters1992"]


def test_sources_that_nobody_looked_up_have_no_doi() -> None:
    for name in BUILTIN:
        for part in get_estimator(name).cites.split("; "):
            if "not verified" in part:
                assert not source_of(part), part
                entry = citations_of([name]).bibtex
                assert "(not verified)}" in entry, entry


def test_every_built_in_source_has_a_plausible_year() -> None:
    years = [int(year) for year in re.findall(r"year   = \{(\d+)\}", citations_of(BUILTIN).bibtex)]
    assert len(years) > 30 and all(1900 < year < 2030 for year in years), years


def test_latex_escapes() -> None:
    assert latex("a_b & 5 % {x} \\y") == r"a\_b \& 5 \% \{x\} \textbackslash{}y"


def test_files_for_a_paper(tmp_path: Path) -> None:
    folder = made_up.make_run(tmp_path, pictures=False)
    cells = cells_of(read_scores(folder))
    write_exports(folder, title="A & B | c", sentences=["One."], base=cells, shown=cells, command="beambench run x")
    tex, text = ((folder / name).read_text(encoding="utf-8") for name in ("report.tex", "report.md"))
    assert r"A \& B" in tex and tex.count("\\begin{tabular}") == len(made_up.SCENES) == tex.count("\\bottomrule")
    cited = {key for keys in re.findall(r"\\cite\{([^}]*)\}", tex) for key in keys.split(",")}
    assert cited == set(re.findall(r"@\w+\{([^,]*),", (folder / "report.bib").read_text(encoding="utf-8")))
    rows = [line for line in tex.splitlines() if line.endswith("\\\\") and "&" in line]
    assert len({len(re.findall(r"(?<!\\)&", line)) for line in rows}) == 1, "every row has the columns of the head"
    assert "# A & B \\| c" in text and "0.63" in text and "    beambench run x" in text
    assert text.count("\n| poisson-ml |") == 2 * len(made_up.SCENES)
    with open(folder / "report.csv", newline="", encoding="utf-8") as file:
        table = list(csv.DictReader(file))
    assert len(table) == len(cells) and table[0]["rmse_full"] == f"{cells[0].rmse_full:.9g}"


def test_a_table_of_several_quantities_names_their_units() -> None:
    rows = [made_up.score_row(), made_up.score_row(modality="laser_line", stage="line", quantity="column", unit="px")]
    table = score_table(cells_of(pd.DataFrame(rows)))
    assert sorted(row["values"][0][1] for row in table) == ["0.00100 px", "1.00 mm"]
    (alone,) = score_table(cells_of(pd.DataFrame(rows[:1])))
    assert alone["values"][0][1] == "1.00"
