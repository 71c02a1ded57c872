"""Build the documentation site, offline: python docs/build.py [FOLDER], by default docs/_site.

Pages of reference are written to docs/reference/ from the code, then Sphinx builds all pages; a warning is an error. Needs the
extra `docs`: pip install -e '.[docs]' -c constraints.txt
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

from pages import captures_page, citing, commands, python_api, specs  # noqa: E402

#: What a page of the site may load.
_LINK = re.compile(r"""(?:href|src)=["']([^"'#?]+)""")


def write_reference(folder: Path) -> list[Path]:
    """Write the pages that are made from the code, and the JSON Schemas beside them."""
    folder.mkdir(exist_ok=True)
    pages = {
        "commands.md": commands.page(),
        "python.md": python_api.page(),
        "captures.md": captures_page.page(),
        "estimators.md": captures_page.estimates_page(),
        "citing.md": citing.page(),
    }
    for name, (title, spec) in specs.documents().items():
        pages[f"{name}.md"] = specs.page(title, spec, name)
        pages[f"{name}.schema.json"] = json.dumps(specs.schema_of(spec), indent=1, ensure_ascii=False) + "\n"
    for name, text in pages.items():
        path = folder / name
        if not path.exists() or path.read_text(encoding="utf-8") != text:  # Sphinx reads again what is newer
            path.write_text(text, encoding="utf-8")
    return [folder / name for name in pages]


def broken_links(site: Path) -> Iterator[str]:
    """Links of the pages that lead to no file of the site, and things that a page would load from elsewhere."""
    for page in sorted(site.rglob("*.html")):
        text = page.read_text(encoding="utf-8")
        for link in set(_LINK.findall(text)):
            if re.match(r"[a-z]+:", link) or link.startswith("//"):
                if re.search(
                    rf"""<(?:script|img|link)[^>]*(?:src|href)=["']{re.escape(link)}""", text
                ) and not link.startswith("data:"):
                    yield f"{page.relative_to(site)} loads {link}"
            elif not (page.parent / link).resolve().exists():
                yield f"{page.relative_to(site)} links to {link}"


def main(out: Path) -> int:
    """Build the site; the exit code is 1 where a page has a warning or a broken link."""
    from sphinx.cmd.build import build_main

    write_reference(HERE / "reference")
    code = build_main(["-W", "--keep-going", "-q", "-b", "html", str(HERE), str(out)])
    broken = list(broken_links(out))
    print(*broken, sep="\n", file=sys.stderr) if broken else None
    print(out / "index.html")
    return 1 if code or broken else 0


if __name__ == "__main__":
    raise SystemExit(main(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "_site"))
