"""Natural waters: refractive index, absorption, scattering, and light scattered once or many times."""
