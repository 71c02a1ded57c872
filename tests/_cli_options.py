"""The options of every command: as the command line has them, and as they were recorded on 2026-11-30.

One kind has changed since 2026-11-28: `generate --seeds` took text, of which the command made whole numbers; now it takes numbers.
`bound`, `gate`, `design`, `calibrate` and `generate --rig` are new, and so are `twin` with `--require`,
`show`, and `--compare`, `--chart` and `--overwrite` of `estimators check`.
"""

from __future__ import annotations

import types
from collections.abc import Iterator
from typing import Any, Literal, Union, get_args, get_origin

from cyclopts import App

__all__ = ["OPTIONS", "options_of"]


def _alternatives(hint: Any) -> list[Any]:
    if get_origin(hint) in (Union, types.UnionType):
        return [part for item in get_args(hint) for part in _alternatives(item)]
    return [] if hint in (None, type(None)) else [hint]


def _kind(hint: Any) -> str:
    """How a value is typed: "flag", "text", "number" or its choices; "..." behind it where it may be repeated."""
    words = []
    for part in _alternatives(hint):
        if get_origin(part) is list:
            words.append(f"{_kind(get_args(part)[0])}...")
        elif get_origin(part) is Literal:
            words.append("{" + ",".join(map(str, get_args(part))) + "}")
        else:
            words.append({bool: "flag", str: "text", int: "number", float: "number"}[part])
    return "|".join(words)


def _commands(app: App, words: tuple[str, ...] = ()) -> Iterator[tuple[str, App]]:
    if words and app.default_command is not None:
        yield " ".join(words), app
    for name in app:
        if not name.startswith("-"):
            yield from _commands(app[name], (*words, name))


def options_of(app: App) -> list[str]:
    """One line per option: command, names, kind of value, and its default or "required"."""
    lines = []
    for command, found in _commands(app):
        for argument in found.assemble_argument_collection():
            if argument.parse and not argument.children:
                given = "required" if argument.required else f"default {argument.field_info.default!r}"
                lines.append(f"{command}: {' '.join(argument.names)} <{_kind(argument.hint)}> {given}")
    return sorted(lines)


OPTIONS = """
bound: --debug <flag> default False
bound: --json <flag> default False
bound: DATA <text> required
break: --budget <number> default 300
break: --debug <flag> default False
break: --factor <number> default 3.0
break: --json <flag> default False
break: --neighbours <text...> default None
break: --out -o <text> default None
break: --overwrite <flag> default False
break: --scenes <text...> default None
break: --seed <number> default 0
break: --set <text...> default None
break: --side <number> default 24
break: NAME <text> required
calibrate: --debug <flag> default False
calibrate: --json <flag> default False
calibrate: --out -o <text> default None
calibrate: --overwrite <flag> default False
calibrate: --procedures <text...> default None
calibrate: --rig <text> default None
calibrate: DATA <text...> required
compare: --debug <flag> default False
compare: --json <flag> default False
compare: A <text> required
compare: B <text> required
completion: --shell <text> default 'bash'
data card: --debug <flag> default False
data card: --json <flag> default False
data card: --out -o <text> default None
data card: --overwrite <flag> default False
data card: DATA <text> required
data finalize: --debug <flag> default False
data finalize: --json <flag> default False
data finalize: --overwrite <flag> default False
data finalize: DATA <text> required
data repair: --debug <flag> default False
data repair: --json <flag> default False
data repair: --overwrite <flag> default False
data repair: --regenerate <flag> default False
data repair: DATA <text> required
data status: --debug <flag> default False
data status: --json <flag> default False
data status: DATA <text> required
data verify: --debug <flag> default False
data verify: --json <flag> default False
data verify: DATA <text> required
design: --allow <text...> default None
design: --budget <number> default 1.0
design: --debug <flag> default False
design: --estimator-model <{direct,exact}> default None
design: --fidelity <{direct,scatter,full,geometric,isolated,coherent}> default None
design: --json <flag> default False
design: --margin-m <number> default None
design: --out -o <text> default None
design: --overwrite <flag> default False
design: --seed <number> default 1
design: --set <text...> default None
design: SCENE <text> required
doctor: --debug <flag> default False
doctor: --json <flag> default False
drivers list: --debug <flag> default False
drivers list: --json <flag> default False
estimate: --debug <flag> default False
estimate: --estimators -e <text...> default None
estimate: --json <flag> default False
estimate: --memory-limit-bytes <number> default 8589934592
estimate: --out -o <text> default None
estimate: --overwrite <flag> default False
estimate: --resume <flag> default False
estimate: --time-limit-s <number> default 600.0
estimate: DATA <text> required
estimators check: --chart <text> default None
estimators check: --compare --no-compare <flag> default True
estimators check: --debug <flag> default False
estimators check: --json <flag> default False
estimators check: --overwrite <flag> default False
estimators check: ESTIMATOR <text> required
estimators list: --debug <flag> default False
estimators list: --json <flag> default False
estimators new: --debug <flag> default False
estimators new: --json <flag> default False
estimators new: --out -o <text> default None
estimators new: --overwrite <flag> default False
estimators new: --stage <text> default None
estimators new: NAME <text> required
estimators train: --data <text...> required
estimators train: --debug <flag> default False
estimators train: --json <flag> default False
estimators train: --out -o <text> required
estimators train: --overwrite <flag> default False
estimators train: --ridge <number> default 1e-05
estimators train: --seed <number> default 1
estimators train: --units <number> default 96
export: --debug <flag> default False
export: --json <flag> default False
export: --out -o <text> default None
export: --overwrite <flag> default False
export: --part <text> default None
export: --per-file <number> default None
export: --resume <flag> default False
export: --to <{hdf5,netcdf,exr,tiff,webdataset,croissant}> default 'hdf5'
export: --truth --no-truth <flag> default True
export: --variables <text...> default None
export: DATA <text> required
fidelity: --debug <flag> default False
fidelity: --json <flag> default False
fidelity: --modality <text> default None
fidelity: --out -o <text> default None
fidelity: --overwrite <flag> default False
fidelity: --resume <flag> default False
fidelity: --scenes <number> default 60
fidelity: --seed <number> default 1
gate: --against <text> default None
gate: --baseline <text> required
gate: --debug <flag> default False
gate: --effects <text...> default None
gate: --figures <text...> default None
gate: --history <text> default None
gate: --json <flag> default False
gate: --junit <text> default None
gate: --new <text> default None
gate: --old <text> default None
gate: --project <text> default '.'
gate: --render <flag> default False
gate: --starts <number> default 8
gate: --update <flag> default False
gate: --who <text> default None
gate: --why <text> default None
gate: --yardstick <text> default None
gate: FOLDER <text> required
generate: --array <number> default None
generate: --dask <text> default None
generate: --debug <flag> default False
generate: --fidelity <{direct,scatter,full,geometric,isolated,coherent,auto}> default None
generate: --job <text> default None
generate: --json <flag> default False
generate: --like <text> default None
generate: --out -o <text> default None
generate: --overwrite <flag> default False
generate: --plan <flag> default False
generate: --resume <flag> default False
generate: --rig <text> default None
generate: --rtol <number|{noise}> default None
generate: --sealed <text> default None
generate: --seeds <number...> default None
generate: --set <text...> default None
generate: --slurm <text> default None
generate: --time-limit-s <number> default None
generate: --truth-components <flag> default False
generate: --truth-electrons <flag> default False
generate: --truth-instances <flag> default False
generate: --workers <number> default None
generate: SOURCE <text> default None
import: --debug <flag> default False
import: --json <flag> default False
import: --map <text> default None
import: --modality <text> default ''
import: --out -o <text> default None
import: --overwrite <flag> default False
import: --scaffold <flag> default False
import: FILES <text...> required
record: --debug <flag> default False
record: --finish <flag> default False
record: --json <flag> default False
record: --out -o <text> default None
record: --overwrite <flag> default False
record: --plan <flag> default False
record: --resume <flag> default False
record: --rig <text> default None
record: --set <text...> default None
record: SOURCE <text> required
report: --debug <flag> default False
report: --json <flag> default False
report: FOLDER <text> required
reproduce: --debug <flag> default False
reproduce: --json <flag> default False
reproduce: --only <{000,001}> default None
reproduce: --out -o <text> default None
reproduce: --overwrite <flag> default False
reproduce: --pictures --no-pictures <flag> default True
run: --cache <flag> default False
run: --debug <flag> default False
run: --estimators -e <text...> default None
run: --json <flag> default False
run: --out -o <text> default None
run: --overwrite <flag> default False
run: --report --no-report <flag> default True
run: --resume <flag> default False
run: --sealed <text> default None
run: --set <text...> default None
run: --split <{dev,test}> default 'test'
run: SUITE <text> required
scenes list: --debug <flag> default False
scenes list: --json <flag> default False
scenes new: --debug <flag> default False
scenes new: --json <flag> default False
scenes new: --like <text> default 'flat-wall'
scenes new: --out -o <text> default None
scenes new: --overwrite <flag> default False
scenes new: NAME <text> required
scenes preview: --debug <flag> default False
scenes preview: --json <flag> default False
scenes preview: --out -o <text> default None
scenes preview: --overwrite <flag> default False
scenes preview: --set <text...> default None
scenes preview: --size <number> default 640
scenes preview: SCENE <text> required
scenes show: --debug <flag> default False
scenes show: --json <flag> default False
scenes show: --set <text...> default None
scenes show: SCENE <text> required
score: --debug <flag> default False
score: --failure-at <number> default None
score: --json <flag> default False
score: --out -o <text> default None
score: --overwrite <flag> default False
score: --sealed <text> default None
score: --suite <text> default None
score: DATA <text> required
score: ESTIMATES <text> required
show: --browser <flag> default False
show: --capture <number> default 0
show: --debug <flag> default False
show: --element <number> default None
show: --json <flag> default False
show: --out -o <text> default None
show: --overwrite <flag> default False
show: --terminal <flag> default False
show: DATA <text> required
suites list: --debug <flag> default False
suites list: --json <flag> default False
suites new: --debug <flag> default False
suites new: --json <flag> default False
suites new: --like <text> default 'quickstart'
suites new: --out -o <text> default None
suites new: --overwrite <flag> default False
suites new: NAME <text> required
suites show: --debug <flag> default False
suites show: --json <flag> default False
suites show: --set <text...> default None
suites show: SUITE <text> required
sweep: --budget <number> default 16
sweep: --debug <flag> default False
sweep: --depth <number> default 2
sweep: --estimators -e <text...> default None
sweep: --json <flag> default False
sweep: --out -o <text> default None
sweep: --overwrite <flag> default False
sweep: --report --no-report <flag> default True
sweep: --resume <flag> default False
sweep: --set <text...> default None
sweep: --split <{dev,test}> default 'test'
sweep: SUITE <text> required
twin: --debug <flag> default False
twin: --draws <number> default 40
twin: --estimator <text...> default None
twin: --fidelity <{direct,scatter,full,geometric,isolated,coherent}> default None
twin: --index <number> default 0
twin: --json <flag> default False
twin: --out -o <text> default None
twin: --overwrite <flag> default False
twin: --require <text...> default None
twin: --rig <text> default None
twin: --scene <text> default None
twin: --seed <number> default 1
twin: --tolerance <text...> default None
twin: REAL <text> required
""".strip().splitlines()
