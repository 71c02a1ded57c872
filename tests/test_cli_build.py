"""Commands are built from verbs: types, names and help come from signatures and docstrings."""

from __future__ import annotations

import inspect
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import pytest

import beambench
from beambench import cli
from beambench.commands.docstring import arguments_of, for_command_line, text_of
from beambench.commands.signature import options_of, signature_for

if TYPE_CHECKING:
    from beambench.scenes.scene import Scene

from .test_cli_usage import COMMANDS


def toy(
    source: str | Path | Mapping[str, Any] | Scene | None = None,
    names: Sequence[str] = (),
    *,
    overrides: Mapping[str, Any] | None = None,
    seeds: Sequence[int] | None = None,
    rtol: float | Literal["noise"] | None = None,
    count: int = 3,
    pictures: bool = True,
    quiet: bool = False,
    progress: object = None,
) -> None:
    """Do what a toy does,
    in two lines.

    More about `out` and `rtol`.

    Main arguments:
        source: A scene.
        names: A name.
    Other arguments:
        seeds, count: Numbers
            below `rtol`.
        rtol: An error.
        pictures: Draw: all of them.
        quiet: Say nothing.

    Returns:
        nothing: at all.
    """


def test_text_and_arguments_of_a_docstring() -> None:
    doc = inspect.getdoc(toy) or ""
    assert text_of(doc) == "Do what a toy does, in two lines.\n\nMore about `out` and `rtol`."
    told = arguments_of(doc)
    assert set(told) == {"source", "names", "seeds", "count", "rtol", "pictures", "quiet"}
    assert told["seeds"] == told["count"] == "Numbers below `rtol`." and told["pictures"] == "Draw: all of them."
    assert for_command_line("`rtol` of `source`", {"rtol": "--rtol"}) == "--rtol of `source`"


def test_a_signature_becomes_options() -> None:
    assert options_of(toy, ("names",)) == {
        "names": "--names", "overrides": "--set", "seeds": "--seeds", "rtol": "--rtol", "count": "--count",
        "pictures": "--pictures", "quiet": "--quiet",
    }  # fmt: skip
    built = signature_for(toy, ("names",)).parameters
    assert list(built) == ["source", "names", "overrides", "seeds", "rtol", "count", "pictures", "quiet", "common"]
    hints = {name: get_args(one.annotation)[0] for name, one in built.items() if name != "common"}
    assert hints == {
        "source": str | None, "names": list[str] | None, "overrides": list[str] | None, "seeds": list[int] | None,
        "rtol": float | Literal["noise"] | None, "count": int, "pictures": bool, "quiet": bool,
    }  # fmt: skip
    assert built["source"].kind is inspect.Parameter.POSITIONAL_ONLY
    assert built["names"].kind is inspect.Parameter.KEYWORD_ONLY and built["names"].default is None
    settings = get_args(built["seeds"].annotation)[1]
    assert settings.help == "Numbers below --rtol. Repeatable." and settings.converter is not None
    assert get_args(built["quiet"].annotation)[1].negative == ()


def test_an_argument_without_a_description_is_refused() -> None:
    def silent(source: str) -> None:
        """Do something."""

    with pytest.raises(KeyError, match="source"):
        signature_for(silent)


def _command(words: str) -> Any:
    app = cli.app
    for word in words.split():
        app = app[word]
    return app.default_command


@pytest.mark.parametrize("words", COMMANDS)
def test_help_is_the_docstring_of_the_verb(words: str) -> None:
    """Every option has help that ends as a sentence, and each command begins with the verb's own first paragraph."""
    name = words.replace(" ", "_")
    verb = getattr(beambench, "break_" if name == "break" else name)
    command = _command(words)
    first = text_of(verb.__doc__).partition("\n\n")[0]
    assert first.endswith(".") and str(command.__doc__).startswith(first.split("`")[0])
    parameters = inspect.signature(command).parameters
    for one in parameters.values():
        if one.name != "common":
            text = get_args(one.annotation)[1].help
            assert text[0].isupper() and text.endswith("."), (one.name, text)


def test_a_typed_command_loads_no_other_verb() -> None:
    code = (
        "import sys; from beambench.cli import main; main(['scenes', 'list', '--help'])\n"
        "print('VERBS', sorted(name for name in sys.modules if name.startswith('beambench.verbs.')))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.strip().endswith("VERBS ['beambench.verbs.scenes']")


def test_what_is_typed_reaches_the_verb(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """--set arrives as `overrides`, an option that was not given has the verb's default."""
    _command("scenes preview")
    seen: list[dict[str, Any]] = []

    def preview(**given: Any) -> dict[str, Any]:
        seen.append(given)
        return {"file": "x.png"}

    monkeypatch.setattr("beambench.verbs.scenes.scenes_preview", preview)
    assert cli.main(["scenes", "preview", "step", "--set", "a.b=[1, 2]", "--set", "c=x", "--json"]) == 0
    assert seen == [{"scene": "step", "overrides": {"a.b": [1, 2], "c": "x"}, "size": 640, "overwrite": False}]
    assert capsys.readouterr().out.split() == ["{", '"file":', '"x.png"', "}"]
