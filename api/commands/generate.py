"""The command `generate`."""

from __future__ import annotations

from shlex import quote
from typing import TYPE_CHECKING, Any

from ..console import print_lines, print_table, size_text
from .build import Arguments, View, command
from .rungs import chosen_lines

if TYPE_CHECKING:
    from ..benchmarks.datasets.generate import Generated
    from ..benchmarks.datasets.large import Made

__all__ = ["GENERATE"]


def _json(made: Generated, given: Arguments) -> dict[str, Any]:
    compared = "like" in given and not given["plan"]
    return {
        "plan": made.plan,
        "paths": [str(path) for path in made.paths],
        "like": {
            "equal": made.equal,
            "differing": made.differing,
            "captures": [str(item) for item in made.comparison],
        }
        if compared
        else None,
        "outline": made.outline,
        "script": None if made.script is None else str(made.script),
        "made": None if made.made is None else {k: v for k, v in vars(made.made).items() if k != "path"},
    }


def _text(made: Generated, given: Arguments) -> None:
    if made.outline is not None:
        _outline(made.outline)
        return
    if given["plan"]:
        _plan(made.plan)
        return
    if made.script is not None and made.made is not None:
        print_lines(f"begun    {made.made.missing} shards are to be made", f"script   {made.script}: bash submits it")
        return
    if made.made is not None:
        _made(made.made)
    for index, item in enumerate(made.comparison):
        print_lines(f"capture {index}: {item}")
    print_lines(*(f"captures {path}" for path in made.paths))
    if given.get("fidelity") == "auto" and made.made is None:
        print_lines(*chosen_lines(made.paths))
    if made.made is not None:
        print_lines(f"next     beambench data card {quote(str(made.made.path))}")


def _outline(told: dict[str, Any]) -> None:
    numbers = ("captures", "shards", "a shard", "a capture", "CPU s each")
    print_table(
        ("group", *numbers),
        [
            (
                g["group"], str(g["captures"]), str(g["shards"]), str(g["captures_per_shard"]),
                size_text(g["bytes_per_capture"]), f"{g['cpu_s_per_capture']:.3g}",
            )
            for g in told["groups"]
        ],
        right=numbers,
    )  # fmt: skip
    parts = ", ".join(f"{count} {name}" for name, count in told["parts"].items() if name)
    fits = "" if told["fits"] else ": it does not fit"
    print_lines(
        f"captures {told['captures']} of {told['distinct_scenes']} distinct scenes" + (f": {parts}" if parts else ""),
        f"size     {size_text(told['bytes'])} in {told['files']} files; {size_text(told['free_bytes'])} are free{fits}",
        f"time     about {told['wall_s']:.0f} s with {told['workers']} workers of {told['threads']} threads "
        f"({told['cpu_s']:.0f} s of CPU time)",
        *(f"warning  {line}" for line in told["warnings"]),
    )


def _made(made: Made) -> None:
    kept = f", {made.kept} were there" if made.kept else ""
    again = f", {made.remade} damaged shards made again" if made.remade else ""
    content = [f"content  {made.content}"] if made.content else []
    print_lines(f"captures {made.count}: {made.made} made{kept}{again}", *content)
    print_lines(*(f"note     {line}" for line in made.events))


def _plan(plan: list[dict[str, Any]]) -> None:
    print_table(
        ("scene", "seed", "samples × elements", "counts", "fidelity", "rtol"),
        [
            (
                p["scene"],
                str(p["seed"]),
                f"{p['slices']} × ({p['rows']} × {p['cols']})",
                size_text(p["bytes"]),
                p["fidelity"],
                p["rtol"] if p["rtol"] == "noise" else f"{p['rtol']:g}",
            )
            for p in plan
        ],
        right=("seed", "samples × elements", "counts", "rtol"),
    )
    print_lines(f"{len(plan)} captures, {size_text(sum(p['bytes'] for p in plan))} of counts")


GENERATE = command(
    "generate",
    "generate:generate",
    View(_text, _json, lambda made: int(not made.equal)),
    examples="""Examples:
  beambench generate step --seeds 1 --seeds 2 -o step.zarr
  beambench generate my-scene.toml --set rig.delays.count=128 --plan
  beambench generate quickstart -o captures
  beambench generate gated-1k --plan
  beambench generate gated-1k -o gated-1k --workers 2
  beambench generate gated-1k -o /shared/gated-1k --dask tcp://head:8786
  beambench generate gated-1k -o /shared/gated-1k --slurm gated-1k.sh --array 20
  beambench generate --like step.zarr""",
)
