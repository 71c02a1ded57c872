"""The package that `beambench estimators new` writes: a working estimator, its entry point and its test."""

from __future__ import annotations

import keyword
import re
from pathlib import Path

from ..captures.layouts import stage_of, stages
from ..scenes.errors import InputError, reason
from .registry import list_estimators

__all__ = ["check_name", "is_package", "template_of", "templates", "write_package"]

_TEMPLATES = Path(__file__).parent / "templates"


def check_name(name: str) -> None:
    """Refuse a name that cannot be used, or that an installed estimator has. Raises InputError."""
    module = name.replace("-", "_")
    if not re.fullmatch(r"[a-z][a-z0-9]*(-[a-z0-9]+)*", name) or keyword.iskeyword(module) or len(name) > 60:
        raise InputError(
            "The name cannot be used.",
            where="name",
            value=name,
            allowed="lower-case letters, digits and single dashes, as my-median",
        )
    if name in list_estimators():
        raise InputError(
            "An estimator of this name is installed.", where="name", value=name, next_step="beambench estimators list"
        )


def templates() -> list[str]:
    """The stages that have a template, sorted."""
    return sorted(path.stem for path in _TEMPLATES.glob("*.txt"))


def template_of(stage: str | None) -> str:
    """The text of the module of an estimator of a stage, `templates/<stage>.txt`; of the first stage where none is given. Raises
    InputError for an unknown stage, or one without a template."""
    word = stage_of(next(iter(stages())) if stage is None else stage).word
    path = _TEMPLATES / f"{word}.txt"
    if not path.is_file():
        raise InputError(
            "There is no template of an estimator of this stage.", where="stage", value=word,
            allowed=", ".join(templates()),
        )  # fmt: skip
    return path.read_text(encoding="utf-8")


def write_package(folder: Path, name: str, template: str) -> None:
    """Write the package of the estimator `name` (see `check_name`) with the module `template` (see `template_of`) into `folder`.
    Raises InputError if that fails."""
    module = name.replace("-", "_")
    package = f"beambench_{module}"
    files = {
        "pyproject.toml": _PYPROJECT.format(name=name, package=package, module=module),
        f"{package}.py": template.format(name=name, module=module),
        f"test_{package}.py": _TEST.format(name=name),
        "README.md": _README.format(name=name, package=package, module=module, told=_told(template)),
    }
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for file, text in files.items():
            (folder / file).write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError("The output cannot be written there.", where=str(folder), value=reason(error)) from error


def _told(template: str) -> str:
    """What the template's first line says of the algorithm."""
    return template.partition(":")[2].partition('"""')[0].strip()


def is_package(path: Path) -> bool:
    """Whether `beambench estimators new` wrote a folder, by its pyproject.toml."""
    try:
        text = (path / "pyproject.toml").read_text(encoding="utf-8")
    except (OSError, ValueError):
        return False
    return 'name = "beambench-' in text and '[project.entry-points."beambench.estimators"]' in text


_PYPROJECT = """[build-system]
requires = ["setuptools>=77"]
build-backend = "setuptools.build_meta"

[project]
name = "beambench-{name}"
version = "0.1.0"
dependencies = ["beambench"]

[project.entry-points."beambench.estimators"]
"{name}" = "{package}:{module}"

[tool.setuptools]
py-modules = ["{package}"]
"""

_TEST = '''"""The laws that every estimator keeps."""

import beambench


def test_keeps_the_laws() -> None:
    broken = [result for result in beambench.estimators_check("{name}", compare=False).laws if not result.holds]
    assert not broken, broken
'''

_README = """# {name}

An estimator for Beambench: {told}

    pip install -e .
    beambench estimators check {name}     # the laws, its place among the others, and where it breaks first
    pytest

The algorithm is the function `{module}` in `{package}.py`: replace its body. What it gets and gives is in its docstring; `sigma` is
the standard error of each answer, and must be true: answers to other noise may not scatter by more. An element without
an answer is `valid=False`, never a guess. Beambench finds the function by the entry point in `pyproject.toml`.
"""
