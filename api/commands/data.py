"""Commands of scenes and captures: scenes, generate, data."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import App, Parameter

from ..console import Common, Out, Overrides, Whole, print_json, print_lines, print_table, size_text

if TYPE_CHECKING:
    from ..captures.store.verification import Damage

__all__ = ["register"]

_Overwrite = Annotated[bool, Parameter(negative="", show_default=False, help="Replace what is there.")]


def register(app: App) -> None:
    """Add the commands to the command line."""
    scenes = App(name="scenes", help="List the scenes of the library, show one in full, or draw it.", sort_key=2)
    scenes.command(scenes_list, name="list", help_epilogue="Example:\n  beambench scenes list")
    scenes.command(scenes_show, name="show", help_epilogue=_SHOW)
    scenes.command(scenes_preview, name="preview", help_epilogue=_PREVIEW)
    app.command(scenes)
    app.command(generate, name="generate", sort_key=3, help_epilogue=_GENERATE)
    data = App(name="data", help="Look at stores of captures: what they hold, and whether they are sound.", sort_key=4)
    for name, function in (
        ("status", data_status),
        ("verify", data_verify),
        ("repair", data_repair),
        ("finalize", data_finalize),
    ):
        data.command(function, name=name, help_epilogue=f"Example:\n  beambench data {name} captures.zarr")
    app.command(data)


def scenes_list(*, common: Common | None = None) -> int:
    """List the scenes of the library."""
    from ..verbs.scenes import scenes_list as verb

    rows = verb()
    if common and common.json:
        print_json(rows)
        return 0
    print_table(
        ("scene", "modality", "slices × rows × cols", "medium", "title"),
        [
            (r["name"], r["modality"], f"{r['slices']} × {r['rows']} × {r['cols']}", r["medium"], r["title"])
            for r in rows
        ],
        right=("slices × rows × cols",),
    )
    return 0


_SHOW = """Examples:
  beambench scenes show flat-wall
  beambench scenes show flat-wall --set rig.camera.rows=128 > my-scene.json"""


def scenes_show(scene: str, /, *, set_: Overrides = None, common: Common | None = None) -> int:
    """Print a scene in full, as validated, in JSON: a start for a scene file of your own.

    Parameters
    ----------
    scene
        A scene of the library, or a .toml or .json file.
    """
    from ..scenes.overrides import parse_assignments
    from ..verbs.scenes import scenes_show as verb

    print_json(verb(scene, overrides=parse_assignments(set_ or [])).model_dump(mode="json"))
    return 0


_PREVIEW = """Examples:
  beambench scenes preview object1 -o object1.png
  beambench scenes preview my-scene.toml --size 1024"""


def scenes_preview(
    scene: str,
    /,
    *,
    set_: Overrides = None,
    size: Whole = 640,
    out: Out = None,
    overwrite: _Overwrite = False,
    common: Common | None = None,
) -> int:
    """Draw a scene as a person beside the camera would see it: room light, and the laser in its colour.

    Parameters
    ----------
    scene
        A scene of the library, or a .toml or .json file.
    size
        Pixels of the picture's longer side.
    """
    from ..scenes.overrides import parse_assignments
    from ..verbs.scenes import scenes_preview as verb

    told = verb(scene, overrides=parse_assignments(set_ or []), size=size, out=out, overwrite=overwrite)
    if common and common.json:
        print_json(told)
        return 0
    laser = "in its colour" if told["laser_visible"] else "in grey: the eye does not see it"
    print_lines(
        f"{told['file']}: {told['cols']} × {told['rows']} pixels",
        f"The target fills {told['target_share']:.0%} of the view; the laser at {told['laser_nm']:g} nm is drawn {laser}.",
    )
    return 0


_GENERATE = """Examples:
  beambench generate step --seeds 1 --seeds 2 -o step.zarr
  beambench generate my-scene.toml --set rig.delays.count=128 --plan
  beambench generate quickstart -o captures
  beambench generate --like step.zarr"""


def generate(
    source: str | None = None,
    /,
    *,
    set_: Overrides = None,
    seeds: Annotated[list[str] | None, Parameter(negative="")] = None,
    fidelity: Literal["direct", "scatter", "full", "auto"] | None = None,
    rtol: float | Literal["noise"] | None = None,
    truth_electrons: Annotated[bool, Parameter(negative="", show_default=False)] = False,
    truth_components: Annotated[bool, Parameter(negative="", show_default=False)] = False,
    like: str | None = None,
    plan: Annotated[bool, Parameter(negative="", show_default=False)] = False,
    out: Out = None,
    resume: Annotated[bool, Parameter(negative="", show_default=False)] = False,
    overwrite: _Overwrite = False,
    common: Common | None = None,
) -> int:
    """Generate captures with exact truth from a scene or a suite, and store them.

    Parameters
    ----------
    source
        A scene or suite by name, or a .toml or .json file. A suite gives one store per scene.
    seeds
        Seed of a scene's capture, a whole number, repeatable; 0 if not given. A suite has its own.
    fidelity
        Rung of the forward model; "auto" takes the cheapest whose predicted error is below --rtol.
    rtol
        Relative error of the expected stack aimed at; 1e-3, or what the suite says, if not given. With --fidelity auto also
        "noise": below one standard deviation of the detector's noise, and too small to bias the answer.
    truth_electrons
        Keep the noise-free expectation of every sample too.
    truth_components
        Keep the light apart too: direct, between surfaces, scattered once, scattered more often. With --fidelity full only.
    like
        Repeat this store from its own records and compare: how many values differ. Exit code 1 if any does. Takes no
        option that would change what is made; --set target.0.shape.file=PATH tells where a mesh lies that is neither
        beside the store nor in the current folder.
    plan
        Tell what would be made, and make nothing.
    resume
        Go on with what was interrupted in --out; what is complete there stays.
    """
    from ..benchmarks.folders.progress import terminal_progress
    from ..scenes.overrides import parse_assignments
    from ..verbs.generate import generate as verb

    with terminal_progress() as progress:
        made = verb(
            source,
            overrides=parse_assignments(set_ or []),
            seeds=_whole_numbers(seeds),
            fidelity=fidelity,
            rtol=rtol,
            truth_electrons=truth_electrons,
            truth_components=truth_components,
            like=like,
            plan=plan,
            out=out,
            resume=resume,
            overwrite=overwrite,
            progress=progress,
        )
    if common and common.json:
        print_json(
            {
                "plan": made.plan,
                "paths": [str(path) for path in made.paths],
                "like": None
                if like is None or plan
                else {
                    "equal": made.equal,
                    "differing": made.differing,
                    "captures": [str(item) for item in made.comparison],
                },
            }
        )
    elif plan:
        print_table(
            ("scene", "seed", "slices × rows × cols", "counts", "fidelity", "rtol"),
            [
                (
                    p["scene"],
                    str(p["seed"]),
                    f"{p['slices']} × {p['rows']} × {p['cols']}",
                    size_text(p["bytes"]),
                    p["fidelity"],
                    p["rtol"] if p["rtol"] == "noise" else f"{p['rtol']:g}",
                )
                for p in made.plan
            ],
            right=("seed", "slices × rows × cols", "counts", "rtol"),
        )
        print_lines(f"{len(made.plan)} captures, {size_text(sum(p['bytes'] for p in made.plan))} of counts")
    else:
        for index, item in enumerate(made.comparison):
            print_lines(f"capture {index}: {item}")
        print_lines(*(f"captures {path}" for path in made.paths))
    return int(not made.equal)


def _whole_numbers(given: list[str] | None) -> list[int] | None:
    """Numbers of an option, none of them rounded. Raises InputError."""
    from ..scenes.errors import InputError

    for text in given or []:
        if not text.strip().removeprefix("-").isdecimal():
            raise InputError("A seed is a whole number.", where="--seeds", value=text, allowed="0, 1, 2, …")
    return None if given is None else [int(text) for text in given]


def data_status(data: str, /, *, common: Common | None = None) -> int:
    """Tell what a store of captures holds.

    Parameters
    ----------
    data
        The store.
    """
    from ..verbs.data import data_status as verb

    status = verb(data)
    if common and common.json:
        print_json(status)
        return 0
    sizes = " × ".join(f"{size} {name}" for name, size in status["sizes"].items())
    print_lines(
        f"{status['path']}: {status['count']} {status['modality']} captures, {sizes}, {size_text(status['bytes'])}"
    )
    columns = ("capture", "scene", "seed", "truth", "fidelity")
    rows = [[str(row[name]) if row[name] is not None else "–" for name in columns] for row in status["captures"]]
    print_table(columns, rows, right=("capture", "seed"))
    return 0


def data_verify(data: str, /, *, common: Common | None = None) -> int:
    """Read every byte of a store and list what is damaged. Exit code 1 if anything is.

    Parameters
    ----------
    data
        The store.
    """
    from dataclasses import asdict

    from ..verbs.data import data_verify as verb

    damage = verb(data)
    if common and common.json:
        print_json({"sound": not damage, "damage": [asdict(item) for item in damage]})
    elif damage:
        print_lines(*(str(item) for item in damage), _advice(data, damage))
    else:
        print_lines(f"{data}: sound")
    return int(bool(damage))


def _advice(data: str, damage: list[Damage]) -> str:
    """How many files are wrong, and what helps: a repair only where it would be done."""
    from ..captures.store.manifest import ASK_FOR_RIGHTS, TAKE_ANEW

    unreadable = sum(item.unreadable for item in damage)
    if unreadable:
        return f"{unreadable} files cannot be read; next: {ASK_FOR_RIGHTS}"
    metadata = any(item.capture is None and item.file.endswith("zarr.json") for item in damage)
    return f"{len(damage)} files are damaged; next: " + (TAKE_ANEW if metadata else f"beambench data repair {data}")


def data_repair(data: str, /, *, overwrite: _Overwrite = False, common: Common | None = None) -> int:
    """Drop the damaged captures of a store and keep the sound ones; the files dropped stay beside it in NAME.dropped.

    Parameters
    ----------
    data
        The store, or an unfinished one (NAME.partial).
    """
    from ..verbs.data import data_repair as verb

    return _recovered(verb(data, overwrite=overwrite), common)


def data_finalize(data: str, /, *, overwrite: _Overwrite = False, common: Common | None = None) -> int:
    """Turn the complete captures of an interrupted `generate` into a store.

    Parameters
    ----------
    data
        The store's name, with or without .partial.
    """
    from ..verbs.data import data_finalize as verb

    return _recovered(verb(data, overwrite=overwrite), common)


def _recovered(recovery: object, common: Common | None) -> int:
    from ..captures.store.recovery import Recovery

    assert isinstance(recovery, Recovery)
    if common and common.json:
        print_json(
            {
                "path": str(recovery.path),
                "kept": recovery.kept,
                "dropped": list(recovery.dropped),
                "damage": [str(item) for item in recovery.damage],
                "aside": None if recovery.aside is None else str(recovery.aside),
            }
        )
    else:
        dropped = f", dropped {', '.join(map(str, recovery.dropped))}" if recovery.dropped else ""
        print_lines(f"{recovery.path}: {recovery.kept} captures{dropped}")
        if recovery.aside is not None:
            print_lines(f"{recovery.aside}: the files of what was dropped")
    return 0
