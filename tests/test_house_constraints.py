"""constraints.txt states one version of every dependency, and holds only names, versions and markers."""

from __future__ import annotations

import re
import sys
import tomllib
from importlib.metadata import PackageNotFoundError, requires
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

EXTRAS = ("test", "peers", "docs", "imports", "netcdf", "dask", "exports")
TOOLS = {"pip", "setuptools"}  # what installs, not what is installed


def lines(project: Path) -> list[str]:
    text = (project / "constraints.txt").read_text(encoding="utf-8")
    return [line for line in text.splitlines() if line and not line.startswith("#")]


def pins(project: Path, python: str) -> dict[str, Requirement]:
    """Name -> requirement that holds on a Python, e.g. "3.11"."""
    found: dict[str, Requirement] = {}
    for line in lines(project):
        requirement = Requirement(line)
        environment = {"python_version": python, "python_full_version": f"{python}.0"}
        if requirement.marker is None or requirement.marker.evaluate(environment):
            name = canonicalize_name(requirement.name)
            assert name not in found, f"{name} is pinned twice on Python {python}"
            found[name] = requirement
    return found


def test_lines_are_names_versions_and_python_markers(project: Path) -> None:
    form = re.compile(r'[A-Za-z0-9._-]+==[A-Za-z0-9.]+( ; python_version (<|>=) "3\.\d+")?')
    assert len(lines(project)) > 60
    assert not [line for line in lines(project) if not form.fullmatch(line)]


@pytest.mark.parametrize("python", ["3.11", "3.12", "3.13"])
def test_what_the_project_asks_for_is_pinned_within_its_bounds(project: Path, python: str) -> None:
    declared = tomllib.loads((project / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    asked = [*declared["dependencies"], *(d for extra in EXTRAS for d in declared["optional-dependencies"][extra])]
    found = pins(project, python)
    for line in asked:
        requirement = Requirement(line)
        name = canonicalize_name(requirement.name)
        if name in TOOLS:
            continue
        assert name in found, f"constraints.txt lacks {name}"
        (version,) = (specifier.version for specifier in found[name].specifier)
        assert requirement.specifier.contains(version), f"{line}, but constraints.txt has {version}"


def test_every_dependency_of_a_dependency_is_pinned(project: Path) -> None:
    """Walked through the metadata of what is installed here, from the project's own list."""
    python = f"{sys.version_info[0]}.{sys.version_info[1]}"
    found = pins(project, python)
    declared = tomllib.loads((project / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    queue = [Requirement(line) for line in declared["dependencies"]]
    queue += [Requirement(line) for extra in EXTRAS for line in declared["optional-dependencies"][extra]]
    seen: set[tuple[str, frozenset[str]]] = set()
    while queue:
        requirement = queue.pop()
        key = (canonicalize_name(requirement.name), frozenset(requirement.extras))
        if key in seen or key[0] in TOOLS:
            continue
        seen.add(key)
        try:
            deeper = requires(requirement.name) or []
        except PackageNotFoundError:
            continue  # an extra that is not installed here, or a package of another platform
        assert key[0] in found, f"constraints.txt lacks {key[0]}"
        for line in deeper:
            child = Requirement(line)
            extras = requirement.extras or {""}
            if child.marker is None or any(child.marker.evaluate({"extra": extra}) for extra in extras):
                queue.append(child)
    assert len(seen) > 40
