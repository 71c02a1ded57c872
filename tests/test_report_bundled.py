"""The chart library of a page is bundled once, and never taken from a damaged file."""

from __future__ import annotations

from pathlib import Path

import pytest

from beambench.benchmarks.report.bundled import chart_library


@pytest.fixture
def bundles(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[str]:
    """What was bundled; the cache is empty."""
    import vl_convert

    made: list[str] = []

    def bundle(exports: str) -> str:
        made.append(exports)
        return f"library µ; {exports}"

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(vl_convert, "javascript_bundle", bundle)
    return made


def test_it_is_bundled_once(bundles: list[str], tmp_path: Path) -> None:
    first = chart_library("a = 1;")
    assert first == "library µ; a = 1;" == chart_library("a = 1;") and bundles == ["a = 1;"]
    assert chart_library("b = 1;") == "library µ; b = 1;" and len(bundles) == 2
    assert len(list((tmp_path / "beambench" / "pages").iterdir())) == 2


@pytest.mark.parametrize(
    "damage", [lambda held: held[:-3], lambda held: held[:70] + b"\xff" + held[71:], lambda held: b""]
)
def test_a_damaged_file_is_made_anew(bundles: list[str], tmp_path: Path, damage: object) -> None:
    whole = chart_library("a = 1;")
    (path,) = (tmp_path / "beambench" / "pages").iterdir()
    assert callable(damage)
    path.write_bytes(damage(path.read_bytes()))
    assert chart_library("a = 1;") == whole and len(bundles) == 2
    assert chart_library("a = 1;") == whole and len(bundles) == 2


def test_without_a_cache_it_is_bundled_each_time(
    bundles: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert chart_library("a") == chart_library("a") and bundles == ["a", "a"]
