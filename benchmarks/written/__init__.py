"""Captures made from closed forms in numpy, without a renderer.

Bounds and estimators are judged on them, so they must not come from the code that renders. Each modality has one file
with one function `written_capture(scene, amplitude, background, range_m, seed=...)`: the expected photoelectrons follow
the closed forms of `optics` for the rig of the scene, counts pass the detector chain of `optics.likelihood.model.NoiseModel`
one random step at a time.
"""
