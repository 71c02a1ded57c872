"""What a process needs before any library is loaded: open standard streams, and a folder to be in."""

from __future__ import annotations

import os
import sys

from .scenes.errors import InputError

__all__ = ["check_working_folder", "open_standard_streams"]


def open_standard_streams() -> None:
    """Open the null device in place of each standard stream that is closed, as daemons and some schedulers leave them.

    Else the next file that is opened takes the number of the stream, and libraries that use the stream fail.
    """
    for number, (name, mode) in enumerate((("stdin", "r"), ("stdout", "w"), ("stderr", "w"))):
        try:
            os.fstat(number)
            continue
        except OSError:
            pass
        opened = os.open(os.devnull, os.O_RDWR)
        if opened != number:
            os.dup2(opened, number)
            os.close(opened)
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(number, mode, encoding="utf-8", closefd=False))


def check_working_folder() -> None:
    """Raise InputError where the working folder has been deleted: no relative path means anything then."""
    try:
        os.getcwd()
    except OSError as error:
        raise InputError(
            "The working folder no longer exists.", where="working folder", value=os.environ.get("PWD", "(unknown)"),
            next_step="change to a folder that exists: cd ~",
        ) from error  # fmt: skip
