"""The detector chain whose likelihood is computed: a frozen, hashable record, so that tables can be cached by it."""

from __future__ import annotations

import math
from dataclasses import dataclass

__all__ = ["NoiseModel"]


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """Noise of one sample of one pixel.

    n ~ Poisson(μ); an intensifier gives x ~ Gamma(shape n/(F²−1), scale G(F²−1)), of mean Gn and, over n, variance
    G²F²μ; dark electrons ~ Poisson(dark_e) are added after it; x is clipped at the full well; Gaussian read noise is
    added; DN = clip(round(gain·x + offset), 0, adc_max).

    Main arguments (electrons are those in the sensor's well):
        read_noise_e: σ of the read noise [electrons], >= 0.
        gain_dn_per_e: K [DN per electron], > 0.
        offset_dn: [DN].
        adc_max_dn: largest code, 2^bits − 1.
        full_well_e: [electrons], > 0.
    Other arguments:
        excess_noise_factor: F² >= 1; 1 with `intensifier_gain` 1 is a bare sensor.
        intensifier_gain: G > 0, electrons in the well per photoelectron of the cathode.
        dark_e: mean dark electrons per sample, >= 0.

    Fixed pattern (PRNU, DSNU) is not noise of one pixel and is not modelled. Raises ValueError for a value out of range.
    Source: EMVA Standard 1288, release 4.0 (linear camera model), 2021.
    """

    read_noise_e: float
    gain_dn_per_e: float
    offset_dn: float
    adc_max_dn: int
    full_well_e: float
    excess_noise_factor: float = 1.0
    intensifier_gain: float = 1.0
    dark_e: float = 0.0

    def __post_init__(self) -> None:
        checks = (
            ("read_noise_e", self.read_noise_e, self.read_noise_e >= 0.0, ">= 0"),
            ("gain_dn_per_e", self.gain_dn_per_e, self.gain_dn_per_e > 0.0, "> 0"),
            ("adc_max_dn", self.adc_max_dn, self.adc_max_dn >= 1, ">= 1"),
            ("offset_dn", self.offset_dn, self.offset_dn < self.adc_max_dn - 0.5, "below the last code"),
            ("full_well_e", self.full_well_e, self.full_well_e > 0.0, "> 0"),
            ("excess_noise_factor", self.excess_noise_factor, self.excess_noise_factor >= 1.0, ">= 1"),
            ("intensifier_gain", self.intensifier_gain, self.intensifier_gain > 0.0, "> 0"),
            ("dark_e", self.dark_e, self.dark_e >= 0.0, ">= 0"),
        )
        for name, value, good, allowed in checks:
            if not good or not math.isfinite(value):
                raise ValueError(f"{name} = {value!r} is not allowed; it must be finite and {allowed}")
            if name != "adc_max_dn":  # one compiled kernel whether the caller wrote 1 or 1.0
                object.__setattr__(self, name, float(value))

    @property
    def intensified(self) -> bool:
        """True where the electrons in the well are not the photoelectrons themselves."""
        return self.excess_noise_factor > 1.0 or self.intensifier_gain != 1.0

    @property
    def ceiling_e(self) -> float:
        """Electrons in the well at which the chain saturates: the full well or the last ADC step."""
        return min(self.full_well_e, (self.adc_max_dn - 0.5 - self.offset_dn) / self.gain_dn_per_e)

    def mean_e(self, mu: float) -> float:
        """Mean electrons in the well, before clipping, for μ photoelectrons."""
        return self.intensifier_gain * mu + self.dark_e

    def well_variance_e2(self, mu: float) -> float:
        """Variance [electrons²] in the well, before clipping and read noise."""
        return self.intensifier_gain**2 * self.excess_noise_factor * mu + self.dark_e

    def sample_variance(self, mu: float) -> float:
        """Variance [photoelectrons²] of a sample of μ photoelectrons, before clipping: F²μ + (dark_e + σ_read² + 1/(12 K²))/G²."""
        after = self.read_noise_e**2 + 1.0 / (12.0 * self.gain_dn_per_e**2)
        return (self.well_variance_e2(mu) + after) / self.intensifier_gain**2
