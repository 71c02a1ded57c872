"""Rigs: the specs of the instruments, one kind a file, and what each declares of itself."""
