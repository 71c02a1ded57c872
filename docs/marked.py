"""Tables of a page that scripts write, between the comments `table:NAME` and `end:NAME`."""

from __future__ import annotations

from pathlib import Path


def write_tables(page: Path, tables: dict[str, str]) -> None:
    """Replace the text between the marks of each table. Raises ValueError, and writes nothing, where a mark is missing."""
    text = page.read_text(encoding="utf-8")
    for name, table in tables.items():
        begin, end = f"<!-- table:{name} -->\n", f"<!-- end:{name} -->"
        if text.count(begin) != 1 or text.count(end) != 1:
            raise ValueError(f"{page.name} has no single pair of marks {begin.strip()} and {end}")
        before, _, rest = text.partition(begin)
        text = f"{before}{begin}{table}\n{end}{rest.partition(end)[2]}"
    page.write_text(text, encoding="utf-8")
