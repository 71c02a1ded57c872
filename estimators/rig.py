"""The declared rig of a capture, read in one place: the JSON attribute `rig`, parsed once per text.

Of the instrument an estimator knows what this attribute declares, and nothing else; null states a value as unknown. Values
are named by a path of keys and list positions joined by dots ("detector.gain_dn_per_e", "gates.0"); every error gives the path and
the value.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import xarray as xr

from ..scenes.errors import InputError
from ..scenes.json_keys import read_json

__all__ = ["Amplifier", "Converter", "DeclaredRig", "Samples", "read_rig", "samples_of"]

Float = npt.NDArray[np.float64]

#: Version of the layout of the attribute.
SCHEMA = 1
#: Most bits of a converter: beyond, the greatest count is no exact float.
_MOST_BITS = 53
_NEXT = "declare it as `beambench generate` does"


class Samples(NamedTuple):
    """A waveform: value (sample) at start_s + step_s·i, straight lines between samples, zero outside."""

    start_s: float
    step_s: float
    value: Float


class Converter(NamedTuple):
    """From electrons to counts: offset_dn + gain_dn_per_e·electrons, with Gaussian read noise of read_noise_e electrons.

    saturation_dn is the count from which a sample is taken as clipped: the converter's greatest, or four standard deviations
    of read noise below the full well.
    """

    gain_dn_per_e: float
    offset_dn: float
    read_noise_e: float
    saturation_dn: float

    @property
    def dead_dn(self) -> float:
        """The count at and below which a sample is no datum.

        0, the converter's least count, where the offset lies 8 standard deviations of the floor above it: light and noise
        cannot reach it there, so that such a sample is dead or clipped from below. −inf where the offset is lower.
        """
        return 0.0 if self.offset_dn > 8 * self.gain_dn_per_e * math.sqrt(self.floor_e2) else -math.inf

    @property
    def floor_e2(self) -> float:
        """Variance [electrons²] of a sample without light: read noise and the converter's step, σ_r² + 1/(12 gain²)."""
        return self.read_noise_e**2 + 1 / (12 * self.gain_dn_per_e**2)


class Amplifier(NamedTuple):
    """Gain before the read noise, and its excess noise factor F²; both are 1 without an amplifier."""

    gain: float
    excess: float


@dataclass(frozen=True, eq=False)
class DeclaredRig:
    """The instrument as declared. Two captures of equal text share one object, so that it may key a cache."""

    text: str
    values: dict[str, Any]

    @cached_property
    def key(self) -> str:
        """Short hash of the text."""
        return hashlib.sha256(self.text.encode()).hexdigest()[:16]

    def need(self, path: str) -> Any:
        """The value at a path. Raises InputError where the rig lacks it."""
        node, found = _at(self.values, path)
        if not found:
            raise InputError(
                "The declared rig lacks a value.", where=_where(path), allowed=f"schema {SCHEMA}", next_step=_NEXT
            )
        return node

    def get(self, path: str) -> Any:
        """The value at a path, None where the rig lacks it."""
        return _at(self.values, path)[0]

    def unknown(self, path: str) -> bool:
        """Whether the rig states the value at a path as unknown: it is there, and null."""
        return _at(self.values, path) == (None, True)

    def number(self, path: str, *, above: float | None = None, least: float | None = None) -> float:
        """A finite number, within the limits where they are given. Raises InputError."""
        return _number(self.need(path), path, above, least)

    def numbers(
        self, path: str, *, length: int | None = None, above: float | None = None, least: float | None = None
    ) -> Float:
        """A list of finite numbers, of this length where it is given. Raises InputError."""
        value = self.need(path)
        if not isinstance(value, list) or not value or length not in (None, len(value)):
            many = "one or more" if length is None else str(length)
            raise _unusable(path, value, f"a list of {many} numbers")
        return np.array([_number(item, f"{path}.{i}", above, least) for i, item in enumerate(value)], np.float64)

    def whole(self, path: str, *, least: int = 1, most: int | None = None) -> int:
        """A whole number within limits. Raises InputError."""
        value = self.need(path)
        number = _finite(value)
        if number is None or number != int(number) or number < least or (most is not None and number > most):
            limits = f", {least} or more" if most is None else f", {least} to {most}"
            raise _unusable(path, value, f"a whole number{limits}")
        return int(number)

    def word(self, path: str, *allowed: str) -> str:
        """One of the allowed words. Raises InputError."""
        value = self.need(path)
        if not isinstance(value, str) or value not in allowed:
            raise _unusable(path, value, ", ".join(allowed))
        return value

    def samples(self, path: str) -> Samples:
        """A pulse, gate or response {"start_s", "step_s", "value"}. Raises InputError."""
        spec = self.need(path)
        if spec is None:
            raise _unusable(path, spec, "samples {start_s, step_s, value}")
        return samples_of(spec, _where(path))

    def converter(self, path: str, *, read_noise_e: float | None = None, top_dn: float | None = None) -> Converter:
        """The converter that a detector or readout describes.

        A full well stated as unknown leaves the converter's top as the limit, an unknown number of bits the full well.
        read_noise_e, top_dn: measured read noise, and limit of the counts where both limits are unknown. Raises InputError for
        a value that is missing, cannot be used, or is unknown and not measured.
        """
        gain = self.number(f"{path}.gain_dn_per_e", above=0)
        offset = self.number(f"{path}.offset_dn")
        measured = read_noise_e if self.unknown(f"{path}.read_noise_e") else None
        read = self.number(f"{path}.read_noise_e", least=0) if measured is None else measured
        tops = []
        if not self.unknown(f"{path}.full_well_e"):
            tops.append(offset + gain * (self.number(f"{path}.full_well_e", above=0) - 4 * read))
        if not tops and top_dn is not None:
            tops.append(top_dn)
        elif not tops or not self.unknown(f"{path}.adc_bits"):
            tops.append(2.0 ** self.whole(f"{path}.adc_bits", most=_MOST_BITS) - 1)
        return Converter(gain, offset, read, min(tops))

    def amplifier(self, path: str) -> Amplifier:
        """The tube or avalanche at a path; one without gain and noise where the rig has none there. Raises InputError."""
        if self.get(path) is None:
            return Amplifier(1.0, 1.0)
        return Amplifier(self.number(f"{path}.gain", above=0), self.number(f"{path}.excess_noise_factor", above=0))


def read_rig(capture: xr.Dataset, kind: str | None = None) -> DeclaredRig:
    """The rig that a capture declares.

    Main arguments:
        capture: with the attribute `rig`.
    Other arguments:
        kind: the kind of rig that the caller reads; any where it is not given.

    Raises InputError where the attribute is missing, is not JSON of an object, or is of another schema or kind.
    """
    text = capture.attrs.get("rig")
    if not isinstance(text, str):
        raise InputError(
            "The capture has no declared rig.", where="attribute rig", value=text, allowed="the JSON text of an object",
            next_step=_NEXT,
        )  # fmt: skip
    rig = _parsed(text)
    if kind is not None and rig.get("kind") != kind:
        raise InputError(
            f"The declared rig is not that of a {kind} capture.", where=_where("kind"), value=rig.get("kind"),
            allowed=kind,
        )  # fmt: skip
    if kind is not None and rig.get("schema") != SCHEMA:
        raise InputError(
            "The declared rig has an unknown schema.", where=_where("schema"), value=rig.get("schema"),
            allowed=str(SCHEMA), next_step=_NEXT,
        )  # fmt: skip
    return rig


@lru_cache(maxsize=16)
def _parsed(text: str) -> DeclaredRig:
    try:
        values = read_json(text)
    except ValueError as error:
        raise InputError(
            f"The declared rig is not JSON that can be read: {error}.",
            where="attribute rig",
            value=text[:80],
            allowed="the JSON text of an object",
        ) from error
    if not isinstance(values, dict):
        raise InputError(
            "The declared rig is not an object.", where="attribute rig", value=text[:80], allowed="a JSON object"
        )
    return DeclaredRig(text, values)


def samples_of(spec: Any, where: str) -> Samples:
    """Samples {"start_s", "step_s", "value"} of a waveform. Raises InputError where they cannot be used."""
    try:
        start, step = float(spec["start_s"]), float(spec["step_s"])
        value = np.asarray(spec["value"], dtype=np.float64)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            "A waveform is not given as samples.", where=where, allowed="start_s, step_s and value, numbers",
            next_step=_NEXT,
        ) from error  # fmt: skip
    finite = math.isfinite(start) and math.isfinite(step) and bool(np.isfinite(value).all())
    if value.ndim != 1 or value.size < 2 or not finite or step <= 0 or value.sum() <= 0:
        raise InputError(
            "The samples of a waveform cannot be used.", where=where,
            value={"start_s": start, "step_s": step, "samples": value.shape},
            allowed="two finite samples or more, of positive sum, step_s above 0",
        )  # fmt: skip
    return Samples(start, step, value)


def _where(path: str) -> str:
    return f"attribute rig: {path}"


def _at(node: Any, path: str) -> tuple[Any, bool]:
    """(value at a path, whether there is one)."""
    for part in path.split("."):
        if isinstance(node, dict) and part in node:
            node = node[part]
        elif isinstance(node, list) and part.isdecimal() and int(part) < len(node):
            node = node[int(part)]
        else:
            return None, False
    return node, True


def _finite(value: Any) -> float | None:
    """A JSON number as a float; None for anything else and for what is not finite."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) else None


def _number(value: Any, path: str, above: float | None, least: float | None) -> float:
    number = _finite(value)
    if number is None or (above is not None and number <= above) or (least is not None and number < least):
        limits = "" if above is None else f" above {above:g}"
        limits += "" if least is None else f", {least:g} or more"
        raise _unusable(path, value, f"a finite number{limits}")
    return number


def _unusable(path: str, value: Any, allowed: str) -> InputError:
    if value is None:
        return InputError(
            "A value of the declared rig is unknown (null) and cannot be used.", where=_where(path), allowed=allowed,
            next_step="measure and declare it, or take an estimator that does not need it: docs/declared-rig.md",
        )  # fmt: skip
    return InputError("A value of the declared rig cannot be used.", where=_where(path), value=value, allowed=allowed)
