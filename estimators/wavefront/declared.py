"""The values of the declared rig that estimators of wavefronts read."""

from __future__ import annotations

from ..declared import Key, camera_keys

__all__ = ["WAVEFRONT_KEYS"]

_ALL, _SPOTS, _MODES = "all", "centroids", "reconstructions"
_LAYERS, _IMAGES = "turbulence-ml, for the range of a layer", "deblur-tv"

WAVEFRONT_KEYS = (
    Key("laser.wavelength_m", "number", "m", "vacuum wavelength", _MODES, above=0),
    Key("lenslets.pitch_m", "number", "m", "distance of neighbouring lenslets", _ALL, above=0),
    Key("lenslets.focal_length_m", "number", "m", "focal length of the lenslets", _ALL, above=0),
    Key(
        "lenslets.grid", "word", "1", "shape of the lenslets, square where it is left out; pitch and width between flats are equal",
        _ALL, optional=True, words=("square", "hexagonal"),
    ),
    Key("lenslets.rotation_rad", "number", "rad", "turn of the array from the camera's x toward its y", _MODES),
    Key("lenslets.row", "numbers", "1", "row of each used lenslet in the array", _MODES, least=0),
    Key("lenslets.col", "numbers", "1", "column of each used lenslet in the array", _MODES, least=0),
    Key("lenslets.x_m", "numbers", "m", "centre of each lenslet along the array's columns, 0 at the pupil's centre", _MODES),
    Key("lenslets.y_m", "numbers", "m", "centre of each lenslet along the array's rows", _MODES),
    Key("lenslets.row_px", "numbers", "px", "row of the spot of a flat wavefront", _SPOTS),
    Key("lenslets.col_px", "numbers", "px", "column of the spot of a flat wavefront", _SPOTS),
    Key("pupil.shape", "word", "1", "shape of the pupil", _MODES, words=("disc", "square")),
    Key("pupil.diameter_m", "number", "m", "diameter or side of the pupil", _MODES, above=0),
    Key("pupil.samples", "whole", "1", "samples of a side of the grid on which phases are given", _MODES),
    Key("pupil.step_m", "number", "m", "distance of these samples", _MODES, above=0),
    Key("pupil.modes", "whole", "1", "greatest Noll index of the coefficients that are scored", _MODES, least=2),
    Key("camera.rows", "whole", "1", "rows of the image", _SPOTS),
    Key("camera.cols", "whole", "1", "columns of the image", _SPOTS),
    Key("camera.pixel_pitch_m", "number", "m", "distance of neighbouring pixels", _ALL, above=0),
    Key("spot.start_px", "number", "px", "first sample of the spot of a flat wavefront along one axis, before pixels", _SPOTS),
    Key("spot.step_px", "number", "px", "distance of the samples of the spot", _SPOTS, above=0),
    Key("spot.value", "numbers", "1", "the spot's samples, of any scale", _SPOTS),
    Key("reference.exposures", "whole", "1", "exposures that the reference is the mean of", _SPOTS),
    Key("gate.centre_s", "number", "s", "centroid of the gate's transmission after its opening edge", _LAYERS, within="gate"),
    Key("bench.laser_arm_m", "number", "m", "way through air from the laser to the last splitter", _LAYERS, within="gate", least=0),
    Key("bench.camera_arm_m", "number", "m", "way through air from that splitter to the array", _LAYERS, within="gate", least=0),
    Key("medium.group_index", "number", "1", "group index of the water", _LAYERS, within="gate", above=0),
    Key("reflection", "word", "1", "what the reflectors are", _LAYERS, within="gate", words=("mirror", "diffuse")),
    Key("imager.photoelectrons", "number", "electron", "electrons of a white pixel of `image`", _IMAGES, within="imager", above=0),
    Key("imager.read_noise_e", "number", "electron", "rms read noise of a pixel of `image`", _IMAGES, within="imager", least=0),
    *camera_keys(_SPOTS),
)  # fmt: skip
