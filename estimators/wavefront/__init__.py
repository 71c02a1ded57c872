"""Estimators of wavefronts from spot fields: positions of spots, slopes, and reconstructions."""
