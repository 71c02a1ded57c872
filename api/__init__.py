"""Beambench: captures of active optical sensors with exact truth, and the benchmark of the algorithms that read them.

One function per command, with the command's name and arguments; `beambench scenes list` is `scenes_list`, and `--set
PATH=VALUE` is `overrides={path: value}`. Everything is imported when it is first used.

    import beambench
    folder = beambench.run("quickstart")
    scores = beambench.score("captures.zarr", "estimates")
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .scenes.errors import InputError
    from .verb_break import break_
    from .verb_compare import compare
    from .verb_data import data_finalize, data_repair, data_status, data_verify
    from .verb_doctor import doctor
    from .verb_estimate import estimate
    from .verb_estimators import estimators_check, estimators_list, estimators_new, estimators_train
    from .verb_export import export
    from .verb_fidelity import fidelity
    from .verb_generate import generate
    from .verb_report import report
    from .verb_reproduce import reproduce
    from .verb_run import run
    from .verb_scenes import scenes_list, scenes_preview, scenes_show
    from .verb_score import score
    from .verb_sweep import sweep

    __version__: str

__all__ = [
    "InputError",
    "__version__",
    "break_",
    "compare",
    "data_finalize",
    "data_repair",
    "data_status",
    "data_verify",
    "doctor",
    "estimate",
    "estimators_check",
    "estimators_list",
    "estimators_new",
    "estimators_train",
    "export",
    "fidelity",
    "generate",
    "report",
    "reproduce",
    "run",
    "scenes_list",
    "scenes_preview",
    "scenes_show",
    "score",
    "sweep",
]

_HOME = {
    "InputError": ".scenes.errors",
    "break_": ".verb_break",
    "compare": ".verb_compare",
    "data_finalize": ".verb_data",
    "data_repair": ".verb_data",
    "data_status": ".verb_data",
    "data_verify": ".verb_data",
    "doctor": ".verb_doctor",
    "estimate": ".verb_estimate",
    "estimators_check": ".verb_estimators",
    "estimators_list": ".verb_estimators",
    "estimators_new": ".verb_estimators",
    "estimators_train": ".verb_estimators",
    "export": ".verb_export",
    "fidelity": ".verb_fidelity",
    "generate": ".verb_generate",
    "report": ".verb_report",
    "reproduce": ".verb_reproduce",
    "run": ".verb_run",
    "scenes_list": ".verb_scenes",
    "scenes_preview": ".verb_scenes",
    "scenes_show": ".verb_scenes",
    "score": ".verb_score",
    "sweep": ".verb_sweep",
}
#: Sub-packages, imported on first use as well: `beambench.scenes.load_scene`.
_ROOMS = ("benchmarks", "captures", "estimators", "generator", "optics", "scenes")


def __getattr__(name: str) -> Any:
    from importlib import import_module

    if name == "__version__":
        from importlib.metadata import version

        value: Any = version("beambench")
    elif name in _HOME:
        value = getattr(import_module(_HOME[name], __name__), name)
    elif name in _ROOMS:
        return import_module(f".{name}", __name__)
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, *_ROOMS})
