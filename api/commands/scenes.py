"""The commands `scenes list`, `show`, `preview` and `new`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ..console import print_json, print_lines, print_table
from .build import Arguments, View, command

if TYPE_CHECKING:
    from pathlib import Path

    from ..scenes.scene import Scene

__all__ = ["LIST", "NEW", "PREVIEW", "SHOW"]


def _list_json(rows: list[dict[str, Any]], given: Arguments) -> list[dict[str, Any]]:
    return rows


def _list_text(rows: list[dict[str, Any]], given: Arguments) -> None:
    print_table(
        ("scene", "modality", "samples × elements", "medium", "title"),
        [
            (r["name"], r["modality"], f"{r['slices']} × ({r['rows']} × {r['cols']})", r["medium"], r["title"])
            for r in rows
        ],
        right=("samples × elements",),
    )


LIST = command(
    "scenes list", "scenes:scenes_list", View(_list_text, _list_json), examples="Example:\n  beambench scenes list"
)


def _show_json(scene: Scene, given: Arguments) -> Any:
    return scene.model_dump(mode="json")


def _show_text(scene: Scene, given: Arguments) -> None:
    print_json(_show_json(scene, given))


SHOW = command(
    "scenes show",
    "scenes:scenes_show",
    View(_show_text, _show_json),
    examples="""Examples:
  beambench scenes show flat-wall
  beambench scenes show flat-wall --set rig.camera.rows=128 > my-scene.json""",
)


def _preview_json(drawn: dict[str, Any], given: Arguments) -> dict[str, Any]:
    return drawn


def _preview_text(drawn: dict[str, Any], given: Arguments) -> None:
    colour = "in its colour" if drawn["laser_visible"] else "in grey, since it is invisible to the eye"
    print_lines(
        f"{drawn['file']}: {drawn['cols']} × {drawn['rows']} pixels",
        f"The target fills {drawn['target_share']:.0%} of the view. The laser ({drawn['laser_nm']:g} nm) is drawn {colour}.",
    )


PREVIEW = command(
    "scenes preview",
    "scenes:scenes_preview",
    View(_preview_text, _preview_json),
    examples="""Examples:
  beambench scenes preview object1 -o object1.png
  beambench scenes preview my-scene.toml --size 1024""",
)


def _new_json(path: Path, given: Arguments) -> dict[str, str]:
    return {"file": str(path)}


def _new_text(path: Path, given: Arguments) -> None:
    print_lines(str(path), f"next: change it, then beambench scenes preview {path}, beambench generate {path}")


NEW = command(
    "scenes new",
    "scenes:scenes_new",
    View(_new_text, _new_json),
    examples="""Examples:
  beambench scenes new my-wall
  beambench scenes new my-tank --like relief-tank -o scenes/my-tank.toml""",
)
