"""Run tutorials top to bottom and keep their figures: python docs/tutorials/run.py [NAME …], by default all.

A tutorial is a page of this folder. Its blocks of Python are one program, which is run in an empty folder and writes figure.png.
"""

from __future__ import annotations

import os
import re
import shutil
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
#: A package that a tutorial installs: pip install -e docs/training-project
EXAMPLE = HERE.parent / "training-project"


def names() -> list[str]:
    """The tutorials."""
    return sorted(path.stem for path in HERE.glob("*.md") if path.stem != "index")


def program_of(name: str) -> str:
    """The program of a tutorial, each line where it stands on the page, so that an error tells the page's line."""
    lines = []
    inside = False
    for line in (HERE / f"{name}.md").read_text(encoding="utf-8").splitlines():
        fence = re.match(r"```(\w*)", line)
        lines.append(line if inside and not fence else "")
        if fence:
            inside = not inside and fence[1] == "python"
    return "\n".join(lines) + "\n"


def execute(name: str, folder: Path) -> Path:
    """Run a tutorial in a folder; returns its figure. Raises AssertionError where something is not as the page says."""
    before, arguments = Path.cwd(), sys.argv
    os.chdir(folder)
    sys.path.insert(0, str(EXAMPLE))
    try:
        exec(compile(program_of(name), str(HERE / f"{name}.md"), "exec"), {"__name__": "tutorial"})
    finally:
        os.chdir(before)
        sys.path.remove(str(EXAMPLE))
        sys.argv = arguments
    return folder / "figure.png"


def main(chosen: list[str]) -> None:
    """Run the tutorials, and put their figures beside them."""
    for name in chosen or names():
        begun = time.process_time()
        with tempfile.TemporaryDirectory() as folder:
            shutil.copy(execute(name, Path(folder)), HERE / f"{name}.png")
        print(f"{name}: {time.process_time() - begun:.0f} s of CPU time in this process")


if __name__ == "__main__":
    main(sys.argv[1:])
