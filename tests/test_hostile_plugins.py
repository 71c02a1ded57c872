"""A part of the campaign of hostile plug-ins (docs/reliability.md): a handful in one run; and that the campaign can fail."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from beambench.benchmarks.checks import plugins
from beambench.benchmarks.checks.traced import Ended

#: One of each kind that was once not contained, and quick ones of the others.
QUICK = (
    "claims_a_full_disk",
    "deep_folders",
    "no_rights",
    "breaks_numpy",
    "event_of_the_house",
    "exits_at_once",
    "import_exits_at_once",
)


def test_there_are_enough_of_every_kind_and_each_says_what_it_does() -> None:
    assert len(plugins.PLUGINS) >= 65 and set(QUICK) <= set(plugins.PLUGINS)
    assert len({plugin.label for plugin in plugins.PLUGINS.values()}) == len(plugins.PLUGINS)
    assert all(len(plugin.what) > 5 for plugin in plugins.PLUGINS.values())


def test_hostile_plugins_are_contained() -> None:
    # In a process of its own: the commands are forked from it, and this one has threads.
    code = (
        "import sys, pathlib\n"
        "from beambench.benchmarks.checks import plugins\n"
        f"plugins.PLUGINS = {{name: plugins.PLUGINS[name] for name in {QUICK!r}}}\n"
        "sys.exit(plugins.main([]))\n"
    )
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(path or os.getcwd() for path in sys.path)}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False, timeout=800
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"| all | {len(QUICK)} | {len(QUICK)} | 0 |" in done.stdout


@pytest.mark.parametrize(
    ("code", "honest", "left", "told"),
    [
        (0, "1", "", ""),
        (70, "1", "", "exit 70"),
        (None, "1", "", "it hung"),
        (0, "2", "", "other rows"),
        (0, "1", "left-behind", "left: \\['left-behind'\\]"),
    ],
)
def test_one_that_is_not_contained_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int | None, honest: str, left: str, told: str
) -> None:
    def made(words: list[str], place: Path, **given: Any) -> Ended:
        (place / "out").mkdir()
        lines = ["estimator,seed,rmse,status,cpu_s", f"weighted-average,1,{honest},ok,2"]
        lines.append(f"{plugins.PLUGINS['sleeps'].label},1,,timeout: call over 3 s,1")
        (place / "out" / "scores.csv").write_text("\n".join(lines) + "\n")
        if left:
            (place / "tmp" / left).mkdir()
        return Ended(code, "internal error", {}, 0, 5)

    monkeypatch.setattr(plugins, "run_forked", made)
    expected = [{"estimator": "weighted-average", "seed": "1", "rmse": "1", "status": "ok"}]
    (verdict,) = plugins.contained([plugins.PLUGINS["sleeps"]], expected, tmp_path)
    assert re.match(told, verdict.problem) if told else not verdict.problem
    assert verdict.status == "timeout: call over 3 s"
