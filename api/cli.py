"""The command line, `beambench VERB …`. Large packages are imported when a command needs them."""

from __future__ import annotations

import atexit
import errno
import gc
import os
import re
import sys
import warnings
from collections.abc import Sequence
from typing import Any, TextIO

from cyclopts import App, CycloptsError

from .commands.table import register
from .console import terminal
from .process import check_working_folder, end_in_order, keep_standard_streams, open_standard_streams
from .scenes.errors import InputError
from .scenes.plain_text import plain_text

__all__ = ["app", "main"]

_HELP = """Make captures of active optical sensors whose truth is known, and score the algorithms that read them.

Begin with: beambench run quickstart"""

_EPILOGUE = """Exit codes: 0 done, 1 a check or every estimator failed, 2 bad usage or input, 3 could not measure,
70 internal error, 130 interrupted.
Tab completion: beambench --install-completion, or: beambench completion bash"""

#: Errors of the operating system that a user can correct: a full disk, a missing permission, a wrong path.
_USERS_ERRNO = {
    errno.ENOSPC,
    errno.EDQUOT,
    errno.EIO,
    errno.EACCES,
    errno.EPERM,
    errno.EROFS,
    errno.ENOENT,
    errno.ENOTDIR,
    errno.EISDIR,
    errno.ENAMETOOLONG,
    errno.EEXIST,
    errno.ENOTEMPTY,
}
#: Limits of the system that a process met, and what a user can do.
_LIMITS = {
    errno.EMFILE: "allow more open files: ulimit -n 1024",
    errno.ENFILE: "end other programs: the system has no more files to open",
    errno.EAGAIN: "end other programs, or allow more processes: ulimit -u",
    errno.ENOMEM: "free memory, or allow more: ulimit -v",
}


def _version() -> str:
    from importlib.metadata import version

    return version("beambench")


app = App(
    name="beambench",
    help=_HELP,
    help_epilogue=_EPILOGUE,
    help_format="plaintext",
    version=_version,
    suppress_keyboard_interrupt=False,
    result_action="return_value",
)
register(app)


def _completion(shell: str = "bash") -> int:
    """Print the tab-completion script of a shell.

    Parameters
    ----------
    shell
        bash, zsh or fish.
    """
    if shell not in {"bash", "zsh", "fish"}:
        raise InputError(
            "There is no tab completion for this shell.", where="shell", value=shell, allowed="bash, zsh, fish"
        )
    print(app.generate_completion(prog_name="beambench", shell=shell))  # type: ignore[arg-type]
    return 0


app.command(
    _completion,
    name="completion",
    sort_key=90,
    help_epilogue='Example:\n  eval "$(beambench completion bash)"      for this session, in bash',
)
app.register_install_completion_command("--install-completion", add_to_startup=True)


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code; `beambench --help` lists the codes.

    Main arguments:
        argv: What was typed behind `beambench`; by default that of this process.
    """
    tokens = list(sys.argv[1:] if argv is None else argv)
    debug = "--debug" in tokens
    open_standard_streams()
    if argv is None:  # the process is ours
        keep_standard_streams()
        end_in_order()
        # Garbage is searched for seldom, as kernels are compiled here, and not at the end, where that took half a second.
        gc.set_threshold(50_000, 20, 50)
        atexit.register(gc.freeze)
    try:
        check_working_folder()
        with warnings.catch_warnings():
            warnings.showwarning = _show_warning
            code = _run(tokens)
        sys.stdout.flush()
    except BrokenPipeError:
        _discard_stdout()
        return 0
    except KeyboardInterrupt as error:
        print("\ninterrupted", file=sys.stderr)
        _print_errors(*_notes(error))
        if debug:
            _traceback()
        return 130
    except CycloptsError as error:
        return _print_errors(f"error: {_one_line(str(error))}", f"  next:    beambench {_command(error)}--help")
    except InputError as error:
        if debug:
            _traceback()
        return _print_errors(f"error: {error}", *_notes(error))
    except OSError as error:
        if debug:
            _traceback()
        if error.errno in _LIMITS:
            advice = f"  next:    {_LIMITS[error.errno]}"
            return _print_errors(f"error: {os.strerror(error.errno)}.", advice, *_notes(error))
        if error.errno not in _USERS_ERRNO:
            return _internal(error, debug)
        lines = [f"error: {os.strerror(error.errno or 0)}."]
        if error.filename is not None:
            lines.append(f"  where:   {error.filename}")
        elif error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EIO):
            _discard_stdout()  # it may be the standard output that is full: what waits for it would fail again at the exit
        advice = "  next:    check the path and the free space of its disk, or choose another with --out"
        return _print_errors(*lines, advice, *_notes(error))
    except SystemExit as error:  # raised by a plug-in: its exit code would be taken for the command's
        return _internal(RuntimeError(f"a plug-in or library ended the process with exit code {error.code!r}"), debug)
    except Exception as error:
        if debug:
            _traceback()
        code = _internal(error, debug)
        _print_errors(*_notes(error))
        return code
    return code


def _notes(error: BaseException) -> list[str]:
    """Notes that a verb added to its error: which results are kept, and how to continue."""
    return [f"  kept:    {note}" for note in getattr(error, "__notes__", ())]


def _run(tokens: list[str]) -> int:
    _load_listed(tokens)
    if not tokens:
        app.help_print([], console=terminal(width=110))
        return 0
    result: Any = app(
        tokens,
        console=terminal(width=110),
        error_console=terminal(stderr=True),
        exit_on_error=False,
        print_error=False,
        result_action="return_value",
    )
    return result if isinstance(result, int) else 0


def _load_listed(tokens: list[str]) -> None:
    """Load the commands of the group that is typed, whose help lists them with the first line of each."""
    _, chain, _ = app.parse_commands([token for token in tokens if not token.startswith("-")])
    for name in chain[-1]:
        chain[-1][name]


def _command(error: CycloptsError) -> str:
    chain = [name for name in (error.command_chain or ()) if not name.startswith("-")]
    return "".join(f"{name} " for name in chain)


def _one_line(text: str) -> str:
    plain = " ".join(text.split())
    unused = re.fullmatch(r"Unused Tokens: \[(.*)\]\.?", plain)
    if unused:  # the library's own words name no remedy
        return f"Nothing takes {unused[1]}. An option for several values is repeated: --seeds 1 --seeds 2."
    return plain


def _print_errors(*lines: str) -> int:
    for line in lines:
        print(plain_text(line), file=sys.stderr)
    return 2


def _internal(error: Exception, debug: bool) -> int:
    try:
        from .estimators.points import plugin_points

        plugin_points()
    except InputError as broken:  # then libraries fail too, wherever they look for their plug-ins
        return _print_errors(f"error: {broken}")
    print(plain_text(f"internal error: {type(error).__name__}: {_one_line(str(error))}"), file=sys.stderr)
    if not debug:
        print("  next:    run the command again with --debug, and report the traceback as a bug", file=sys.stderr)
    return 70


def _traceback() -> None:
    import traceback

    traceback.print_exc()


def _show_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    """One plain line for each warning to the user; warnings of libraries to their programmers are left out."""
    if issubclass(category, UserWarning):
        print(plain_text(f"{getattr(category, 'word', 'warning')}: {message}"), file=sys.stderr)


def _discard_stdout() -> None:
    """Point standard output to the null device, so that Python's flush at exit does not fail on the closed pipe."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, sys.stdout.fileno())
    os.close(nowhere)
