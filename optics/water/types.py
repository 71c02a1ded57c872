"""Inherent optical properties of natural waters: absorption, scattering and, where it was measured, the phase function.

The source must always be named, because sources differ by up to a factor of 3.8 in b for one Jerlov type; values of
different sources are never combined. The numbers come from the package `jerlov`, which records their origin.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from .phase_forms import MolecularPhase, PhaseFunction, TabulatedPhase

__all__ = ["WATER_SOURCES", "WaterOptics", "water_optics", "water_types"]

#: Description of each source. Its types: `water_types`.
WATER_SOURCES = {
    "williamson2022": "Jerlov types, measured: Williamson and Hollins, Appl. Opt. 61:9951, 2022; no phase function",
    "solonenko2015": "Jerlov types, Kd inverted: Solonenko and Mobley, Appl. Opt. 54:5392, 2015; no phase function",
    "petzold1972": "eight waters measured at 530 nm: Petzold, SIO Ref. 72-78, 1972; with their scattering functions",
    "pure": "water alone: absorption as used by Williamson and Hollins 2022 (after Buiteveld 1994), scattering Morel 1974",
}

#: Names in the literature of three of Petzold's stations.
_PETZOLD_NAMES = {"clear": "AUTEC 8", "coastal": "HAOCE 11", "harbour": "NUC 2040"}
#: Petzold measured through one green filter; wavelengths further away than this are refused.
_PETZOLD_REACH_NM = 20.0
_SALINITY = {"fresh": 0.0, "sea": 35.0}
_DEPOLARISATION = 0.09


@dataclass(frozen=True)
class WaterOptics:
    """Absorption a and scattering b, 1/m, at `wavelength_m`; `phase` where the source determines it.

    `caveats`: doubts about these values stated by the maintainer of the source, one sentence each.
    """

    source: str
    kind: str
    wavelength_m: float
    absorption_per_m: float
    scattering_per_m: float
    phase: PhaseFunction | None
    citation: str
    caveats: tuple[str, ...]

    @property
    def attenuation_per_m(self) -> float:
        """Beam attenuation c = a + b, 1/m."""
        return self.absorption_per_m + self.scattering_per_m


def water_types(source: str) -> tuple[str, ...]:
    """The types of water in a source. Raises ValueError for an unknown source."""
    import jerlov

    if source == "petzold1972":
        return (*_PETZOLD_NAMES, *jerlov.PETZOLD_STATIONS)
    if source == "pure":
        return tuple(_SALINITY)
    if source in WATER_SOURCES:
        return tuple(jerlov.get_source(source).water_types)
    raise ValueError(f"There is no source of water {source!r}. Sources: {', '.join(WATER_SOURCES)}.")


@lru_cache(maxsize=256)
def water_optics(source: str, kind: str, wavelength_m: float) -> WaterOptics:
    """a, b and phase function of one type of water.

    Main arguments:
        source: a key of `WATER_SOURCES`.
        kind: a type in the source (`water_types`): "III", "harbour", "NUC 2040", "fresh" …
        wavelength_m: in vacuum. Petzold measured at 530 nm only: his values are used for 510 … 550 nm.

    Jerlov's classification determines neither phase function nor backscatter, so `phase` is None there. Petzold's phase
    functions include pure water; below the first angle, .1°, his own power law is continued.

    Raises:
        ValueError: unknown source or type, a wavelength outside the source's data, or a value that the source lacks.
    """
    known = water_types(source)
    if kind not in known:
        raise ValueError(f"{source} has no water type {kind!r}. Types: {', '.join(known)}.")
    nm = round(wavelength_m * 1e9, 9)
    if source == "petzold1972":
        return _petzold(kind, wavelength_m, nm)
    if source == "pure":
        return _pure(kind, wavelength_m, nm)
    import jerlov

    water: Any = jerlov.water(kind, source=source)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always", jerlov.ProvenanceWarning)
        try:
            a, b = float(water.a(nm)), float(water.b(nm))
        except (ValueError, LookupError) as error:
            raise ValueError(f"{source}, {kind} at {nm:g} nm: {error}") from error
    if not (np.isfinite(a) and np.isfinite(b)):
        raise ValueError(f"{source} has no valid value for {kind} at {nm:g} nm.")
    record = jerlov.get_source(source)
    caveats = (*record.caveats, *(str(w.message) for w in told))
    return WaterOptics(source, kind, wavelength_m, a, b, None, record.citation, caveats)


def _petzold(kind: str, wavelength_m: float, nm: float) -> WaterOptics:
    import jerlov

    station = jerlov.petzold_scattering(_PETZOLD_NAMES.get(kind, kind))
    if abs(nm - station.wavelength_nm) > _PETZOLD_REACH_NM:
        raise ValueError(f"Petzold measured at {station.wavelength_nm:g} nm, too far from {nm:g} nm.")
    angle = np.minimum(np.radians(station.angles_deg), np.pi)
    vsf = np.asarray(station.vsf, dtype=np.float64)
    # The report continues below .1° with the slope of its first angles; use the printed share of light below .1°.
    share, first = station.fraction_below_0_1_deg, float(angle[0])
    slope = 2.0 * np.pi * float(vsf[0]) * first**2 / (share * station.b) - 2.0
    phase = TabulatedPhase(tuple(angle.tolist()), tuple(vsf.tolist()), float(slope))
    citation = f"T. J. Petzold, SIO Ref. 72-78 (1972), station {station.station}, {station.locale}, {station.date}"
    caveats = (
        f"Measured at {station.wavelength_nm:g} nm; pure water is included.",
        f"{share:.1%} of b lies below 0.1 degree, where nothing was measured and the report extended its power law.",
    )
    return WaterOptics("petzold1972", kind, wavelength_m, float(station.a), float(station.b), phase, citation, caveats)


def _pure(kind: str, wavelength_m: float, nm: float) -> WaterOptics:
    import jerlov

    try:
        a = float(jerlov.pure_water_absorption(nm))
        b = float(jerlov.pure_water_scattering(nm, _SALINITY[kind]))
    except ValueError as error:
        raise ValueError(f"Pure water at {nm:g} nm: {error}") from error
    citation = "absorption: jerlov, williamson2022_aw (Buiteveld 1994); scattering: Morel 1974 by Boss and Pegau 2001"
    caveats = ("Morel's amplitude is known to about 15 percent.",)
    return WaterOptics("pure", kind, wavelength_m, a, b, MolecularPhase(_DEPOLARISATION), citation, caveats)
