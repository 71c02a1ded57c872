"""The pictures of the speed-accuracy chart, made by a process beside the one that makes the page.

vl-convert holds Python's lock while it draws, and drawing is half of the page's processor time: a second process halves the wait.

    python -m beambench.benchmarks.report.apart < job.json > answer.json

The job is JSON: `spec`, a finished chart; `scale`, of the PNG. The answer: `svg`, and `png` in base64.
"""

from __future__ import annotations

import base64
import json
import subprocess
import sys
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

__all__ = ["Apart", "main", "start"]


@dataclass(frozen=True)
class Apart:
    """What the process made."""

    svg: str
    png: bytes


def start(spec: dict[str, Any], *, scale: float) -> Future[Apart]:
    """Start the process and return at once; `result()` waits for it.

    Main arguments:
        spec: a finished chart (`charts.finished`). scale: pixels of the PNG per unit of the drawing.
    `result()` raises RuntimeError with what the process wrote where it ends otherwise than well.
    """
    job = json.dumps({"spec": spec, "scale": scale})
    pool = ThreadPoolExecutor(1)
    made = pool.submit(_made, job)
    pool.shutdown(wait=False)
    return made


def _made(job: str) -> Apart:
    command = [sys.executable, "-P", "-m", "beambench.benchmarks.report.apart"]
    done = subprocess.run(command, input=job, capture_output=True, text=True, encoding="utf-8", check=False)
    if done.returncode:
        raise RuntimeError(f"The drawing of the charts ended with {done.returncode}: {done.stderr.strip()[-2000:]}")
    answer = json.loads(done.stdout)
    return Apart(answer["svg"], base64.b64decode(answer["png"]))


def main() -> int:
    """Read a job from standard input and write the answer to standard output."""
    import vl_convert as vlc

    from .charts import svg_of

    job = json.loads(sys.stdin.buffer.read())
    svg = svg_of(job["spec"])
    image: bytes = vlc.svg_to_png(svg, scale=job["scale"])
    answer = {"svg": svg, "png": base64.b64encode(image).decode()}
    sys.stdout.buffer.write(json.dumps(answer).encode())
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
