"""The values of the declared rig that laser-line estimators read."""

from __future__ import annotations

from ..declared import Key, camera_keys

__all__ = ["CALIBRATED", "CAMERA", "LASER_LINE_KEYS"]

#: Parameters that a calibration finds: of the camera, of its distance from the port, and of the laser's plane.
CAMERA = ("focal_px", "principal_row_px", "principal_col_px", "k1", "k2", "p1", "p2", "k3")
CALIBRATED = (*CAMERA, "stand_off_m", "turn_about_axis_rad", "turn_about_fan_rad", "shift_m")

_ALL = "all"
_FLAT, _DOME = (("port.kind", word) for word in ("flat", "dome"))

LASER_LINE_KEYS = (
    Key("camera.rows", "whole", "1", "rows of the image", _ALL),
    Key("camera.cols", "whole", "1", "columns of the image", _ALL),
    Key("camera.focal_length_m", "number", "m", "focal length, in the medium where there is no port", _ALL, above=0),
    Key("camera.pixel_pitch_m", "number", "m", "distance of neighbouring pixels", _ALL, above=0),
    Key("camera.principal_row_px", "number", "px", "row of the optical axis", _ALL),
    Key("camera.principal_col_px", "number", "px", "column of the optical axis", _ALL),
    Key("camera.distortion", "numbers", "1", "Brown's k1, k2, p1, p2, k3; zeros where there is none", _ALL, length=5),
    Key("port.kind", "word", "1", "the window that the camera looks through", _ALL, words=("none", "flat", "dome")),
    Key("port.stand_off_m", "number", "m", "entrance pupil to window", _ALL, case=_FLAT, least=0),
    Key("port.thickness_m", "number", "m", "thickness of the window", _ALL, case=_FLAT, least=0),
    Key("port.inside_index", "number", "1", "refractive index on the camera's side", _ALL, case=_FLAT, least=1),
    Key("port.glass_index", "number", "1", "refractive index of the window", _ALL, case=_FLAT, least=1),
    Key("medium.phase_index", "number", "1", "refractive index of the medium at the laser's wavelength", _ALL, case=_FLAT, least=1),
    Key("port.center_m", "numbers", "m", "centre of the dome from the entrance pupil", _ALL, case=_DOME, length=3),
    Key("port.radius_m", "number", "m", "outer radius of the dome", _ALL, case=_DOME, above=0),
    Key("port.thickness_m", "number", "m", "thickness of the dome", _ALL, case=_DOME, least=0),
    Key("port.inside_index", "number", "1", "refractive index on the camera's side", _ALL, case=_DOME, least=1),
    Key("port.glass_index", "number", "1", "refractive index of the dome", _ALL, case=_DOME, least=1),
    Key("medium.phase_index", "number", "1", "refractive index of the medium at the laser's wavelength", _ALL, case=_DOME, least=1),
    Key("laser.position_m", "numbers", "m", "x, y, z of the laser in the camera frame", _ALL, length=3),
    Key("laser.normal", "numbers", "1", "unit vector across the sheet", _ALL, length=3),
    Key("laser.axis", "numbers", "1", "unit vector along the middle of the sheet, away from the laser", _ALL, length=3),
    Key("laser.waist_m", "number", "m", "full 1/e² thickness of the sheet at its waist", _ALL, above=0),
    Key("laser.waist_at_m", "number", "m", "distance of the waist from the laser", _ALL, least=0),
    Key("laser.divergence_rad", "number", "rad", "full 1/e² divergence of the sheet in the medium", _ALL, least=0),
    Key("laser.fan_half_angle_rad", "number", "rad", "half the angle over which the sheet is spread, in the medium", _ALL, above=0),
    Key("lens_sigma_px", "number", "px", "1 σ of the lens's point spread", _ALL, least=0),
    Key("inclinometers.sigma_deg", "number", "degree", "standard error of a reading of pitch or roll", "level-points",
        least=0, within="inclinometers"),
    *camera_keys(_ALL),
    Key(
        "calibration.parameters.*", "word", "1", "what was calibrated, as deviations from the declared values",
        "triangulate-air, triangulate-pinhole-port, triangulate-refractive", within="calibration", words=CALIBRATED,
    ),
    Key(
        "calibration.covariance.*", "numbers", "1", "covariance of the parameters, row by row, in the units of their names",
        "triangulate-air, triangulate-pinhole-port, triangulate-refractive", within="calibration",
    ),
)  # fmt: skip
