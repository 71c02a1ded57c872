"""The entry points of installed packages: what other packages list as estimators."""

from __future__ import annotations

import warnings
from importlib.metadata import EntryPoint, distributions

__all__ = ["ENTRY_POINT_GROUP", "plugin_points"]

ENTRY_POINT_GROUP = "beambench.estimators"


def plugin_points() -> tuple[EntryPoint, ...]:
    """The entry points of the group, in the order of the import path, of which the first package of a name counts.

    As `importlib.metadata.entry_points`, which fails for all packages where the list of one cannot be read: that one is left out,
    with a warning.
    """
    found: list[EntryPoint] = []
    seen: set[str] = set()
    for package in distributions():
        try:
            points = [point for point in package.entry_points if point.group == ENTRY_POINT_GROUP]
            name = str(package.name).lower() if points else ""
        except Exception as error:  # a stranger's file; whatever its reading raises
            warnings.warn(
                f"{getattr(package, '_path', 'a package')} has no readable list of entry points, so none of its estimators is "
                f"known: {type(error).__name__}: {error}",
                stacklevel=2,
            )
            continue
        if points and name not in seen:
            seen.add(name)
            found += points
    return tuple(found)
