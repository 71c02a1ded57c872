"""The values of the declared rig that gated estimators read."""

from __future__ import annotations

from ...declared import ADC_BITS, GAIN, OFFSET, Key

__all__ = ["GATED_KEYS"]

_ALL = "all"
_RAYS = "chua-2017, radiometric-average; all, if the laser stands apart from the camera"
_RADIOMETRIC = "radiometric-average"
_BEAM = "radiometric-average, chua-2017"
_WATER = "radiometric-average, poisson-ml-backscatter"
_RAYS_UNKNOWN = "refused by those that need the rays"

GATED_KEYS = (
    Key("camera.rows", "whole", "1", "rows of the array", _ALL),
    Key("camera.cols", "whole", "1", "columns of the array", _ALL),
    Key("camera.focal_length_m", "number", "m", "focal length in the medium", _RAYS, unknown=_RAYS_UNKNOWN, above=0),
    Key("camera.pixel_pitch_m", "number", "m", "distance of neighbouring pixels", _RAYS, unknown=_RAYS_UNKNOWN, above=0),
    Key("camera.principal_row_px", "number", "px", "row of the optical axis", _RAYS, unknown=_RAYS_UNKNOWN),
    Key("camera.principal_col_px", "number", "px", "column of the optical axis", _RAYS, unknown=_RAYS_UNKNOWN),
    Key("laser.position_m", "numbers", "m", "x, y, z of the laser in the camera frame; [0, 0, 0] if coaxial", _ALL, length=3),
    Key(
        "laser.jitter_shot_s", "number", "s",
        "rms delay of single pulses; 0 if `pulse` was recorded as the mean of many, which holds it already", _ALL, least=0,
    ),
    Key("pulse", "samples", "s", "power of the pulse against time, any scale; 0 s is its centroid", _ALL),
    Key("gates.*", "samples", "s", "transmission of a gate, 0 to 1, against time; 0 s is its opening half height", _ALL),
    Key(
        "gate_offset_s.iris_s", "number", "s", "how much later the gate opens in the corners", _ALL, within="gate_offset_s",
    ),
    Key("gate_offset_s.skew_s", "numbers", "s", "the same per half width, along x and y", _ALL, within="gate_offset_s", length=2),
    Key("medium.group_index", "number", "1", "group refractive index of the medium: pulses travel at c/n", _ALL, above=0),
    GAIN,
    OFFSET,
    Key(
        "detector.read_noise_e", "number", "electron", "rms read noise", _ALL, least=0,
        unknown="measured in two or more slices with the laser off; refused where there are fewer",
    ),
    Key(
        "detector.full_well_e", "number", "electron", "electrons at which a pixel is full", _ALL, above=0,
        unknown="the converter's top is the limit",
    ),
    ADC_BITS,
    Key("detector.intensifier.gain", "number", "1", "gain of the tube", _ALL, within="detector.intensifier", above=0),
    Key(
        "detector.intensifier.excess_noise_factor", "number", "1", "excess noise factor F² of the tube", _ALL,
        within="detector.intensifier", above=0,
    ),
    Key(
        "pulses_per_slice", "number", "1", "pulses that a nominal slice collects", _ALL, above=0,
        unknown="slices are weighted by the coordinate `pulses`, evenly if that is absent; refused by radiometric-average",
    ),
    Key("laser.half_angle_rad", "number", "rad", "half angle of the beam", _BEAM, optional=True, least=0),
    Key("laser.offset_rad", "numbers", "rad", "direction of the beam, along x and y", _RADIOMETRIC, optional=True, length=2),
    Key("laser.profile", "words", "1", '"gaussian"; any other is even over the cone', _RADIOMETRIC, optional=True),
    Key("laser.pulse_energy_j", "number", "J", "energy of a pulse", _RADIOMETRIC, optional=True, least=0),
    Key("laser.wavelength_m", "number", "m", "vacuum wavelength", _RADIOMETRIC, optional=True, above=0),
    Key("camera.f_number", "number", "1", "f-number in the medium", _RADIOMETRIC, optional=True, above=0),
    Key("camera.transmission", "number", "1", "transmission of the lens", _RADIOMETRIC, optional=True, least=0),
    Key("camera.quantum_efficiency", "number", "1", "electrons per photon", _RADIOMETRIC, optional=True, least=0),
    Key("medium.absorption_per_m", "number", "1/m", "absorption coefficient of the medium", _WATER, optional=True, least=0),
    Key("medium.scattering_per_m", "number", "1/m", "scattering coefficient of the medium", _WATER, optional=True, least=0),
)  # fmt: skip
