"""The entry points of installed packages: what other packages list as estimators."""

from __future__ import annotations

from importlib.metadata import EntryPoint, distributions

from ..scenes.errors import InputError

__all__ = ["ENTRY_POINT_GROUP", "plugin_points"]

ENTRY_POINT_GROUP = "beambench.estimators"


def plugin_points() -> tuple[EntryPoint, ...]:
    """The entry points of the group, in the order of the import path, of which the first package of a name counts.

    As `importlib.metadata.entry_points`, which raises any error where the list of one package cannot be read.

    Raises:
        InputError: a package has no readable list. It cannot be passed over: other libraries, such as xarray, read all lists too.
    """
    found: list[EntryPoint] = []
    seen: set[str] = set()
    for package in distributions():
        try:
            points = [point for point in package.entry_points if point.group == ENTRY_POINT_GROUP]
            name = str(package.name).lower() if points else ""
        except Exception as error:  # a stranger's file; whatever its reading raises
            raise InputError(
                "An installed package has no readable list of entry points, which every program with plug-ins reads.",
                where=str(getattr(package, "_path", "a package")), value=f"{type(error).__name__}: {error}",
                next_step="uninstall that package, or install it again",
            ) from error  # fmt: skip
        if points and name not in seen:
            seen.add(name)
            found += points
    return tuple(found)
