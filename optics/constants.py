"""Constants of nature, exact by definition of the SI (2019)."""

from __future__ import annotations

#: Speed of light in vacuum, m/s.
C_M_PER_S = 299_792_458.0
#: Planck's constant, J s.
PLANCK_J_S = 6.626_070_15e-34
#: sqrt(8 ln 2): full width at half maximum of a Gaussian, in standard deviations.
FWHM_PER_SIGMA = 2.354_820_045_030_949_3
