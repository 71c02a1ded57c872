"""`beambench show`: a picture of a capture or of a run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from xarray import Dataset

    from ..benchmarks.looks.shown import Shown

__all__ = ["show"]

_KINDS = (".png", ".svg", ".html")


def show(
    data: str | Path | Dataset,
    *,
    capture: int = 0,
    element: int | None = None,
    out: str | Path | None = None,
    terminal: bool = False,
    browser: bool = False,
    overwrite: bool = False,
) -> Shown:
    """Draw a capture with its truth, or the charts of a run.

    Gated: slices from near to far, the true range, and a pixel against delay. Laser line: a frame with the true line, and a row
    of it. Wavefront: spots with the true slopes, and the phase. Waveforms and correlation samples: one shot and all. A run: its
    charts of speed against accuracy, and truth, estimate and error of a scene.

    Main arguments:
        data: Store of captures, or folder of a run; in Python also a capture in memory.
        capture: Number of the capture in its store.
        element: Number of the slice, frame or shot that is drawn; by default the brightest.
    Other arguments:
        out: The picture's file, which ends in .png, .svg or .html.
        terminal: Draw it in the terminal with blocks of colour; always done where standard output is a terminal and the
            picture goes nowhere else.
        browser: Open it in the browser; of a run its page.
        overwrite: Replace an existing picture.

    Returns:
        The picture: `panels` with their values, `chart()` as Altair's, `png()`, `svg()`, `html()`, and `file` where it was
        written. Notebooks draw it.

    Raises:
        InputError: There is no store or run, no such capture or element, a bad name of a file, or a file that exists.
    """
    path = _target(data, out, browser, overwrite)
    shown = _shown(data, capture, element)
    if path is None and browser and shown.page is None:
        path = _target(data, _beside(shown.title), False, overwrite)
    if path is not None:
        shown = _written(shown, path)
    if browser:
        import webbrowser

        webbrowser.open(((shown.page or shown.file or Path()).resolve()).as_uri())
    return shown


def _shown(data: str | Path | Dataset, capture: int, element: int | None) -> Shown:
    from ..benchmarks.folders.kinds import verb_in
    from ..benchmarks.looks.shown import shown_capture, shown_run
    from ..scenes.errors import InputError

    if isinstance(data, str | Path):
        folder = Path(data).expanduser()
        verb = verb_in(folder) if folder.is_dir() else ""
        if verb in ("run", "sweep", "score"):
            return shown_run(folder)
        if verb:
            raise InputError(
                f"This is what `beambench {verb}` wrote, of which there is no picture.", where=str(data), value=verb,
                allowed="a store of captures, or the folder of a run, sweep or score",
            )  # fmt: skip
    return shown_capture(data, capture, element)


def _target(data: object, out: str | Path | None, browser: bool, overwrite: bool) -> Path | None:
    """The file to write, None for none; refused before anything is drawn."""
    from ..output import claim
    from ..scenes.errors import InputError

    if out is None:
        return None
    if Path(out).suffix.lower() not in _KINDS:
        raise InputError(
            "A picture cannot be written in this format.", where="--out", value=str(out),
            allowed="a name that ends in " + ", ".join(_KINDS),
        )  # fmt: skip
    if browser and Path(out).suffix.lower() != ".html":
        raise InputError(
            "A browser shows a page.", where="--out", value=str(out), allowed="a name that ends in .html",
            next_step="leave out --browser to write only the picture",
        )  # fmt: skip
    inputs = [data] if isinstance(data, str | Path) else []
    return claim(out, "show", overwrite=overwrite, ours=_ours, inputs=inputs)


def _ours(path: Path) -> bool:
    """Whether a file is a picture such as this verb writes."""
    from ..output import is_picture

    if is_picture(path):
        return True
    try:
        content = path.read_bytes()
    except OSError:
        return False
    return b"vega" in content or b"<svg" in content


def _beside(title: str) -> Path:
    """A new page under ./beambench-runs."""
    from ..output import default_out, slug

    return default_out(f"show-{slug(title)}.html") / "show.html"


def _written(shown: Shown, path: Path) -> Shown:
    from ..benchmarks.folders.files import write_atomic

    kind = path.suffix.lower()
    content = shown.png() if kind == ".png" else (shown.svg() if kind == ".svg" else shown.html()).encode()

    def write(partial: Path) -> None:
        partial.write_bytes(content)

    write_atomic(path, write)
    return replace(shown, file=path)
