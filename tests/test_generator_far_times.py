"""Times far outside the table of R, or NaN, give zero: they never become an index."""

from __future__ import annotations

import numpy as np

from beambench.generator.rays.returns import Returns, render_stack
from beambench.optics.correlation.response import tabulate
from beambench.optics.correlation.waveforms import GaussianPulse, RectangularGate


def test_times_beyond_single_precision_and_no_times_show_nothing() -> None:
    table = tabulate(GaussianPulse(1e-9), RectangularGate(2e-9, 1.0), 1e-4)
    tau = np.array([1e-9, 1e250, -1e250, np.inf, -np.inf, np.nan])
    tau = np.tile(tau, 100)  # enough for the vector units
    n = tau.size
    for spread in (0.0, 3e-10, 1e250):
        returns = Returns(np.arange(n + 1), np.ones(n), tau, np.full(n, spread))
        out = np.full((3, n), -1.0, dtype=np.float32)
        with np.errstate(over="ignore", invalid="ignore"):
            render_stack(returns, table, np.array([0.0, 1e252, -1e252]), np.ones(3), None, out)
        near = np.arange(n) % 6 == 0
        assert np.all(out[:, ~near] == 0.0) and np.all(out[1:] == 0.0)
        # 1 ns into a gate of 2 ns a pulse of 1 ns is seen nearly whole; spread over all times it is not seen.
        assert np.all(out[0, near] > 0.9) if spread < 1.0 else np.all(out[0] == 0.0)
