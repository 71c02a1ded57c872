"""What is said of a data set whose making was interrupted: what is kept, and the command that goes on."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

__all__ = ["command_of", "kept_note"]


def command_of(word: str, overrides: Mapping[str, Any], out: Path) -> list[str]:
    """The arguments of `beambench` that make a data set: `word` names it, `overrides` are values of --set."""
    sets = [part for path, value in overrides.items() for part in ("--set", f"{path}={json.dumps(value)}")]
    return ["generate", word, *sets, "-o", str(out)]


def kept_note(source: Any, overrides: Mapping[str, Any], out: Path) -> str:
    """What is kept of a data set that was to become `out`, and how to continue; "" where nothing was begun."""
    from ...captures.store.publish import partial_of
    from ...captures.store.shard_manifest import is_sharded
    from ...captures.store.shard_receipts import list_receipts

    partial = partial_of(out)
    if not is_sharded(partial):
        return ""
    count = len(list_receipts(partial))
    kept = f"{count or 'no'} complete shard{'' if count == 1 else 's'} in {partial}"
    if not isinstance(source, str | Path):
        return f"{kept}; to continue, repeat the call with resume and the same out"
    return f"{kept}; to continue: {shlex.join(['beambench', *command_of(str(source), overrides, out), '--resume'])}"
