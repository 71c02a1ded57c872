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
    from .verbs.bound import bound
    from .verbs.break_ import break_
    from .verbs.calibrate import calibrate
    from .verbs.compare import compare
    from .verbs.data import data_card, data_finalize, data_repair, data_status, data_verify
    from .verbs.design import design
    from .verbs.doctor import doctor
    from .verbs.drivers import drivers_list
    from .verbs.estimate import estimate
    from .verbs.estimators import estimators_check, estimators_list, estimators_new, estimators_train
    from .verbs.export import export
    from .verbs.fidelity import fidelity
    from .verbs.gate import gate
    from .verbs.generate import generate
    from .verbs.import_ import import_
    from .verbs.record import record
    from .verbs.report import report
    from .verbs.reproduce import reproduce
    from .verbs.run import run
    from .verbs.scenes import scenes_list, scenes_new, scenes_preview, scenes_show
    from .verbs.score import score
    from .verbs.show import show
    from .verbs.suites import suites_list, suites_new, suites_show
    from .verbs.sweep import sweep
    from .verbs.twin import twin

    __version__: str

__all__ = [
    "InputError",
    "__version__",
    "bound",
    "break_",
    "calibrate",
    "compare",
    "data_card",
    "data_finalize",
    "data_repair",
    "data_status",
    "data_verify",
    "design",
    "doctor",
    "drivers_list",
    "estimate",
    "estimators_check",
    "estimators_list",
    "estimators_new",
    "estimators_train",
    "export",
    "fidelity",
    "gate",
    "generate",
    "import_",
    "record",
    "report",
    "reproduce",
    "run",
    "scenes_list",
    "scenes_new",
    "scenes_preview",
    "scenes_show",
    "score",
    "show",
    "suites_list",
    "suites_new",
    "suites_show",
    "sweep",
    "twin",
]

_HOME = {
    "InputError": ".scenes.errors",
    "bound": ".verbs.bound",
    "break_": ".verbs.break_",
    "calibrate": ".verbs.calibrate",
    "compare": ".verbs.compare",
    "data_card": ".verbs.data",
    "data_finalize": ".verbs.data",
    "data_repair": ".verbs.data",
    "data_status": ".verbs.data",
    "data_verify": ".verbs.data",
    "design": ".verbs.design",
    "doctor": ".verbs.doctor",
    "drivers_list": ".verbs.drivers",
    "estimate": ".verbs.estimate",
    "estimators_check": ".verbs.estimators",
    "estimators_list": ".verbs.estimators",
    "estimators_new": ".verbs.estimators",
    "estimators_train": ".verbs.estimators",
    "export": ".verbs.export",
    "fidelity": ".verbs.fidelity",
    "gate": ".verbs.gate",
    "generate": ".verbs.generate",
    "import_": ".verbs.import_",
    "record": ".verbs.record",
    "report": ".verbs.report",
    "reproduce": ".verbs.reproduce",
    "run": ".verbs.run",
    "scenes_list": ".verbs.scenes",
    "scenes_new": ".verbs.scenes",
    "scenes_preview": ".verbs.scenes",
    "scenes_show": ".verbs.scenes",
    "score": ".verbs.score",
    "show": ".verbs.show",
    "suites_list": ".verbs.suites",
    "suites_new": ".verbs.suites",
    "suites_show": ".verbs.suites",
    "sweep": ".verbs.sweep",
    "twin": ".verbs.twin",
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
