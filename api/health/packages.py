"""Installed packages against the requirements of Beambench."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .finding import Finding

if TYPE_CHECKING:
    from packaging.requirements import Requirement

__all__ = ["extras", "needs_of_package", "packages", "version_of"]

#: The rest works without these: `score`, `report` and `gate` do not render.
_RENDERING = ("mitsuba", "drjit", "mitransient", "karellen-llvm-core")


def version_of(name: str) -> str | None:
    """Version of an installed package; None if it is not installed."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(name)
    except PackageNotFoundError:
        return None


def needs_of_package() -> dict[str, list[Requirement]] | None:
    """Requirements of the installed package on this platform, by extra; "" for those that are always needed.

    None if Beambench is not installed as a package.
    """
    from importlib.metadata import PackageNotFoundError, metadata, requires

    from packaging.requirements import Requirement

    try:
        stated, extras = requires("beambench") or [], metadata("beambench").get_all("Provides-Extra") or []
    except PackageNotFoundError:
        return None
    needs: dict[str, list[Requirement]] = {"": []} | {extra: [] for extra in extras}
    for requirement in map(Requirement, stated):
        marker = requirement.marker
        if marker is None or marker.evaluate({"extra": ""}):
            needs[""].append(requirement)
            continue
        for extra in extras:
            if marker.evaluate({"extra": extra}):
                needs[extra].append(requirement)
    return needs


def _trouble(requirement: Requirement) -> str:
    """Reason why a requirement is not met; "" if it is met."""
    version = version_of(requirement.name)
    if version is None:
        return "not installed"
    if not requirement.specifier.contains(version, prereleases=True):
        return f"{version}; {requirement.specifier} is needed"
    return ""


def packages() -> list[Finding]:
    """The packages that are always needed."""
    needs = needs_of_package()
    if needs is None:
        text = "Beambench is not installed as a package, so its requirements are unknown."
        return [Finding("packages", "requirements", "warning", text, "pip install beambench")]
    found = []
    for requirement in sorted(needs[""], key=lambda one: one.name.lower()):
        name, trouble = requirement.name, _trouble(requirement)
        bad = "warning" if name in _RENDERING else "broken"
        advice = f"pip install '{name}{requirement.specifier}'" if trouble else ""
        found.append(Finding("packages", name, bad if trouble else "ok", trouble or version_of(name) or "", advice))
    return found


def extras() -> list[Finding]:
    """The packages of each extra."""
    found = []
    for extra, requirements in (needs_of_package() or {}).items():
        if not extra:
            continue
        troubles = [f"{one.name} {trouble}" for one in requirements if (trouble := _trouble(one))]
        if troubles:
            advice = f"pip install 'beambench[{extra}]'"
            found.append(Finding("extras", extra, "missing", "; ".join(troubles), advice))
        else:
            text = ", ".join(f"{one.name} {version_of(one.name)}" for one in requirements)
            found.append(Finding("extras", extra, "ok", text))
    return found
