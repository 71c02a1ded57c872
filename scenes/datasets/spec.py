"""The file of a data set: base scenes, what is drawn, how the captures are split, and how they are made."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from ..base import Fraction, Positive, Spec
from ..nearest import did_you_mean
from .distributions import Distribution, Expressed
from .expressions import FUNCTIONS, Expression

__all__ = ["LIBRARY", "PARTS", "Correlated", "Dataset", "Rung", "SceneChoice", "Split", "list_datasets", "order_of"]

#: Folder of the data sets that ship with the project.
LIBRARY = Path(__file__).parent / "library"
#: Parts of a split, in their order.
PARTS = ("train", "validation", "test")

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,60}")
#: Keys that are left out of the data where they are absent: what was made before they existed has the same identity.
_OPTIONAL = ("split", "per_shard", "truth_instances")
_RESERVED = {"pi", "e", "if", "else", *FUNCTIONS}
Rung = Literal["direct", "scatter", "full", "geometric", "isolated", "coherent", "auto"]


class SceneChoice(Spec):
    """A base scene.

    Main arguments:
        scene: name in the library of scenes, or a .toml or .json file in the folder of the data set's file.
    Other arguments:
        name: what parameters and the index call it; the scene's own name by default.
        weight: how often it is taken, relative to the others. overrides: {path: value}, applied before anything is drawn.
        fidelity: its own rung; that of the data set by default.
    """

    example: ClassVar[str] = "docs/data-sets.md   (a complete example)"

    scene: Annotated[str, Field(min_length=1)]
    name: str = ""
    weight: Positive = 1.0
    overrides: dict[str, Any] = Field(default_factory=dict)
    fidelity: Rung | None = None

    @model_serializer(mode="wrap")
    def _without_absent_options(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {name: value for name, value in handler(self).items() if name != "fidelity" or value is not None}

    @property
    def label(self) -> str:
        """Its name in the data set."""
        return self.name or Path(self.scene).stem


class Correlated(Spec):
    """Parameters drawn together: u = Φ(L z), L Lᵀ the correlation of the normal numbers behind them (a Gaussian copula).

    Each parameter keeps its own distribution. Source: R. B. Nelsen, An Introduction to Copulas, 2nd edition, Springer 2006,
    section 2.3.
    """

    names: Annotated[tuple[str, ...], Field(min_length=2, max_length=32)]
    correlation: tuple[tuple[float, ...], ...]

    @model_validator(mode="after")
    def _possible(self) -> Correlated:
        import numpy as np

        if len({*self.names}) != len(self.names):
            raise ValueError("each name is given once")
        if len(self.correlation) != len(self.names) or any(len(row) != len(self.names) for row in self.correlation):
            raise ValueError(f"the correlation of {len(self.names)} parameters has as many rows and columns")
        matrix = np.array(self.correlation)
        if not (np.array_equal(matrix, matrix.T) and (np.diag(matrix) == 1.0).all()):
            raise ValueError("a correlation is symmetric, with ones on its diagonal")
        if np.linalg.eigvalsh(matrix)[0] < 1e-9:
            raise ValueError("a correlation is positive definite")
        return self


class Split(Spec):
    """Shares of the parts. Captures of one scene are all in one part: a scene is its target (shapes, materials, textures, by
    the content of their files) and its medium; its rig is not.

    Main arguments:
        train, validation, test: shares; they sum to 1.
    Other arguments:
        by: what makes scenes the same, coarser than the default: "base" (all draws of one base scene), or paths in target
            or medium, e.g. ["target.0.shape"].
    """

    train: Fraction
    validation: Fraction
    test: Fraction
    by: Annotated[tuple[str, ...], Field(min_length=1)] = ("target", "medium")

    @model_validator(mode="after")
    def _whole(self) -> Split:
        if abs(self.train + self.validation + self.test - 1.0) > 1e-9:
            raise ValueError(f"the shares sum to {self.train + self.validation + self.test:g}, not 1")
        for path in self.by:
            if path != "base" and path.split(".")[0] not in ("target", "medium"):
                raise ValueError(
                    f'a split is by "base", or by paths in target or medium, not by {path!r}: it would leak'
                )
        return self


class Dataset(Spec):
    """A data set.

    Main arguments:
        dataset: its name. captures: how many. seed: of all that is drawn; capture i has the key i.
        scenes: the base scenes. fidelity, rtol: as those of `generate`.
    Other arguments:
        parameters: {name: distribution}. correlated: which of them are drawn together. split: shares of the parts.
        repeats: captures of each drawn scene, which differ in their noise alone.
        redraws: how often an impossible scene (a camera inside a solid) is drawn again; 0: it is an error.
        truth_electrons, truth_components, truth_instances: as those of `generate`.
        per_shard: captures of a shard; by default about 64 MiB of them, but no more than two files a capture.
        title, description, licence, citation: for people, for the card and for exports; left out where nothing is stated.
    """

    example: ClassVar[str] = "docs/data-sets.md   (a complete example)"

    schema_version: Literal[1] = 1
    dataset: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$", max_length=80)]
    version: Annotated[int, Field(ge=1)] = 1
    title: str = ""
    licence: str = ""
    description: str = ""
    citation: str = ""
    captures: Annotated[int, Field(ge=1, le=10**8)]
    repeats: Annotated[int, Field(ge=1, le=10**6)] = 1
    seed: Annotated[int, Field(ge=0)]
    scenes: Annotated[tuple[SceneChoice, ...], Field(min_length=1, max_length=1000)]
    fidelity: Rung
    rtol: Annotated[float, Field(ge=1e-6, le=0.5)] | Literal["noise"]
    truth_electrons: bool = False
    truth_components: bool = False
    truth_instances: bool = False
    redraws: Annotated[int, Field(ge=0, le=1000)] = 0
    per_shard: Annotated[int, Field(ge=1, le=4096)] | None = None
    parameters: dict[str, Distribution] = Field(default_factory=dict)
    correlated: tuple[Correlated, ...] = ()
    split: Split | None = None

    @model_serializer(mode="wrap")
    def _without_absent_options(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        held = {k: v for k, v in handler(self).items() if k not in _OPTIONAL or v not in (None, False)}
        return {k: v for k, v in held.items() if k not in ("description", "citation") or v}

    @model_validator(mode="after")
    def _consistent(self) -> Dataset:
        labels = [one.label for one in self.scenes]
        if len({*labels}) != len(labels):
            raise ValueError(f"base scenes need different names, got {labels}")
        for name, one in self.parameters.items():
            if not _NAME.fullmatch(name) or name in _RESERVED:
                raise ValueError(f"{name!r} cannot be the name of a parameter: letters, digits and _, no function")
            if unknown := sorted({*one.scenes} - {*labels}):
                raise ValueError(f"parameters.{name}.scenes names {unknown}; the scenes are {labels}")
        _check_correlated(self)
        _check_paths(self, labels)
        order_of(self)
        return self


def _check_correlated(data: Dataset) -> None:
    told: set[str] = set()
    for one in data.correlated:
        for name in one.names:
            if name not in data.parameters or not data.parameters[name].continuous:
                raise ValueError(f"correlated: {name!r} is no parameter that is uniform, log_uniform or normal")
            if name in told:
                raise ValueError(f"correlated: {name!r} is given twice")
            told.add(name)
        if len({data.parameters[name].scenes for name in one.names}) > 1:
            raise ValueError("correlated: parameters that are drawn together hold for the same scenes")


def _check_paths(data: Dataset, labels: list[str]) -> None:
    """Refuse two parameters, or a parameter and a part of it, that set one value."""
    for label in labels:
        held = {
            path: name
            for name, one in data.parameters.items()
            if not one.scenes or label in one.scenes
            for path in one.paths
        }
        count = sum(len(one.paths) for one in data.parameters.values() if not one.scenes or label in one.scenes)
        if count != len(held):
            raise ValueError(f"two parameters set one path of the scene {label}")
        for path in held:
            if any(other != path and other.startswith(f"{path}.") for other in held):
                raise ValueError(f"one parameter sets {path} of the scene {label}, another a part of it")


def order_of(data: Dataset) -> list[str]:
    """Names of expressions, each behind those that it needs. Raises ValueError for a circle or an unknown name."""
    needs = {
        name: Expression(one.text, f"parameters.{name}.text").names
        for name, one in data.parameters.items()
        if isinstance(one, Expressed)
    }
    for name, others in needs.items():
        if unknown := sorted(others - {*data.parameters}):
            near = did_you_mean(unknown[0], {*data.parameters} - {name}, f"there are {', '.join(data.parameters)}")
            raise ValueError(f"parameters.{name}.text: {', '.join(unknown)}, which no parameter is named ({near})")
        own = {*data.parameters[name].scenes} or {one.label for one in data.scenes}
        for other in others:
            if (held := data.parameters[other].scenes) and not own <= {*held}:
                raise ValueError(f"parameters.{name}.text needs {other}, which holds for fewer scenes")
    order: list[str] = []
    while len(order) < len(needs):
        ready = [n for n, others in needs.items() if n not in order and not (others & {*needs}) - {*order}]
        if not ready:
            raise ValueError(f"expressions need each other: {sorted({*needs} - {*order})}")
        order += ready
    return order


def list_datasets() -> list[str]:
    """Names of the data sets in the library, sorted."""
    return sorted(path.stem for path in LIBRARY.glob("*.toml"))
