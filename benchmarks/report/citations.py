"""BibTeX entries of the sources that the estimators of a run cite."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from ...estimators.builtin import BUILTIN
from ...estimators.labels import links_of, split_label
from .sources import PRODUCT, source_of

__all__ = ["OWN_KEY", "Citations", "citations_of", "latex", "product_entry"]

#: Key of the entry of Beambench itself.
OWN_KEY = "beambench"

#: A year; after a colon stands a page.
_YEAR = re.compile(r"(?<![:\d])\b(1[6-9]\d\d|20\d\d)\b")
_SPECIAL = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "–": "--", "−": "$-$", "×": r"$\times$", "±": r"$\pm$",
    "µ": r"\textmu{}", "²": r"$^2$", "³": r"$^3$", "°": r"$^\circ$", "<": "$<$", ">": "$>$", "σ": r"$\sigma$",
}  # fmt: skip


class Citations(NamedTuple):
    """`bibtex`: text of the entries. `keys`: of each label. `without`: labels whose source is not known here."""

    bibtex: str
    keys: dict[str, list[str]]
    without: list[str]


def latex(text: str) -> str:
    """Text in which characters that LaTeX reads as commands are escaped."""
    return "".join(_SPECIAL.get(character, character) for character in text)


def citations_of(labels: Iterable[str]) -> Citations:
    """Entries of the built-in estimators among `labels`, and of the links of chains.

    The first entry is Beambench itself. The source is the text `cites` of an estimator; parts between semicolons are sources
    of their own, and remarks (which formula, what for) are left out. A source that was looked up (`sources`) has its title,
    journal and DOI; any other is @misc, with the authors and the year as far as the text tells them, and the whole reference
    as `note`, since it names journal and volume in free form. Plug-ins are not imported, since a page may be made from a
    stranger's table.
    """
    keys: dict[str, list[str]] = {}
    entries: dict[str, str] = {}  # text -> key
    without = []
    for label in sorted(set(labels)):
        texts = [part for link in links_of(split_label(label)[0]) for part in _sources(link)]
        if not texts:
            without.append(label)
        for text in texts:
            entries.setdefault(text, _new_key(text, set(entries.values())))
        keys[label] = list(dict.fromkeys(entries[text] for text in texts))
    ordered = sorted(entries.items(), key=lambda item: item[1])
    return Citations("\n".join([product_entry(), *(_entry(key, text) for text, key in ordered)]), keys, without)


def product_entry() -> str:
    """The entry of Beambench, in the version that is installed."""
    from importlib.metadata import version

    return _written("misc", OWN_KEY, {**PRODUCT, "howpublished": f"Software, version {latex(version('beambench'))}"})


def _sources(name: str) -> list[str]:
    if name not in BUILTIN:
        return []
    from ...estimators.registry import get_estimator

    # A semicolon inside parentheses separates remarks, not sources.
    parts = re.split(r";\s*(?![^(]*\))", get_estimator(name).cites)
    doubt = " (not verified)"
    return [
        reference + doubt * ("not verified" in part) for part in parts if (reference := _reference(part))
    ]  # who copies an entry learns that nobody looked it up


def _reference(text: str) -> str:
    """The reference without remarks: a topic before a colon, parentheses, and the place in the source."""
    plain = re.sub(r"\s*\([^()]*[^()\d:][^()]*\)", "", text).strip()  # an issue, "43(24)", is no remark
    topic, _, rest = plain.partition(": ")
    if rest and not re.search(r"[\d,]", topic):
        plain = rest
    cut = re.split(r",? (?:Eq\.|sec\.|section|Figure|Fig\.|chapter|Table)\s", plain)[0]
    whole = re.sub(r"^(.*(?<![:\d])\b(?:1[6-9]|20)\d\d)(?:, (?!p\.)|: ).*$", r"\1", cut).strip(" ,")
    return whole if _YEAR.search(whole) else ""  # "this project", "the lidar equation": nothing to look up


def _authors(text: str) -> str:
    """Authors as BibTeX joins them: "Turin", "A and B", "A and others"; "" where the text does not begin with a name."""
    before = text.split("(")[0]
    head: list[str] = []
    for part in before.split(", ")[:5]:
        words = _YEAR.sub("", part).strip()
        if re.search(r"\d", words) or not words:
            break
        head.append(words)
        if " and " in words or "et al" in words:
            break
    else:
        head = head[:1]
    if not any(" and " in part or "et al" in part for part in head):
        head = head[:1]
    if len(head) == 1:
        head = [_YEAR.split(head[0])[0].strip()]
    names = " and ".join(head).replace(" et al.", " and others").replace(" et al", " and others")
    return names if re.match(r"[^\W\d_]", names) else ""


def _new_key(text: str, taken: set[str]) -> str:
    first = re.split(r",| and ", _authors(text) or text)[0].split()[-1]
    plain = unicodedata.normalize("NFKD", first).encode("ascii", "ignore").decode()
    year = _YEAR.findall(text.split("(")[0]) or _YEAR.findall(text)
    stem = (re.sub(r"[^a-z0-9]", "", plain.lower()) or "source") + (year[-1] if year else "")
    return next(key for key in (stem, *(f"{stem}{c}" for c in _suffixes())) if key not in taken)


def _suffixes() -> Iterable[str]:
    return (a + b for a in ["", *"abcdefghijklmnopqrstuvwxyz"] for b in "abcdefghijklmnopqrstuvwxyz")


def _entry(key: str, text: str) -> str:
    year = _YEAR.findall(text.split("(")[0]) or _YEAR.findall(text)
    fields = {"author": latex(_authors(text)), "year": year[-1] if year else ""}
    known = dict(source_of(text))
    if not known:
        return _written("misc", key, fields | {"note": latex(text)})
    entry = known.pop("entry", "article")
    return _written(entry, key, {"author": fields["author"], **known, "year": fields["year"]})


def _written(entry: str, key: str, fields: Mapping[str, str]) -> str:
    lines = [f"  {'type' if name == 'kind' else name:6} = {{{value}}}," for name, value in fields.items() if value]
    return "\n".join([f"@{entry}{{{key},", *lines, "}", ""])
