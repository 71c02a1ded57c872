"""A document of headings, paragraphs, tables and figures, as Markdown with files beside it and as one HTML page without network."""

from __future__ import annotations

import base64
import re
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from ...scenes.plain_text import plain_text

__all__ = ["Block", "Figure", "Figures", "Heading", "Paragraph", "Table", "as_html", "as_markdown"]


@dataclass(frozen=True)
class Heading:
    """A heading of level 1 or 2."""

    text: str
    level: int = 2


@dataclass(frozen=True)
class Paragraph:
    """Plain text; `strong` marks a result."""

    text: str
    strong: bool = False


@dataclass(frozen=True)
class Table:
    """Rows of plain text."""

    head: tuple[str, ...]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True)
class Figure:
    """A picture: name of its file, content (SVG or PNG), and a caption. `pixelated`: few pixels, shown large."""

    file: str
    content: bytes
    caption: str
    pixelated: bool = False


@dataclass(frozen=True)
class Figures:
    """Pictures side by side."""

    items: Sequence[Figure]


Block = Heading | Paragraph | Table | Figures
#: What Markdown or HTML in it could take for markup.
_MARKUP = re.compile(r"([\\`*_{}\[\]<>#|!~&])")

_STYLE = """body{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;color:#0f172a;background:#fff}
h1{font-size:1.6rem}h2{font-size:1.2rem;margin-top:2rem;border-bottom:1px solid #cbd5e1}
table{border-collapse:collapse;margin:.8rem 0;display:block;overflow-x:auto}th,td{border:1px solid #cbd5e1;padding:.25rem .6rem;
text-align:left;vertical-align:top;overflow-wrap:anywhere}th{background:#f1f5f9}.figures{display:flex;flex-wrap:wrap;gap:1rem}
figure{margin:0;max-width:100%}figcaption{font-size:.85rem;color:#334155;max-width:26rem}img{max-width:100%;height:auto}
img.pixels{image-rendering:pixelated;width:200px;border:1px solid #cbd5e1}"""


def _md(text: str) -> str:
    return _MARKUP.sub(r"\\\1", plain_text(text)).replace("\n", " ")


def as_markdown(blocks: Sequence[Block], folder: str) -> str:
    """The document as Markdown; the files of its pictures lie in `folder`."""
    lines: list[str] = []
    for block in blocks:
        if isinstance(block, Heading):
            lines += ["#" * block.level + " " + _md(block.text), ""]
        elif isinstance(block, Paragraph):
            lines += [f"**{_md(block.text)}**" if block.strong else _md(block.text), ""]
        elif isinstance(block, Table):
            lines += ["| " + " | ".join(map(_md, block.head)) + " |", "|" + "---|" * len(block.head)]
            lines += ["| " + " | ".join(map(_md, row)) + " |" for row in block.rows]
            lines.append("")
        else:
            for one in block.items:
                lines += [f"![{_md(one.caption)}]({folder}/{one.file})", "", _md(one.caption), ""]
    return "\n".join(lines)


def as_html(title: str, blocks: Sequence[Block]) -> str:
    """The document as one page: pictures are in it, no script, nothing is loaded."""
    body: list[str] = []
    for block in blocks:
        if isinstance(block, Heading):
            body.append(f"<h{block.level}>{_html(block.text)}</h{block.level}>")
        elif isinstance(block, Paragraph):
            text = _html(block.text)
            body.append(f"<p><strong>{text}</strong></p>" if block.strong else f"<p>{text}</p>")
        elif isinstance(block, Table):
            head = "".join(f"<th scope=col>{_html(cell)}</th>" for cell in block.head)
            rows = "".join("<tr>" + "".join(f"<td>{_html(cell)}</td>" for cell in row) + "</tr>" for row in block.rows)
            body.append(f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>")
        else:
            body.append(f'<div class="figures">{"".join(map(_figure, block.items))}</div>')
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
        "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; img-src data:; style-src 'unsafe-inline'\">"
        f"<title>{_html(title)}</title><style>{_STYLE}</style></head>\n<body><main>\n"
        + "\n".join(body)
        + "\n</main></body></html>\n"
    )


def _html(text: str) -> str:
    return escape(plain_text(text))


def _figure(one: Figure) -> str:
    kind = "svg+xml" if one.file.endswith(".svg") else "png"
    data = base64.b64encode(one.content).decode("ascii")
    style = ' class="pixels"' if one.pixelated else ""
    caption = _html(one.caption)
    return f'<figure><img{style} alt="{caption}" src="data:image/{kind};base64,{data}"><figcaption>{caption}</figcaption></figure>'
