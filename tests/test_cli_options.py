"""No option of the command line is lost or changed, and each is the verb's own parameter."""

from __future__ import annotations

from beambench import cli

from ._cli_options import OPTIONS, options_of


def test_the_options_are_those_that_were_pinned() -> None:
    """Names, short names, kinds of values, defaults, and what is required."""
    found = options_of(cli.app)
    assert len(OPTIONS) > 100
    lost, new = sorted(set(OPTIONS) - set(found)), sorted(set(found) - set(OPTIONS))
    assert not lost and not new, "\n".join(["lost:", *lost, "new:", *new])
