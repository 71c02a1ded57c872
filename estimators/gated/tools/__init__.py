"""What the algorithms for gated stacks share: the stack, its moments, fits and their designs."""
