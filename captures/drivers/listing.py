"""The drivers: what each is for, where it is, whether it can be used on this machine, and how to get what is missing."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from inspect import signature
from typing import Any

from ...scenes.errors import InputError
from .device import Device

__all__ = ["DRIVERS", "Driver", "driver_of", "made"]


@dataclass(frozen=True)
class Driver:
    """One driver.

    Main arguments:
        role: "camera", "delay" or "scope". what: the devices. home: "module:class" in this folder.
        needs: modules to import. how: how to get them. tried: on what it was tried.
    """

    name: str
    role: str
    what: str
    home: str
    tried: str
    needs: tuple[str, ...] = ()
    how: str = ""
    probe: Callable[[], bool] | None = None

    @property
    def there(self) -> bool:
        """Whether all that it needs is installed."""
        return all(find_spec(name) is not None for name in self.needs) and (self.probe is None or self.probe())


def _aravis() -> bool:
    from .aravis import aravis_library

    try:
        aravis_library()
    except InputError:
        return False
    return True


_APT = "apt install gir1.2-aravis-0.8 libgirepository1.0-dev libcairo2-dev pkg-config; pip install 'PyGObject<3.51'"
#: Every driver, by name.
DRIVERS: dict[str, Driver] = {
    one.name: one
    for one in (
        Driver("gige", "camera", "GigE Vision cameras", "gige.camera:GigeCamera", "two emulated servers"),
        Driver(
            "aravis", "camera", "GigE and USB3 Vision cameras", "aravis:AravisCamera", "two emulated servers", ("gi",), _APT,
            _aravis,
        ),
        Driver("uvc", "camera", "UVC and V4L2 cameras", "uvc:UvcCamera", "untried", ("cv2",), "pip install opencv-python-headless"),
        Driver(
            "andor", "camera", "intensified cameras of Andor (SDK 2)", "intensified:AndorCamera", "untried", ("pylablib",),
            "pip install pylablib, and Andor's SDK 2",
        ),
        Driver(
            "micro-manager", "camera", "cameras of Micro-Manager", "intensified:MicroManagerCamera", "untried", ("pymmcore",),
            "pip install pymmcore, and Micro-Manager's device adapters",
        ),
        Driver("dg645", "delay", "SRS DG645 on TCP", "dg645:Dg645", "an emulated one"),
        Driver("dg535", "delay", "SRS DG535 behind a Prologix GPIB-Ethernet adapter", "dg535:Dg535", "its protocol"),
        Driver("scope", "scope", "oscilloscopes on TCP, SCPI of Tektronix", "scope:Scope", "an emulated one"),
        Driver(
            "scope-visa", "scope", "the same over USB, GPIB or VXI-11", "scope:Scope", "an emulated one over a VISA socket",
            ("pyvisa", "pyvisa_py"), "pip install 'beambench[drivers]'",
        ),
        Driver("operator", "any", "what is set by hand: a shutter, a reference mirror", "operator:Operator", "untried"),
        Driver("replay", "camera", "a capture, played back as hardware", "replay:Replay", "captures of four modalities"),
    )
}  # fmt: skip


def driver_of(name: object, where: str) -> Driver:
    """The driver of a name. Raises InputError for an unknown one, and for one that lacks something."""
    if not isinstance(name, str) or name not in DRIVERS:
        raise InputError(
            "There is no such driver.",
            where=where,
            value=name,
            allowed=", ".join(DRIVERS),
            next_step="beambench drivers list",
        )
    driver = DRIVERS[name]
    if not driver.there:
        raise InputError(
            f"The driver {name} lacks what it needs: {', '.join(driver.needs)}.",
            where=where,
            value=name,
            next_step=driver.how,
        )
    return driver


def made(name: object, options: Mapping[str, Any], where: str) -> Device:
    """A device, not opened yet, of a driver and its options. Raises InputError for options that the driver does not have."""
    driver = driver_of(name, where)
    module, _, attribute = driver.home.partition(":")
    maker = getattr(import_module(f".{module}", __package__), attribute)
    known = signature(maker).parameters
    for option, value in options.items():
        if option not in known:
            raise InputError(
                f"The driver {name} has no such option.",
                where=f"{where}.{option}",
                value=value,
                allowed=", ".join(known),
            )
        kind: Any = {"str": str, "int": int, "float": (int, float)}.get(str(known[option].annotation), object)
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not object):
            raise InputError(
                "The option has the wrong type.",
                where=f"{where}.{option}",
                value=value,
                allowed=str(known[option].annotation),
            )
    missing = [name for name, one in known.items() if one.default is one.empty and name not in options]
    if missing:
        raise InputError("An option is missing.", where=f"{where}.{missing[0]}", allowed=f"a value of {missing[0]}")
    device: Device = maker(**options)
    return device
