"""The project's documents: decisions are numbered and dated, CI runs the command of the README, versions agree."""

from __future__ import annotations

import os
import re
import tomllib
from pathlib import Path


def test_decisions_are_numbered_and_dated(project: Path) -> None:
    names = sorted(path.name for path in (project / "docs" / "decisions").iterdir())
    form = re.compile(r"(\d{4})-(20\d\d)-(\d\d)-(\d\d)-[a-z0-9-]+\.md")
    matches = [form.fullmatch(name) for name in names]
    assert all(matches), [name for name, match in zip(names, matches, strict=True) if not match]
    assert [int(match[1]) for match in matches if match] == list(range(1, len(names) + 1))
    for path in (project / "docs" / "decisions").iterdir():
        text = path.read_text(encoding="utf-8")
        assert all(part in text for part in ("**Context.**", "**Decision.**", "**Consequences.**")), path.name


def test_ci_runs_the_readmes_test_command(project: Path) -> None:
    """The README names two commands: the first shows the quickstart, the second tests; CI takes the second as it is."""
    script = project / ".ci" / "run"
    assert os.access(script, os.X_OK)
    assert "set -euo pipefail" in script.read_text(encoding="utf-8")
    readme = (project / "README.md").read_text(encoding="utf-8")
    commands = [line.strip().removeprefix("$ ") for line in readme.splitlines()]
    commands = [line for line in commands if line.startswith("pip install ")]
    assert commands[0] == "pip install -e . -c constraints.txt && beambench run quickstart"
    assert commands[1] == "pip install -e '.[test]' -c constraints.txt && pytest"
    assert "virtual environment" in readme[: readme.index(commands[0])]


def test_versions_agree(project: Path) -> None:
    declared = tomllib.loads((project / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    cited = (project / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\nversion: {declared['version']}\n" in cited
    assert f"\nlicense: {declared['license']}\n" in cited
    assert declared["version"] in (project / "CHANGELOG.md").read_text(encoding="utf-8")
