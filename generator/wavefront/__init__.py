"""The forward model of gated Shack-Hartmann sensors: phase in the pupil, spots on the camera, and their detector."""
