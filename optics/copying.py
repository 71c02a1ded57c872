"""Copying inside compiled kernels.

`a[:] = b` with an array b is compiled by Numba together with the message of the error that tells both shapes, and with all
that writes numbers into text: 1.3 s of compilation in every process that meets it, for a loop of two lines.
"""

from __future__ import annotations

from .jit import kernel

__all__ = ["copy_into"]


@kernel(error_model="numpy")
def copy_into(out, values):  # type: ignore[no-untyped-def]
    """out[i] = values[i] of every element of `values` (n); `out` (n or more) of any type that holds them."""
    for i in range(values.size):
        out[i] = values[i]
