"""The page's results for a paper: Markdown, and LaTeX with the BibTeX entries of the estimators."""

from __future__ import annotations

from pathlib import Path

from ..folders.files import write_text
from .cell import Cell, common_noun
from .charts import panel_title, panels_of
from .citations import OWN_KEY, citations_of, latex
from .data import unit_scale
from .numbers import number, rate, span, time_text
from .table_csv import table_csv

__all__ = ["EXPORTS", "write_exports"]

#: Files beside report.html.
EXPORTS = ("report.csv", "report.md", "report.tex", "report.bib")
_HEAD = ("Estimator", "Condition", "RMSE", "Bound", "Efficiency", "Coverage", "CPU time")


def write_exports(
    folder: Path, *, title: str, sentences: list[str], base: list[Cell], shown: list[Cell], command: str
) -> None:
    """Write report.csv (all cells of the page's table), report.md, report.tex and report.bib (unstressed cells).

    Main arguments:
        title, sentences: heading and verdict of the page. base: unstressed cells. shown: all, as the page orders them.
        command: what repeats the run.
    """
    found = citations_of(cell.label for cell in base)
    write_text(folder / "report.csv", table_csv(shown))
    write_text(folder / "report.md", _markdown(title, sentences, base, command))
    write_text(folder / "report.tex", _latex(title, base, found.keys, found.without))
    write_text(folder / "report.bib", found.bibtex)


def _figures(cell: Cell) -> list[str]:
    """The cells of one row, without the estimator's name."""
    factor, unit = unit_scale(cell)
    if not cell.ok:
        return [cell.condition, cell.status.partition(":")[0], "", "", "", ""]
    return [
        cell.condition,
        f"{number(cell.rmse_full * factor)}{span(cell.error_lo * factor, cell.error_hi * factor)} {unit}",
        f"{number(cell.bound * factor)} {unit}" if cell.bound > 0 else "–",
        number(cell.efficiency),
        rate(cell.coverage),
        time_text(cell.cpu_per_element_s),
    ]


def _tables(base: list[Cell]) -> list[tuple[str, list[Cell]]]:
    """Panels as (title, cells), each from the smallest error to the largest, those without a result last."""
    panels = panels_of(base)
    return [
        (panel_title(panel, panels), sorted(group, key=lambda c: (not c.ok, c.condition != "matched", c.rmse_full)))
        for panel, group in panels.items()
    ]


def _markdown(title: str, sentences: list[str], base: list[Cell], command: str) -> str:
    def safe(text: str) -> str:
        return text.replace("\\", "\\\\").replace("|", "\\|").replace("<", "&lt;").replace("\n", " ")

    lines = [f"# {safe(title)}", "", safe(" ".join(sentences)), "", "![speed against accuracy](speed-accuracy.png)", ""]
    for name, cells in _tables(base):
        noun = common_noun(cells)
        lines += [f"## {safe(name)}", "", f"RMSE of all {noun}s with its 95 % interval; CPU time per {noun}.", ""]
        lines += ["| " + " | ".join(_HEAD) + " |", "|" + "---|" * len(_HEAD)]
        lines += ["| " + " | ".join(safe(text) for text in (c.label, *_figures(c))) + " |" for c in cells]
        lines.append("")
    lines += ["Repeat it:", "", f"    {command}", ""]
    return "\n".join(lines)


def _latex(title: str, base: list[Cell], keys: dict[str, list[str]], without: list[str]) -> str:
    lines = [
        "% Made by `beambench report`. \\usepackage{booktabs, textcomp}; \\bibliography{report}",
        *(f"% No source is known here of {latex(label)}." for label in without),
    ]
    for name, cells in _tables(base):
        noun = common_noun(cells)
        lines += [
            "\\begin{table}", "  \\centering",
            f"  \\caption{{{latex(title)}, {latex(name)}: RMSE of all {noun}s with its 95\\,\\% interval, and CPU time "
            f"per {noun}. Made with Beambench~\\cite{{{OWN_KEY}}}.}}",
            "  \\begin{tabular}{llrrrrr}", "    \\toprule",
            "    " + " & ".join(_HEAD) + " \\\\", "    \\midrule",
        ]  # fmt: skip
        for cell in cells:
            cite = f"~\\cite{{{','.join(keys[cell.label])}}}" if keys.get(cell.label) else ""
            lines.append("    " + " & ".join([latex(cell.label) + cite, *map(latex, _figures(cell))]) + " \\\\")
        lines += ["    \\bottomrule", "  \\end{tabular}", "\\end{table}", ""]
    return "\n".join(lines)
