"""An emulated rig in a process of its own: `python -m beambench.generator.emulators SCENE`.

One line of JSON on standard output says where its instruments are; then they serve until standard input is closed.
"""

from __future__ import annotations

import argparse
import json
import os
import secrets
import sys
import time
from pathlib import Path

from ...captures.drivers.gige.packets import GVCP_PORT
from ...scenes.errors import InputError
from ...scenes.load import load_scene
from ...scenes.overrides import parse_assignments
from .bench import Bench, Faults, Sight
from .sights import emulated

__all__ = ["main"]


def _arguments(tokens: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m beambench.generator.emulators", description=__doc__)
    parser.add_argument("scene", help="a scene of the library, or a file")
    parser.add_argument("--set", action="append", default=[], help="PATH=VALUE, as everywhere")
    parser.add_argument("--table", help="a table of expectations, in place of light transport; its scene counts")
    parser.add_argument("--seed", type=int, default=1, help="of the noise and of the faults")
    parser.add_argument("--hidden", type=int, default=0, help="seed of the hidden rig; 0: as the scene says")
    parser.add_argument("--truth", help="file for the scene as it really is; nobody else is told")
    parser.add_argument("--host", default="", help="loopback address; by default a free one of 127.0.0.0/8")
    parser.add_argument("--control-port", type=int, default=GVCP_PORT, help="of the camera")
    parser.add_argument("--delay-port", type=int, default=5025, help="of the delay generator; 0: any")
    parser.add_argument("--serial", default="EMU0001", help="of the camera")
    parser.add_argument("--loss", type=float, default=0.0, help="share of stream packets that are lost")
    parser.add_argument("--stall", type=float, default=0.0, help="share of shots without an image")
    parser.add_argument("--dies-after", type=int, default=None, help="shots after which the process ends")
    parser.add_argument("--stay", action="store_true", help="serve on when standard input is closed")
    return parser.parse_args(tokens)


def _bench(given: argparse.Namespace, sight: Sight) -> Bench:
    """The rig on the given address, or on one that is free: every rig needs its own, as GigE cameras have one port."""
    faults = Faults(given.loss, given.stall, given.dies_after)
    hosts = [given.host] if given.host else [_some_host() for _ in range(20)]
    for host in hosts:
        try:
            return Bench(
                sight, host, serial=given.serial, seed=given.seed, faults=faults, control_port=given.control_port,
                delay_port=given.delay_port,
            )  # fmt: skip
        except OSError as error:
            last = error
    raise InputError(
        "There is no free address for the emulated rig.", where="--host", value=hosts[-1], allowed=str(last)
    )


def _some_host() -> str:
    return f"127.{16 + secrets.randbelow(224)}.{secrets.randbelow(256)}.{1 + secrets.randbelow(254)}"


def main(tokens: list[str] | None = None) -> int:
    """Serve; the exit code."""
    given = _arguments(tokens)
    try:
        table = Path(given.table) if given.table else None
        scene = load_scene(given.scene, parse_assignments(given.set))
        scene, sight = emulated(scene, given.hidden, given.seed, table)
        bench = _bench(given, sight)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    if given.truth:
        Path(given.truth).write_text(json.dumps(scene.model_dump(mode="json")), encoding="utf-8")
    bench.start()
    camera, delays = bench.camera.address, bench.delays.address
    places = {"camera": f"{camera[0]}:{camera[1]}", "delay": f"{delays[0]}:{delays[1]}", "serial": given.serial}
    print(json.dumps(places), flush=True)
    if given.stay:
        while True:
            time.sleep(3600)
    sys.stdin.read()  # ends with whoever started this process, however that ends
    os._exit(0)  # at once: a thread may be in the middle of a shot


if __name__ == "__main__":
    sys.exit(main())
