"""The forward model of range-gated stacks."""
