"""Ambient light from a spectrum: a lamp or the sky, through water and filter, off a surface, into photoelectrons per second.

The chain is that of `optics.ambient`, with standard illuminants and V(λ) by colour-science. No physical value has a default.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from ..optics import ambient, colorimetry
from ..optics.water import attenuation
from .base import Fraction, NonNegative, Positive, Spec

__all__ = ["AmbientSpectrum", "BandFilter", "Spectrum", "WaterPath", "ambient_rate", "without_computed"]

Float = NDArray[np.float64]

#: A black body's irradiance is counted over these wavelengths, m: a silicon detector sees no more.
_BLACK_BODY_M = (300e-9, 1200e-9)
_STEP_M = 1e-9
#: Transmission below this share of the filter's peak counts as none: no water data are needed there.
_DARK = 1e-5
#: This share of the response of filter and efficiency may lie where the source's spectrum is not known.
_UNKNOWN = 1e-3


class Spectrum(Spec):
    """Values at ascending vacuum wavelengths, linear between, zero outside.

    As the spectrum of a source it tells of what lies beyond an end only if the value there is 0.
    """

    wavelength_m: Annotated[tuple[Positive, ...], Field(min_length=2)]
    value: Annotated[tuple[NonNegative, ...], Field(min_length=2)]

    @model_validator(mode="after")
    def _pairs_ascend(self) -> Spectrum:
        if len(self.wavelength_m) != len(self.value):
            raise ValueError("wavelength_m and value need the same length")
        if any(b <= a for a, b in pairwise(self.wavelength_m)):
            raise ValueError("wavelength_m must ascend")
        return self

    def at(self, wavelength_m: Float) -> Float:
        """The values at other wavelengths."""
        return np.interp(wavelength_m, self.wavelength_m, self.value, left=0.0, right=0.0)


class BandFilter(Spec):
    """A band-pass filter before the detector: Gaussian or rectangular, full width at half maximum, peak transmission."""

    shape: Literal["gaussian", "rectangular"]
    centre_m: Positive
    fwhm_m: Positive
    peak: Fraction


class WaterPath(Spec):
    """Water that the light crosses: `down_m` from the surface to the target (diffuse attenuation K_d), `view_m` from the
    target to the lens (beam attenuation c). Sources and types as in `optics.water`; solonenko2015 and pure have K_d."""

    source: Literal["williamson2022", "solonenko2015", "pure"]
    type: str
    down_m: NonNegative
    view_m: NonNegative


class AmbientSpectrum(Spec):
    """Light of a lamp or of the sky that falls on what the detector looks at, a Lambert surface of `reflectance`.

    Its spectrum: one of `illuminant` (a name of colour-science: "A", "D65", "LED-B3" …), `temperature_k` (a black body),
    `spectrum`. Its strength above the water: one of `illuminance_lux` and `irradiance_w_per_m2` (over the whole spectrum; a
    black body's from 300 to 1200 nm). `filter` and `water` are given or "none"; `quantum_efficiency` is "of the detector",
    taken as flat, or a spectrum. The light is even over the field: no vignetting, no shadows.

    A source is not known beyond its table (D65: 780 nm): filter and efficiency that respond there are refused.
    """

    kind: Literal["spectrum"]
    illuminant: str | None = None
    temperature_k: Positive | None = None
    spectrum: Spectrum | None = None
    illuminance_lux: NonNegative | None = None
    irradiance_w_per_m2: NonNegative | None = None
    reflectance: Fraction
    filter: BandFilter | Literal["none"]
    water: WaterPath | Literal["none"]
    quantum_efficiency: Spectrum | Literal["of the detector"]

    @model_validator(mode="after")
    def _one_of_each(self) -> AmbientSpectrum:
        for names in (("illuminant", "temperature_k", "spectrum"), ("illuminance_lux", "irradiance_w_per_m2")):
            given = [name for name in names if getattr(self, name) is not None]
            if len(given) != 1:
                raise ValueError(f"give one of {', '.join(names)}, not {' and '.join(given) or 'none'}")
        if self.illuminant is not None and self.illuminant not in colorimetry.illuminant_names():
            raise ValueError(f"no such illuminant; known are {', '.join(colorimetry.illuminant_names())}")
        self._check_covered()
        self._shares(self._grid())  # raises where the water's source has no data
        return self

    def _source(self) -> tuple[Float, Float]:
        """(wavelength, spectral irradiance above the water, W/(m² m))."""
        if self.illuminant is not None:
            wave, power = colorimetry.illuminant_spectrum(self.illuminant)
        elif self.temperature_k is not None:
            wave = np.arange(_BLACK_BODY_M[0], _BLACK_BODY_M[1] + 0.5 * _STEP_M, _STEP_M)
            power = ambient.planck_radiance(wave, self.temperature_k)
        else:
            assert self.spectrum is not None
            wave, power = np.asarray(self.spectrum.wavelength_m), np.asarray(self.spectrum.value)
        if self.irradiance_w_per_m2 is not None:
            now, wanted = float(np.trapezoid(power, wave)), self.irradiance_w_per_m2
        else:
            now, wanted = colorimetry.illuminance_of(wave, power), float(self.illuminance_lux or 0.0)
        if not now > 0:
            raise ValueError("the spectrum holds no light that a strength could scale")
        return wave, power * (wanted / now)

    def _check_covered(self) -> None:
        """Refuse a response where the source has no data: counted as dark, daylight would be zero at 808 and 905 nm."""
        wave, power = self._source()
        closed = (power[0] == 0.0, power[-1] == 0.0) if self.spectrum is not None else (False, False)
        band, spectral = self.filter, self.quantum_efficiency
        if isinstance(band, BandFilter):
            around = band.centre_m + band.fwhm_m * np.linspace(-3.0, 3.0, 6001)
        elif isinstance(spectral, Spectrum):
            around = np.linspace(spectral.wavelength_m[0], spectral.wavelength_m[-1], 6001)
        elif self.temperature_k is not None or all(closed):
            return
        else:
            raise ValueError(
                f"the source is known from {wave[0] * 1e9:.0f} to {wave[-1] * 1e9:.0f} nm only, and without a filter the "
                "detector's flat efficiency has no end: give a filter, or quantum_efficiency as a spectrum"
            )
        at = np.unique(np.concatenate([around[around > 0], wave]))
        response = np.ones(at.size)
        if isinstance(band, BandFilter):
            square = band.shape == "rectangular"
            response = response * ambient.band_filter(at, band.centre_m, band.fwhm_m, band.peak, square=square)
        if isinstance(spectral, Spectrum):
            response = response * spectral.at(at)
        whole = float(np.trapezoid(response, at))
        for name, side in (
            ("below", (at <= wave[0]) & ~np.bool_(closed[0])),
            ("above", (at >= wave[-1]) & ~np.bool_(closed[1])),
        ):
            if side.sum() > 1 and float(np.trapezoid(response[side], at[side])) > _UNKNOWN * whole:
                end = wave[0] if name == "below" else wave[-1]
                seen = at[side & (response > _UNKNOWN * response.max())] * 1e9
                raise ValueError(
                    f"the source's spectrum is not known {name} {end * 1e9:.0f} nm, and filter and detector respond at "
                    f"{seen.min():.0f} … {seen.max():.0f} nm: give a spectrum that covers these, or ambient_e_per_s"
                )

    def _grid(self) -> Float:
        """Wavelengths that resolve source, filter and efficiency."""
        wave, _ = self._source()
        parts = [wave, np.arange(wave[0], wave[-1], _STEP_M)]
        if isinstance(self.filter, BandFilter):
            width, centre = self.filter.fwhm_m, self.filter.centre_m
            parts.append(centre + width * np.linspace(-3.0, 3.0, 601))
            edge = 0.5 * width * np.array([-1.0, 1.0])
            parts.append(np.concatenate([centre + edge * (1 - 1e-9), centre + edge * (1 + 1e-9)]))
        if isinstance(self.quantum_efficiency, Spectrum):
            parts.append(np.asarray(self.quantum_efficiency.wavelength_m))
        grid = np.unique(np.concatenate(parts))
        return np.asarray(grid[(grid >= wave[0]) & (grid <= wave[-1])])

    def _shares(self, wave: Float) -> tuple[Float, Float]:
        """(transmission of the filter, of the water) on a grid."""
        passed = np.ones(wave.size)
        if isinstance(self.filter, BandFilter):
            f = self.filter
            passed = ambient.band_filter(wave, f.centre_m, f.fwhm_m, f.peak, square=f.shape == "rectangular")
        clear = np.ones(wave.size)
        if isinstance(self.water, WaterPath):
            w = self.water
            need = passed > _DARK * max(float(passed.max()), 1e-300)
            lost = np.zeros(wave.size)
            if w.down_m > 0:
                lost[need] += w.down_m * ambient.diffuse_attenuation(w.source, w.type, wave[need])
            lost[need] += w.view_m * attenuation.light_attenuation(w.source, w.type, wave[need])
            if not np.isfinite(lost).all():
                bad = wave[~np.isfinite(lost)] * 1e9
                raise ValueError(
                    f"{w.source}, {w.type} has no value for {bad.min():.0f} … {bad.max():.0f} nm, which the filter lets pass"
                )
            clear = np.where(need, np.exp(-lost), 0.0)
        return passed, clear

    def at_the_target(self) -> tuple[Float, Float]:
        """(wavelength, light of a white target as an eye beside the lens sees it): no filter; zero where water has no data."""
        wave, power = self._source()
        grid = np.arange(wave[0], wave[-1], 5 * _STEP_M)
        seen = np.interp(grid, wave, power)
        if isinstance(self.water, WaterPath):
            w = self.water
            lost = w.view_m * attenuation.light_attenuation(w.source, w.type, grid)
            if w.down_m > 0:
                lost = lost + w.down_m * ambient.diffuse_attenuation(w.source, w.type, grid)
            seen = seen * np.nan_to_num(np.exp(-lost))
        return grid, seen

    def rate_e_per_s(self, etendue_m2_sr: float, quantum_efficiency: float) -> float:
        """Photoelectrons per second at an open gate: G ∫ ρE/π · water · filter · QE · λ/(hc) dλ.

        Main arguments:
            etendue_m2_sr: of a pixel or photodetector, times the lens's transmission.
            quantum_efficiency: of the detector, where the spec gives no spectrum.
        """
        grid = self._grid()
        wave, power = self._source()
        passed, clear = self._shares(grid)
        radiance = ambient.diffuse_radiance(np.interp(grid, wave, power), self.reflectance) * clear
        spectral = self.quantum_efficiency
        efficiency: Any = spectral.at(grid) if isinstance(spectral, Spectrum) else quantum_efficiency
        return ambient.photoelectron_rate(
            grid, radiance, etendue_m2_sr=etendue_m2_sr, filter_transmission=passed, quantum_efficiency=efficiency
        )


def ambient_rate(rig: Any, etendue_m2_sr: float, quantum_efficiency: float) -> float:
    """A rig's `ambient_e_per_s`: as given, or from its `ambient` spectrum. Raises ValueError unless exactly one is given."""
    given = "ambient_e_per_s" in rig.model_fields_set
    if given == (rig.ambient is not None):
        raise ValueError("give either ambient_e_per_s or ambient, a spectrum")
    if rig.ambient is None:
        return float(rig.ambient_e_per_s)
    return float(rig.ambient.rate_e_per_s(etendue_m2_sr, quantum_efficiency))


def without_computed(data: dict[str, Any], optional: tuple[str, ...] = ()) -> dict[str, Any]:
    """A rig's data as it was given: the rate that a spectrum gives is left out, and so are an absent spectrum and the absent ones
    of the `optional` values."""
    for key in optional:
        if data.get(key) is None:
            data.pop(key, None)
    data.pop("ambient" if data.get("ambient") is None else "ambient_e_per_s", None)
    return data
