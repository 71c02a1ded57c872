"""The values of the declared rig that amplitude-modulation estimators read."""

from __future__ import annotations

from ..declared import ADC_BITS, GAIN, OFFSET, Key

__all__ = ["AMCW_KEYS"]

_ALL = "all"

AMCW_KEYS = (
    Key("modulation.frequencies_hz", "numbers", "Hz", "frequencies; the coordinate `frequency` goes before", _ALL, above=0),
    Key("modulation.phase_steps", "whole", "1", "even phases 2πk/steps; the coordinate `phase` goes before", _ALL, least=3),
    Key("range_window_m", "numbers", "m", "nearest and farthest range of a target, which decides whole cycles", _ALL, length=2),
    Key("t0_s", "number", "s", "lag of the reference behind the light", _ALL),
    Key("medium.group_index", "number", "1", "group refractive index of the medium: light travels at c/n", _ALL, above=0),
    GAIN,
    OFFSET,
    Key("detector.read_noise_e", "number", "electron", "rms read noise of a sample", _ALL, least=0),
    Key(
        "detector.full_well_e", "number", "electron", "electrons at which a sample is full", _ALL, above=0,
        unknown="the converter's top is the limit",
    ),
    ADC_BITS,
)  # fmt: skip
