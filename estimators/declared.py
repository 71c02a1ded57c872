"""The values of the declared rig that estimators read: one table per modality, checked as a whole before anything is read.

A rig that lacks ten values is refused once, with all ten, and not in ten runs. `docs/declared-rig.md` shows these tables.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

from ..scenes.errors import InputError
from .rig import DeclaredRig

__all__ = ["ADC_BITS", "GAIN", "OFFSET", "Key", "camera_keys", "check_keys"]

_PAGE = "docs/declared-rig.md lists every value; write null for one that is unknown"


@dataclass(frozen=True)
class Key:
    """One value of the declared rig.

    Main arguments:
        path: its place, parts joined by dots; ".*" at the end stands for each item of a list.
        kind: "number", "numbers" (a list), "whole", "word", "words" (a text of any content) or "samples" (an object of
            start_s, step_s and value).
        unit: SI unit, DN, electron or px; "1" for a plain number.
        meaning: one line. users: which estimators and functions read it.
    Other arguments:
        unknown: what happens where the value is null; "" if every reader refuses it.
        optional: whether it may be left out (its few users then refuse).
        within: an object that may be absent or null, in which case the value is not read.
        case: (path, word): the value is read only where another one has this word.
        above, least, most: limits of numbers. length: of a list. words: those that are allowed.
    """

    path: str
    kind: Literal["number", "numbers", "whole", "word", "words", "samples"]
    unit: str
    meaning: str
    users: str
    unknown: str = ""
    optional: bool = False
    within: str = ""
    case: tuple[str, str] | None = None
    above: float | None = None
    least: float | None = None
    most: int | None = None
    length: int | None = None
    words: tuple[str, ...] = ()

    @property
    def limits(self) -> str:
        """The type of the value and its limits, in words."""
        bounds = [] if self.above is None else [f"above {self.above:g}"]
        bounds += [] if self.least is None else [f"{self.least:g} or more"]
        bounds += [] if self.most is None else [f"up to {self.most}"]
        many = "" if self.length is None else f"{self.length} "
        name = {
            "number": "number", "whole": "whole number", "words": "text", "numbers": f"list of {many}numbers",
            "samples": "samples", "word": " or ".join(f'"{word}"' for word in self.words),
        }[self.kind]  # fmt: skip
        name = f"list of {name}" if self.path.endswith(".*") else name
        return ", ".join([name, *bounds])

    def applies(self, rig: DeclaredRig) -> bool:
        """Whether the value belongs to this rig."""
        if self.within and rig.get(self.within) is None:
            return False
        return self.case is None or rig.get(self.case[0]) == self.case[1]

    def check(self, rig: DeclaredRig) -> None:
        """Raise InputError where the value is missing or cannot be used, unless it may be left out or be unknown."""
        place = self.path.removesuffix(".*")
        if self.unknown and rig.unknown(place):
            return
        value = rig.need(place)
        if place == self.path:
            self._read(rig, place)
            return
        if not isinstance(value, list) or not value:
            raise InputError(
                "The declared rig holds an empty list, or none.", where=f"attribute rig: {place}", value=value,
                allowed=f"a list of one or more: {self.meaning}",
            )  # fmt: skip
        for number in range(len(value)):
            self._read(rig, f"{place}.{number}")

    def _read(self, rig: DeclaredRig, path: str) -> None:
        readers: dict[str, Callable[[], Any]] = {
            "number": lambda: rig.number(path, above=self.above, least=self.least),
            "numbers": lambda: rig.numbers(path, length=self.length, above=self.above, least=self.least),
            "whole": lambda: rig.whole(path, least=1 if self.least is None else int(self.least), most=self.most),
            "word": lambda: rig.word(path, *self.words),
            "words": lambda: rig.need(path),
            "samples": lambda: rig.samples(path),
        }
        readers[self.kind]()


#: The converter of a detector, as more than one table has it.
GAIN = Key("detector.gain_dn_per_e", "number", "DN/electron", "counts per electron", "all", above=0)
OFFSET = Key("detector.offset_dn", "number", "DN", "count without light", "all")
ADC_BITS = Key(
    "detector.adc_bits", "whole", "1", "bits of the converter: counts end at 2^bits − 1", "all", most=53,
    unknown="the full well is the limit; refused if that is unknown too",
)  # fmt: skip


def camera_keys(readers: str) -> tuple[Key, ...]:
    """The values of a camera's detector whose frames `readers` read: converter, read noise, full well, and a tube."""
    tube = "detector.intensifier"
    return (
        GAIN,
        OFFSET,
        Key("detector.read_noise_e", "number", "electron", "rms read noise of a pixel", readers, least=0),
        Key(
            "detector.full_well_e", "number", "electron", "electrons at which a pixel is full", readers, above=0,
            unknown="the converter's top is the limit",
        ),
        ADC_BITS,
        Key(f"{tube}.gain", "number", "1", "gain before the read noise", readers, within=tube, above=0),
        Key(f"{tube}.excess_noise_factor", "number", "1", "excess noise factor F²", readers, within=tube, above=0),
    )  # fmt: skip


@lru_cache(maxsize=32)
def check_keys(rig: DeclaredRig, keys: tuple[Key, ...]) -> None:
    """Check all values of a table at once, those aside that may be left out.

    Raises InputError for the first wrong value if there is one, and for several with the places of all and what each may be.
    """
    wrong: list[InputError] = []
    for key in keys:
        if not key.applies(rig) or key.optional:
            continue
        try:
            key.check(rig)
        except InputError as error:
            wrong.append(error)
    if len(wrong) == 1:
        raise wrong[0]
    if wrong:
        places = [error.where.removeprefix("attribute rig: ") for error in wrong]
        raise InputError(
            "Several values of the declared rig are missing or cannot be used.",
            where="attribute rig: " + ", ".join(places),
            value={place: error.value for place, error in zip(places, wrong, strict=True) if error.value is not None}
            or None,
            allowed="; ".join(
                f"{place}: {_allowed(place, keys, error)}" for place, error in zip(places, wrong, strict=True)
            ),
            next_step=_PAGE,
        )


def _allowed(place: str, keys: tuple[Key, ...], error: InputError) -> str:
    """What a value may be: from its table, since a missing one has no limits of its own."""
    key = next((key for key in keys if key.path.removesuffix(".*") == place), None)
    if key is None:
        return error.allowed
    text = key.limits + (f" [{key.unit}]" if key.unit != "1" else "")
    return text + (" or null" if key.unknown else "")
