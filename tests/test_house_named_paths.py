"""Every Python file and every `python -m beambench...` that README, CONTRIBUTING and docs/ name exists and can be run."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path

import pytest

#: Files that readers are to create: they must not exist, so that an entry cannot hide a wrong name.
TO_CREATE = {"estimators/gated/half_sum.py"}

_FILE = re.compile(r"(?<![\w./<>*-])[\w-][\w./-]*\.py\b")
#: Files whose content a recipe gives: named before the code, or in its first line. Other tests follow the recipes.
_GIVEN = re.compile(r"(?:`|(?<=```python\n)# )([\w./-]+\.py)(?:`:\n(?=\n```python\n)|\n)")
_MODULE = re.compile(r"python -m\s+(beambench(?:\.\w+)*)")
_MAIN = re.compile(r"^if __name__ == \"__main__\":", re.MULTILINE)


def documents(project: Path) -> list[Path]:
    """The documents whose names are checked."""
    return [project / "README.md", project / "CONTRIBUTING.md", *sorted((project / "docs").rglob("*.md"))]


def wrong_names(text: str, project: Path) -> list[str]:
    """Names in a text of files that do not exist, and of modules that do not exist or cannot be run."""
    wrong = []
    given = TO_CREATE | set(_GIVEN.findall(text))
    for name in _FILE.findall(text):
        if name not in given and not (project / name).is_file() and not (project / "tests" / name).is_file():
            wrong.append(name)
    for name in _MODULE.findall(text):
        found = None
        try:
            found = importlib.util.find_spec(name)
            if found is not None and found.submodule_search_locations is not None:
                found = importlib.util.find_spec(f"{name}.__main__")
        except ModuleNotFoundError:
            pass
        source = Path(found.origin).read_text(encoding="utf-8") if found is not None and found.origin else ""
        if not _MAIN.search(source):
            wrong.append(f"python -m {name}")
    return wrong


def test_every_name_exists(project: Path) -> None:
    texts = {path: path.read_text(encoding="utf-8") for path in documents(project)}
    wrong = {str(path.relative_to(project)): wrong_names(text, project) for path, text in texts.items()}
    assert not {path: names for path, names in wrong.items() if names}
    # The patterns do find names: an empty search would pass too.
    assert sum(len(_FILE.findall(text)) for text in texts.values()) > 20
    assert sum(len(_MODULE.findall(text)) for text in texts.values()) > 5
    assert not [name for name in TO_CREATE if (project / name).exists()]


@pytest.mark.parametrize(
    "planted",
    [
        "optics/no_such_law.py",
        "test_no_such_test.py",
        "python -m beambench.no_such_room",
        "python -m beambench.benchmarks.checks.no_such_check",
        "python -m beambench.optics.constants",  # exists, but does nothing when run
        "python -m beambench.optics",  # a package without __main__
    ],
)
def test_a_wrong_name_is_found(project: Path, planted: str) -> None:
    good = "`optics/jit.py`, `test_house_named_paths.py`, `optics/brdf_<name>.py`, `python -m beambench.benchmarks.checks.bounds`"
    assert wrong_names(good, project) == []
    assert wrong_names(f"{good}, see `{planted}`.", project) == [planted]
