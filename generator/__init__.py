"""Scene to capture: the forward models from cheap to complete, the detector, and the choice between them."""
