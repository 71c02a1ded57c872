"""Records of all estimators for people to choose from; plug-ins are imported apart."""

from __future__ import annotations

import inspect
import json
import os
import subprocess
import sys
from typing import Any

from ..scenes.errors import InputError
from .builtin import BUILTIN
from .labels import links_of
from .registry import get_estimator, list_estimators

__all__ = ["listed", "modalities_read", "modality_read", "row"]

#: Longest time for the import of a plug-in [s].
PLUGIN_IMPORT_S = 30.0


def listed() -> list[dict[str, Any]]:
    """One record per estimator: name, modality, parameters with defaults, source, origin, summary, error.

    An estimator that cannot be imported has the reason in `error`.
    """
    return [row(name) if name in BUILTIN else _row_of_plugin(name) for name in list_estimators()]


def modalities_read() -> set[str]:
    """The modalities that built-in estimators read, which imports them."""
    return {get_estimator(name).modality for name in BUILTIN}


def modality_read(name: str) -> str:
    """The modality of the captures that an estimator, or the first link of a chain, reads; a plug-in is imported in a process
    of its own. Raises InputError where that fails."""
    first = links_of(name)[0]
    if first in BUILTIN:
        return get_estimator(first).modality
    record = _row_of_plugin(first)
    if record["error"]:
        raise InputError(
            f"The plug-in cannot be imported: {record['error']}.", where=first, next_step="beambench estimators list"
        )
    return str(record["modality"])


def row(name: str, origin: str = "built-in") -> dict[str, Any]:
    """The record of an estimator, which is imported here; see `listed` for its entries."""
    try:
        found = get_estimator(name)
    except InputError as error:
        return _failed(name, origin, error.what)
    parameters = {
        key: None if parameter.default is inspect.Parameter.empty else parameter.default
        for key, parameter in inspect.signature(found.function).parameters.items()
        if parameter.kind is inspect.Parameter.KEYWORD_ONLY
    }
    return {
        "name": name,
        "modality": found.modality,
        "parameters": parameters,
        "cites": found.cites,
        "origin": origin,
        "summary": (inspect.getdoc(found.function) or "").partition("\n")[0],
        "error": "",
    }


def _failed(name: str, origin: str, why: str) -> dict[str, Any]:
    return {"name": name, "modality": "", "parameters": {}, "cites": "", "origin": origin, "summary": "", "error": why}


#: Code of the child: it prints the record on its last line, whatever the plug-in printed before.
_CHILD = (
    "import json, sys; from beambench.estimators.listing import row; "
    "print('\\n' + json.dumps(row(sys.argv[1], 'plug-in'), default=str))"
)


def _row_of_plugin(name: str) -> dict[str, Any]:
    """The record of a plug-in, which is imported in a process of its own: its code may end the process or never return."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    try:
        done = subprocess.run(
            [sys.executable, "-c", _CHILD, name], capture_output=True, text=True, stdin=subprocess.DEVNULL,
            timeout=PLUGIN_IMPORT_S, env=environment, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return _failed(name, "plug-in", f"its import did not end within {PLUGIN_IMPORT_S:g} s")
    lines = done.stdout.strip().splitlines()
    try:
        record = json.loads(lines[-1]) if lines else None
    except ValueError:
        record = None
    if done.returncode or not isinstance(record, dict):
        said = (done.stderr.strip().splitlines() or ["nothing"])[-1]
        return _failed(name, "plug-in", f"its import ended the process (exit code {done.returncode}): {said[:200]}")
    return record
