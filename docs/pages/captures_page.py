"""Reference of the capture format: every variable of every modality, and what an estimate of each stage holds."""

from __future__ import annotations

from .text import table

__all__ = ["estimates_page", "page"]


def page() -> str:
    """The page of captures."""
    from beambench.captures.layouts import LAYOUTS, layout_of
    from beambench.captures.layouts.schema import SCHEMA_VERSION

    parts = [
        "# The capture format",
        "A capture is an `xarray.Dataset`; a store of captures is Zarr v3 with a leading dimension `capture`. "
        f"`schema_version` is {SCHEMA_VERSION}. Truth is what starts with `truth_`; recorded captures hold NaN there, "
        'with `truth_kind` "none", "surveyed", "reference-instrument" or "reference-algorithm". The attribute `rig` is '
        "the instrument as "
        "declared. [Conventions](../conventions.md) of frames and units; [what a recording must state](../declared-rig.md).",
    ]
    for modality in LAYOUTS:
        layout = layout_of(modality)
        rows = [
            (f"`{v.name}`", v.role, " ".join(v.dims), " or ".join(v.units), "yes" if v.required else "no", v.long_name)
            for v in layout.variables
        ]
        parts.append(
            f"## {modality}\n\n" + table(("variable", "role", "dimensions", "units", "required", "meaning"), rows)
        )
    return "\n\n".join(parts) + "\n"


def estimates_page() -> str:
    """The page of estimators: stages, what they give, and every estimator with its source."""
    import inspect

    from beambench.captures.layouts import stages
    from beambench.estimators import BUILTIN, get_estimator

    from .text import escaped, markdown

    parts = [
        "# Estimators",
        "An estimator is a function from a capture, or from the answer of an earlier stage, to an `xarray.Dataset` with "
        "its quantity, `sigma` and `valid`. A chain is written `first+second`. Parameters: `name[key=value]`.",
        "## Stages\n\n"
        + table(
            ("word", "stage", "modality", "takes", "gives"),
            [
                (
                    f"`{word}`", one.name, one.modality, ", ".join(map(str, one.takes)),
                    "; ".join(f"{q.name} [{q.unit}] ({', '.join(q.dims)})" for q in one.gives),
                )
                for word, one in stages().items()
            ],
        ),
    ]  # fmt: skip
    for name in sorted(BUILTIN):
        found = get_estimator(name)
        parameters = [
            p for p in list(inspect.signature(found.function).parameters.values()) if p.kind is p.KEYWORD_ONLY
        ]
        rows = [(f"`{p.name}`", str(p.annotation), f"`{p.default!r}`") for p in parameters]
        parts.append(
            f"## {escaped(name)}\n\nStage `{found.stage.name}`, modality {escaped(found.modality)}. "
            f"Source: {escaped(found.cites)}\n\n"
            + markdown(found.function.__doc__)
            + ("\n\n" + table(("parameter", "kind", "default"), rows) if rows else "")
        )
    return "\n\n".join(parts) + "\n"
