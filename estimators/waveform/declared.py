"""The values of the declared rig that waveform estimators read."""

from __future__ import annotations

from ..declared import Key

__all__ = ["WAVEFORM_KEYS"]

_ALL = "all"
_READOUT = "detector.readout"
_ANALOG = (f"{_READOUT}.kind", "analog")
_PHOTONS = (f"{_READOUT}.kind", "single-photon")

WAVEFORM_KEYS = (
    Key(
        "response", "samples", "s",
        "signal of one photoelectron against time, any scale: the pulse as the detector shows it; 0 s is the centroid of the "
        "emitted pulse", _ALL,
    ),
    Key("medium.group_index", "number", "1", "group refractive index of the medium: pulses travel at c/n", _ALL, above=0),
    Key(
        "pulses_per_shot", "number", "1", "pulses that a shot collects, where the coordinate `pulses` is absent", _ALL, above=0,
        unknown="not needed by analog records; single photons are refused without the coordinate",
    ),
    Key(f"{_READOUT}.kind", "word", "1", "sampled signal, or histogram of counts", _ALL, words=("analog", "single-photon")),
    Key(
        f"{_READOUT}.gain_dn_per_e", "number", "DN/electron", "signal per electron, in the unit of `signal`", _ALL, case=_ANALOG,
        above=0,
        unknown="noise is measured: in the darker half of the records, and that of the light in the residuals of fitted echoes",
    ),
    Key(f"{_READOUT}.offset_dn", "number", "DN", "signal without light", _ALL, case=_ANALOG),
    Key(
        f"{_READOUT}.read_noise_e", "number", "electron", "rms noise of a sample without light", _ALL, case=_ANALOG, least=0,
        unknown="measured in the darker half of every record",
    ),
    Key(
        f"{_READOUT}.full_well_e", "number", "electron", "electrons of a sample at which the amplifier is full", _ALL,
        case=_ANALOG, above=0, unknown="the converter's top is the limit",
    ),
    Key(
        f"{_READOUT}.adc_bits", "whole", "1", "bits of the converter: counts end at 2^bits − 1", _ALL, case=_ANALOG, most=53,
        unknown="the full well is the limit; if that or the gain is unknown too, two neighbouring samples at the capture's "
        "largest value",
    ),
    Key(f"{_READOUT}.avalanche.gain", "number", "1", "gain before the read noise", _ALL, within=f"{_READOUT}.avalanche", above=0),
    Key(
        f"{_READOUT}.avalanche.excess_noise_factor", "number", "1", "excess noise factor F²", _ALL,
        within=f"{_READOUT}.avalanche", above=0,
    ),
    Key(f"{_READOUT}.dead_time_s", "number", "s", "dead time after a count", _ALL, case=_PHOTONS, least=0),
    Key("record.step_s", "number", "s", "distance of samples; read where a record has one sample", _ALL, optional=True, above=0),
    Key(
        "detector_response", "samples", "s",
        "signal of one photoelectron alone; convolved with the `pulse` of each shot. Absent: `pulse` was recorded by the same "
        "detector", "captures with `pulse`", optional=True,
    ),
    Key("counter_hz", "number", "Hz", "frequency of the counter, null where there is none", "waveform-counter", optional=True),
)  # fmt: skip
