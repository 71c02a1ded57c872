"""The page on citing: BibTeX entries of Beambench, the two documents and the source of every built-in estimator."""

from __future__ import annotations

from .text import table

__all__ = ["page"]


def page() -> str:
    """The page."""
    from beambench.benchmarks.report.citations import citations_of
    from beambench.estimators.builtin import BUILTIN
    from beambench.estimators.registry import get_estimator

    found = citations_of(BUILTIN)
    rows = [
        (f"`{name}`", get_estimator(name).cites, ", ".join(f"`{key}`" for key in found.keys[name]) or "–")
        for name in sorted(BUILTIN)
    ]
    return (
        "\n\n".join(
            [
                "# Citing",
                "If you publish with Beambench, cite it, and the sources of the algorithms that you compare. Every report has "
                "the entries that it needs in `report.bib`, and `report.tex` cites them. «Guo et al. 2017» and «Kusters 1992» "
                "are the two documents that are reproduced ([reproduction](../reproduction.md)); equation numbers are theirs.",
                "A DOI is given where a published list of references shows it beside the same authors, journal and page. Sources "
                "marked «not verified» could not be looked up.",
                "## Which source an estimator follows",
                table(("estimator", "source", "entries"), rows),
                "## The entries",
                f"```bibtex\n{found.bibtex}```",
            ]
        )
        + "\n"
    )
