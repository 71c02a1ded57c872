"""Error messages: the first argument of every `InputError` is a sentence in plain English, read from the sources."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from ._imports import files_of

#: Words that mean something else to people in the field, or nothing.
HOUSE_WORDS = (
    "told", "tell", "tells", "mine", "found", "asking", "asked", "wanted", "what is there", "none for", "beyond doubt",
    "the house", "is none",
)  # fmt: skip

#: What stands for a value in a message while it is checked. No word contains it.
VALUE = "\N{BULLET}"

#: The same for the text of another InputError, which is a sentence of its own.
SENTENCE = "\N{BLACK SQUARE}"

#: Functions that take a message, with the place and the name of that argument.
TAKES = {"InputError": (0, "what"), "record_of": (2, "missing")}

#: (file, argument): messages that are composed elsewhere, each with the reason why it is a sentence.
COMPOSED = {
    ("scenes/errors.py", "what"): "an InputError rebuilt from its own parts, in another process",
    ("scenes/records.py", "missing"): "an argument of `record_of`, whose calls are read too",
    (
        "scenes/validate.py",
        "what.get(first['type'], 'A value is not allowed.')",
    ): "one of the sentences of the table above it",
    ("scenes/validate.py", "what"): "one of the sentences of the function that raises it",
    ("estimators/registry.py", "why"): "one of the reasons in the table WITHHELD, which are sentences",
    ("captures/store/writer.py", "error.what"): "an InputError raised again, with one more next step",
    ("scenes/datasets/expressions.py", "what"): "one of the sentences of the class that raises it",
    (
        "benchmarks/datasets/crew.py",
        "words['what']",
    ): "an InputError raised again in the parent process, from its own parts",
    ("benchmarks/laws/trial.py", "**"): "an InputError raised again in the parent process, from its own parts",
}


def messages(tree: ast.AST) -> Iterator[tuple[int, str | None, str]]:
    """(line, text, source) of the message of every `InputError`; once for each text that the message can be.

    A text is None where the argument is no literal. Placeholders of f-strings become `VALUE` or `SENTENCE`.
    """
    for node in ast.walk(tree):
        called = getattr(node.func, "id", getattr(node.func, "attr", "")) if isinstance(node, ast.Call) else ""
        if not isinstance(node, ast.Call) or called not in TAKES:
            continue
        place, name = TAKES[called]
        keywords = {keyword.arg: keyword.value for keyword in node.keywords}
        argument = node.args[place] if len(node.args) > place else keywords.get(name)
        if argument is None:
            yield node.lineno, None, "**" if None in keywords else ""
            continue
        for text in texts(argument):
            yield node.lineno, text, ast.unparse(argument)


def texts(node: ast.expr) -> list[str | None]:
    """Every text that an expression can be, as far as its literals say; [None] for one without literals."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return [node.value]
    if isinstance(node, ast.IfExp):
        return [*texts(node.body), *texts(node.orelse)]
    if isinstance(node, ast.JoinedStr):
        return joined([texts(part) for part in node.values])
    if isinstance(node, ast.FormattedValue):
        inner = texts(node.value) if isinstance(node.value, ast.IfExp | ast.JoinedStr | ast.Constant) else [None]
        what = isinstance(node.value, ast.Attribute) and node.value.attr == "what"
        return [text if text is not None else SENTENCE if what else VALUE for text in inner]
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return joined([texts(node.left), texts(node.right)])
    return [None]


def joined(parts: list[list[str | None]]) -> list[str | None]:
    """Every concatenation of one text of each part."""
    whole = [""]
    for part in parts:
        whole = [left + (VALUE if right is None else right) for left in whole for right in part]
    return list(whole)


def faults(text: str) -> list[str]:
    """What is wrong with a message."""
    wrong = []
    if not re.match(rf"[A-Z`{VALUE}]", text):
        wrong.append("does not begin with a capital letter")
    if not text.endswith((".", SENTENCE)):
        wrong.append("does not end with a full stop")
    if text.endswith(".."):
        wrong.append("ends with two full stops")
    wrong += [f"says {word!r}" for word in HOUSE_WORDS if re.search(rf"\b{word}\b", text, re.IGNORECASE)]
    return wrong


def breaches(file: str, source: str) -> list[str]:
    """Messages of one file that are no sentences, or that no literal states."""
    wrong = []
    for line, text, argument in messages(ast.parse(source)):
        if text is None:
            if (file, argument) not in COMPOSED:
                wrong.append(f"{file}:{line} the message is not a literal: {argument}")
        else:
            wrong += [f"{file}:{line} {fault}: {text}" for fault in faults(text)]
    return wrong


def test_every_message_is_a_sentence_in_plain_english(project: Path) -> None:
    wrong, seen, composed = [], 0, set()
    for path in files_of(project).values():
        file, source = path.relative_to(project).as_posix(), path.read_text(encoding="utf-8")
        wrong += breaches(file, source)
        for _, text, argument in messages(ast.parse(source)):
            seen += text is not None
            composed |= {(file, argument)} if text is None else set()
    assert not wrong, "\n".join(wrong)
    assert seen > 300, "the reader of messages reads next to none: it is broken"
    assert composed == set(COMPOSED), "a message is listed as composed, and no longer is"


@pytest.mark.parametrize(
    ("source", "fault"),
    [
        ('InputError("the capture lacks counts.", where="x")', "capital letter"),
        ('InputError("--resume needs a folder.")', "capital letter"),
        ('InputError(f"{name} is empty")', "full stop"),
        ('InputError("The file " f"{name}")', "full stop"),
        ('InputError(f"The stress does not fit: {error.where}")', "full stop"),
        ('InputError("A sentence." if early else "no sentence.")', "capital letter"),
        ('InputError(f"A file" + (f", and {n} more" if n else "."))', "full stop"),
        ('InputError(f\'The size is {"known." if n else "unknown"}\')', "full stop"),
        ('errors.InputError(what="No end")', "full stop"),
        ('InputError("The capture does not tell its scene.")', "'tell'"),
        ('InputError("What is there is not a store.")', "'what is there'"),
        ('InputError("The end..")', "two full stops"),
        ('record_of(LAYOUTS, modality, "no such modality.", where)', "capital letter"),
        ("InputError(message)", "not a literal"),
        ("InputError(**parts)", "not a literal"),
    ],
)
def test_a_breach_is_reported(source: str, fault: str) -> None:
    (reported,) = breaches("floor/file.py", f"raise {source}\n")
    assert fault in reported


@pytest.mark.parametrize(
    "source",
    [
        'InputError("The capture lacks counts.", where="told", next_step="tell it")',
        'InputError(f"{wanted} must be finite.")',
        'InputError("`steger` is a word, not a label.")',
        'InputError(f"The stress does not fit: {error.what}")',
        'InputError(f"A file cannot be read: {first}" + (f", and {n} more." if n else "."))',
        'ValueError("the width must be positive")',
    ],
)
def test_what_is_right_is_not_reported(source: str) -> None:
    assert breaches("floor/file.py", f"raise {source}\n") == []
