"""The pages by user can be followed: whatever a line reads was there before, or was made by a line above it."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest

PAGES = (
    "start.md",
    "guides/author.md",
    "guides/engineer.md",
    "guides/lab.md",
    "guides/researcher.md",
    "guides/trainer.md",
)
#: What a reader brings along: the page says so.
OWN = {"scan.tif", "mapping.toml"}
#: Options that name what is written.
WRITES = ("-o", "--out")
_FILE = re.compile(r"(?!\d)[\w./-]+\.(?:zarr|toml|json|h5|tif|key)")


def lines(text: str) -> Iterator[list[str]]:
    """The words of each command of a page, in order."""
    for line in re.findall(r"^    (.+)$", re.sub(r"```.*?```", "", text, flags=re.S), re.M):
        for part in line.split(" && "):
            if re.match(r"(beambench|pip) ", part):
                yield shlex.split(part, comments=True)


def missing(text: str, there: set[str]) -> list[str]:
    """What the commands of a page read that is not `there` and that no line above has made."""
    made, wrong = set(there), []
    for words in lines(text):
        reads, writes = set(), set()
        for before, word in pairwise(words):
            if before in WRITES or (before == "--baseline" and "--update" in words):
                writes.add(word)
            elif _FILE.fullmatch(word) or (before == "-e" and words[:2] == ["pip", "install"]):
                reads.add(word)
        if words[:1] == ["beambench"] and words[1] in ("score", "compare", "gate"):
            reads |= {word for word in words[2:4] if not word.startswith("-")}
        if words[1:3] in (["scenes", "new"], ["suites", "new"]) and not writes:
            writes.add(f"{words[3]}.toml")
        wrong += [f"{' '.join(words)}: {name}" for name in sorted(reads - made - writes)]
        made |= writes
    return wrong


@pytest.mark.parametrize("page", PAGES)
def test_each_name_was_made_before(project: Path, page: str) -> None:
    text = (project / "docs" / page).read_text(encoding="utf-8")
    assert len(list(lines(text))) > 2
    there = {".", ".[test]", *OWN}
    named = {word for words in lines(text) for word in words if (project / word).is_file()}
    assert missing(text, there | named) == []


def test_a_name_that_no_line_makes_is_found() -> None:
    page = (
        "    beambench estimators new mine --stage gated\n    pip install -e mine\n    beambench compare first second\n"
    )
    assert missing(page, set()) == [
        "pip install -e mine: mine",
        "beambench compare first second: first",
        "beambench compare first second: second",
    ]
    assert (
        missing("    beambench suites new s\n    beambench run s.toml -o a\n    beambench compare a a\n", set()) == []
    )
