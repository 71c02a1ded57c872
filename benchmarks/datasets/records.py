"""The records of a store of how its captures were made, by which it is continued or made again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ...scenes.errors import InputError, reason
from ...scenes.json_keys import read_json
from .items import Item
from .sealed import seal_of

__all__ = ["difference", "recorded"]


def difference(item: Item, attrs: Mapping[str, Any]) -> str:
    """How a recorded capture differs from the requested one, `item`; "" if it is the same."""
    from ...captures.sources import bare_scene, source_files

    if item.seal is not None or seal_of(attrs) is not None:
        return "" if item.seal == seal_of(attrs) else f"it is sealed as {seal_of(attrs)}, not {item.seal}"
    try:
        recorded_scene = bare_scene(read_json(attrs["truth_scene"]))
        provenance = read_json(attrs["provenance"])
        arguments = provenance["arguments"]
        chosen = "chosen" in read_json(attrs.get("fidelity", "{}"))
        scene = read_json(item.scene.model_dump_json())
        if recorded_scene.get("name") != scene["name"]:
            return f"its scene is {recorded_scene.get('name')!r}, not {scene['name']!r}"
        if arguments["seed"] != item.seed:
            return f"its seed is {arguments['seed']}, not {item.seed}"
        if recorded_scene != bare_scene(scene):
            return "its scene has the same name and other values"
        if "files" in provenance and provenance["files"] != source_files(scene):
            return "a mesh, grid or texture of its scene has changed since"
        # For fidelity "auto", earlier captures of some modalities recorded the chosen rung, all others "auto".
        rung, rtol = arguments["fidelity"], arguments["rtol"]
        same_rung = rung == item.fidelity and rtol == item.rtol
        if not same_rung and not (item.fidelity == "auto" and chosen and rung != "auto"):
            return f"its fidelity and rtol are {rung}, {rtol}, not {item.fidelity}, {item.rtol}"
        for name in ("truth_electrons", "truth_components", "truth_instances"):
            if bool(arguments.get(name, False)) != getattr(item, name):
                return f"it was made with {name} = {bool(arguments.get(name, False))}"
        if item.key is not None and arguments["capture_key"] != item.key:
            return "it was made with another capture key"
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        return f"it does not record how it was made ({error!r})"
    return ""


def recorded(attrs: Mapping[str, Any], where: str, places: Sequence[Path], given: Mapping[str, Any]) -> Item:
    """The request that a capture records.

    Main arguments:
        attrs: Attributes of the capture.
        where: The capture, for messages.
        places, given: Where the files of its scene lie, see `find_sources`.

    Raises:
        InputError: It records no request, or a file of its scene is missing or has changed.
    """
    from ...captures.sources import find_sources
    from ...scenes.load import load_scene

    try:
        provenance = read_json(attrs["provenance"])
        arguments = provenance["arguments"]
        data = read_json(attrs["truth_scene"])
        scene = load_scene(find_sources(data, provenance.get("files", []), places, given, where))
        item = Item(
            scene,
            int(arguments["seed"]),
            int(arguments["capture_key"]),
            arguments["fidelity"],
            "noise" if arguments["rtol"] == "noise" else float(arguments["rtol"]),
            bool(arguments["truth_electrons"]),
            bool(arguments.get("truth_components", False)),
            bool(arguments.get("truth_instances", False)),
        )
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            "The capture does not record how it was generated.",
            where=where,
            value=reason(error),
            allowed="a capture made by `beambench generate`",
        ) from error
    return item
