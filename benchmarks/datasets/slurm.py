"""A data set as an array of Slurm jobs: a script that makes part K of N, submits itself, and has the whole completed at the end.

Jobs share nothing but the folder: shards K, K + N, … of the store are part K's, each written by one process. submitit would send
pickled functions and wait for their results; here there is neither a function to send nor a result to wait for.
"""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ...scenes.errors import InputError
from .kept import command_of

__all__ = ["array_size", "part_of", "script_text"]

#: Most tasks of an array by Slurm's default (MaxArraySize 1001, numbers from 0).
_MOST = 1000


def part_of(text: str) -> tuple[int, int]:
    """(K, N) of "K/N". Raises InputError."""
    match = re.fullmatch(r"([0-9]{1,7})/([0-9]{1,7})", text)
    if match is None or not int(match[1]) < int(match[2]):
        raise InputError("This is no part of an array.", where="--job", value=text, allowed="K/N with K = 0 … N − 1")
    return int(match[1]), int(match[2])


def array_size(asked: int | None, shards: int) -> int:
    """Tasks of the array: as many as are asked for, else one for each shard, at most 1,000. Raises InputError."""
    if asked is not None and not 1 <= asked <= 10**6:
        raise InputError("An array has at least one task.", where="--array", value=asked, allowed="1 … 1000000")
    return min(asked if asked is not None else _MOST, max(shards, 1))


def script_text(name: str, word: str, overrides: Mapping[str, Any], out: Path, tasks: int) -> str:
    """The script.

    Main arguments:
        name: of the data set. word: what names it for `beambench generate`. overrides: values of --set. out: the store.
        tasks: of the array.

    `bash FILE` submits the array and, behind it, the run that makes what is missing and completes the store; `sbatch FILE` submits
    the array alone. Submitted again, it makes what is missing.
    """
    command = shlex.join([sys.executable, "-m", "beambench", *command_of(word, overrides, out.absolute())])
    job = re.sub(r"[^A-Za-z0-9_.-]", "-", name)
    return f"""#!/bin/bash
# Makes the data set {job}: task K of the array makes shards K, K + {tasks}, … of those that are missing.
#   bash THIS_FILE     submits the array, and a job behind it that makes what is still missing and completes the store
#   sbatch THIS_FILE   submits the array alone; --resume, or `beambench data finalize`, completes the store
#SBATCH --job-name={job}
#SBATCH --array=0-{tasks - 1}
#SBATCH --cpus-per-task=1
set -euo pipefail
if [ -z "${{SLURM_ARRAY_TASK_ID:-}}" ]; then
    array=$(sbatch --parsable "$0")
    exec sbatch --dependency="afterany:${{array%%;*}}" --job-name={job}-end --wrap={shlex.quote(command + " --resume")}
fi
exec {command} --job "${{SLURM_ARRAY_TASK_ID}}/{tasks}"
"""
