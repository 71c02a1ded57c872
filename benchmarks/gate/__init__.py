"""The gate: a run against its baseline, and speed against another version; red for a regression, and for nothing else."""
