"""The commands: where each is built, and its place in the list. None is loaded before it is typed or listed."""

from __future__ import annotations

from cyclopts import App

__all__ = ["register"]

#: Command -> (its place among the others, the object that is the command, in this folder).
_COMMANDS = {
    "run": (1, "run:RUN"),
    "scenes list": (0, "scenes:LIST"),
    "scenes show": (0, "scenes:SHOW"),
    "scenes preview": (0, "scenes:PREVIEW"),
    "scenes new": (0, "scenes:NEW"),
    "suites list": (0, "suites:LIST"),
    "suites show": (0, "suites:SHOW"),
    "suites new": (0, "suites:NEW"),
    "generate": (3, "generate:GENERATE"),
    "data card": (0, "data:CARD"),
    "data status": (0, "data:STATUS"),
    "data verify": (0, "data:VERIFY"),
    "data repair": (0, "data:REPAIR"),
    "data finalize": (0, "data:FINALIZE"),
    "record": (4, "record:RECORD"),
    "estimate": (5, "estimate:ESTIMATE"),
    "score": (6, "estimate:SCORE"),
    "show": (7, "show:SHOW"),
    "estimators list": (0, "estimators:LIST"),
    "estimators check": (0, "estimators:CHECK"),
    "estimators new": (0, "estimators:NEW"),
    "estimators train": (0, "estimators:TRAIN"),
    "import": (4, "import_:IMPORT"),
    "calibrate": (8, "calibrate:CALIBRATE"),
    "export": (9, "estimate:EXPORT"),
    "bound": (10, "bound:BOUND"),
    "design": (11, "design:DESIGN"),
    "twin": (12, "twin:TWIN"),
    "sweep": (13, "search:SWEEP"),
    "break": (14, "search:BREAK"),
    "fidelity": (15, "fidelity:FIDELITY"),
    "report": (20, "run:REPORT"),
    "compare": (21, "compare:COMPARE"),
    "reproduce": (22, "reproduce:REPRODUCE"),
    "gate": (23, "gate:GATE"),
    "drivers list": (0, "drivers:LIST"),
    "doctor": (80, "doctor:DOCTOR"),
}
#: Group -> (its place, its help).
_GROUPS = {
    "scenes": (2, "List the scenes of the library, show one in full, draw it, or begin one of your own."),
    "suites": (2, "List the suites, show one, or begin one of your own."),
    "data": (4, "Look at stores of captures: what they hold, and whether they are undamaged."),
    "drivers": (79, "List the drivers of cameras, delay generators and oscilloscopes, and how to get them."),
    "estimators": (7, "List the estimators, check one against the laws, train one, or begin one of your own."),
}


def register(app: App) -> None:
    """Add all commands to the command line."""
    groups = {"": app}
    for words, (place, home) in _COMMANDS.items():
        group, _, name = words.rpartition(" ")
        if group not in groups:
            place_of_group, text = _GROUPS[group]
            groups[group] = App(name=group, help=text, sort_key=place_of_group)
            app.command(groups[group])
        groups[group].command(f"{__package__}.{home}", name=name, sort_key=place)
