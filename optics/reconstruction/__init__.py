"""From slopes to a wave: zonal and modal linear algebra, priors, and the errors that follow from them."""
