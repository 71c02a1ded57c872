"""docs/coverage.csv names every equation, figure and table of Guo et al. 2017 and Kusters 1992, and its entries are correct."""

from __future__ import annotations

import ast
import csv
import importlib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

COLUMNS = ["document", "item", "kind", "title", "function", "test", "verdict", "issue", "note"]
KINDS = {"Eq.": "equation", "Figure": "figure", "Table": "table"}
# The seven verdicts of a reproduction, and three states of an item that is no comparison of numbers.
REPRODUCED = {"arithmetic", "predicted", "fitted", "by-construction", "trend", "undetermined", "contradicted"}
BUILT = REPRODUCED | {"implemented"}
VERDICTS = BUILT | {"planned", "nothing-to-compute"}
#: What has no number in the documents: instruments and procedures that the text describes, named here.
UNNUMBERED = {
    "000": {
        "Photodetector set-up": "system", "Time slicing": "procedure", "Object validation": "procedure",
        "Gated wavefront system": "system", "Reference wavefront": "procedure", "Flow runs": "procedure",
        "Phase in radians": "procedure", "Peak-to-valley": "procedure",
    },
    "001": {
        "Light stripe": "system", "Image pre-filtering": "procedure", "Lens aberration": "procedure",
        "Laser-line thickness": "procedure", "Accuracy of 5 mm at 1 m": "procedure", "Wall fitting": "procedure",
        "Decade ambiguity": "procedure", "Profile selection and resampling": "procedure",
        "Detrend, taper and spectrum": "procedure", "Lamp-off subtraction": "procedure", "Line filter": "system",
    },
}  # fmt: skip


def expected_items() -> list[tuple[str, str]]:
    """Every numbered item, system and procedure, counted in the documents by hand (what the scans lost is included)."""
    items = [("000", f"Eq. {n}") for n in range(1, 35)]
    items += [("000", f"Figure {n}") for n in range(1, 17)]
    items += [("000", "Table 1")]
    for chapter, equations, figures in ((2, 5, 3), (3, 36, 9), (4, 7, 15), (5, 0, 16)):
        items += [("001", f"Eq. {chapter}.{n}") for n in range(1, equations + 1)]
        items += [("001", f"Figure {chapter}.{n}") for n in range(1, figures + 1)]
    items += [("001", "Table 4.1"), ("001", "Table 4.2")]
    return [*items, *((document, item) for document, named in UNNUMBERED.items() for item in named)]


@pytest.fixture(scope="module")
def rows(project: Path) -> list[dict[str, str]]:
    with (project / "docs" / "coverage.csv").open(newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        assert reader.fieldnames == COLUMNS
        return list(reader)


def _each(rows: list[dict[str, str]], column: str) -> Iterator[tuple[str, str]]:
    for row in rows:
        for name in filter(None, (part.strip() for part in row[column].split(";"))):
            yield f"{row['document']} {row['item']}", name


def test_every_item_stands_exactly_once(rows: list[dict[str, str]]) -> None:
    found = Counter((row["document"], row["item"]) for row in rows)
    expected = Counter(expected_items())
    assert len(expected) == 144 + 8 + 11
    assert found == expected, f"missing {expected - found}, too many {found - expected}"


def test_rows_are_well_formed(rows: list[dict[str, str]]) -> None:
    for row in rows:
        name = f"{row['document']} {row['item']}"
        assert row["kind"] == (UNNUMBERED[row["document"]].get(row["item"]) or KINDS[row["item"].split()[0]]), name
        assert row["title"].strip(), name
        assert row["verdict"] in VERDICTS, name
        assert row["issue"].isdecimal(), name  # also of what is planned


def test_nothing_is_called_built_without_function_and_test(rows: list[dict[str, str]]) -> None:
    for row in rows:
        name = f"{row['document']} {row['item']}"
        if row["verdict"] in BUILT:
            assert row["function"] and row["test"], f"{name} is '{row['verdict']}' without a function or a test"
        else:
            assert not row["function"] and not row["test"], f"{name} has a function or a test but is '{row['verdict']}'"
        if row["verdict"] == "nothing-to-compute":
            assert row["kind"] == "figure", f"{name}: only a diagram or a picture has nothing to compute"


def test_every_function_can_be_imported(rows: list[dict[str, str]]) -> None:
    for item, dotted in _each(rows, "function"):
        module, _, attribute = dotted.partition(":")
        assert attribute, f"{item}: write module:function, not {dotted!r}"
        assert module.startswith("beambench."), item
        assert callable(getattr(importlib.import_module(module), attribute)), f"{item}: {dotted}"


def test_every_test_exists(rows: list[dict[str, str]], project: Path) -> None:
    known: dict[str, set[str]] = {}
    for item, name in _each(rows, "test"):
        file, _, function = name.partition("::")
        if file not in known:
            path = project / "tests" / file
            assert path.is_file(), f"{item}: no file tests/{file}"
            known[file] = {
                node.name
                for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
                if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")
            }
        assert function in known[file], f"{item}: tests/{file} has no {function!r}"
