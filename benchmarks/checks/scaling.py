"""Cost of an estimator against size: CPU time and memory against pixels and slices, with the fitted exponent.

    python -m beambench.benchmarks.checks.scaling poisson-ml weighted-average --out scaling

Stacks come from a closed form (`written.gated_stack`), with the same light per pixel at every size. The estimator runs in a
child process as in a suite: one thread, warmed up, timed around the call. The order of sizes changes from repeat to
repeat, so that a machine that slows down does not change the exponent.

    cost(n) = a n^q          between the given sizes; q by least squares on logarithms, its interval from the scatter
                             between repeats or about the line, whichever is larger (curvature counts as scatter).

At small sizes a constant cost dominates: `knee` is the size at which the cost is twice that constant. Linear growth is
therefore tested with a constant: `excess` is the cost of the largest size over the prediction of the line a + b·n through
all smaller sizes, with its 95 % interval; above 1 the cost grows faster than linearly. Costs of different device classes
are never fitted together.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from ...scenes.errors import InputError
from ..folders.files import write_text

__all__ = ["Cost", "Exponent", "fit_exponent", "measure_scaling"]

Axis = Literal["pixels", "slices"]

_PIXELS = (2**12, 2**14, 2**16, 2**18)
_SLICES = (16, 32, 64, 128, 256)


@dataclass(frozen=True)
class Cost:
    """One timed call: estimator, size, class of device, and cost."""

    estimator: str
    axis: Axis
    size: int
    repeat: int
    device_class: str
    cpu_s: float
    wall_s: float
    peak_bytes: float
    status: str


@dataclass(frozen=True)
class Exponent:
    """cost ∝ size^value on one axis and device class, with its 95 % interval `low`, `high`.

    `end`: the exponent between the two largest sizes alone. `excess` with its interval: cost of the largest size over
    the line a + b·n of the others. `largest_s`, `per_element_s`, `spread`: CPU time at the largest size, the same per
    element, its relative spread between repeats. `knee`: in the unit of size, NaN where the line holds throughout.
    """

    estimator: str
    axis: Axis
    device_class: str
    value: float
    low: float
    high: float
    end: float
    largest_s: float
    per_element_s: float
    spread: float
    knee: float
    excess: float
    excess_low: float
    excess_high: float


def fit_exponent(costs: Sequence[Cost]) -> Exponent:
    """Fit CPU time against size.

    With y = ln cost and x = ln size of m sizes, q = Σ(x−x̄)ȳ_i/Σ(x−x̄)² over the medians ȳ_i of each size's repeats. Its
    standard error comes from the residuals of the ȳ_i about the line (m − 2 degrees of freedom) and from their own
    scatter between repeats; the larger counts. `knee`: n₀ = a/b of the fit a + b·n^q' to the medians with q' the slope
    between the two largest sizes, where a exceeds twice the smallest cost's spread; below it a constant cost rules.

    Raises:
        InputError: fewer than three sizes, costs of more than one estimator, axis or device class, or no call with
        status "ok".
    """
    good = [cost for cost in costs if cost.status == "ok" and cost.cpu_s > 0]
    kinds = {(cost.estimator, cost.axis, cost.device_class) for cost in costs}
    if len(kinds) > 1:
        raise InputError(
            "Costs of several estimators, axes or device classes are not fitted together.", where="costs",
            value=str(sorted(kinds)), next_step="group them first",
        )  # fmt: skip
    sizes = sorted({cost.size for cost in good})
    if len(sizes) < 3:
        raise InputError(
            "An exponent needs at least three sizes at which the estimator ran.", where="costs", value=str(sizes),
            next_step="check the status of the others",
        )  # fmt: skip
    estimator, axis, device = next(iter(kinds))
    groups = [np.array([cost.cpu_s for cost in good if cost.size == size]) for size in sizes]
    x, middle = np.log(np.asarray(sizes, np.float64)), np.array([float(np.median(np.log(group))) for group in groups])
    value, low, high = _line(x, middle, groups)
    largest = float(np.exp(middle[-1]))
    last = groups[-1]
    spread = float(last.std(ddof=1) / last.mean()) if last.size > 1 else math.nan
    end = float((middle[-1] - middle[-2]) / (x[-1] - x[-2]))
    return Exponent(
        estimator, axis, device, value, low, high, end, largest, largest / sizes[-1], spread, _knee(x, middle, groups),
        *_excess(np.asarray(sizes, np.float64), middle, groups),
    )  # fmt: skip


def _line(
    x: npt.NDArray[np.float64], y: npt.NDArray[np.float64], groups: Sequence[npt.NDArray[np.float64]]
) -> tuple[float, float, float]:
    from scipy.stats import t

    centred = x - x.mean()
    weight = centred / float((centred**2).sum())
    value = float(weight @ y)
    residual = y - y.mean() - value * centred
    about = float((residual**2).sum()) / (x.size - 2) * float((weight**2).sum())
    # Variance of a median of few values: π/2 that of the mean, for a normal scatter.
    own = [float(np.log(g).var(ddof=1)) / g.size * math.pi / 2 if g.size > 1 else 0.0 for g in groups]
    between = float((weight**2) @ np.array(own))
    freedom = sum(g.size - 1 for g in groups)
    half = float(t.ppf(0.975, x.size - 2)) * math.sqrt(about)
    if freedom > 0:
        half = max(half, float(t.ppf(0.975, freedom)) * math.sqrt(between))
    return value, value - half, value + half


def _excess(
    n: npt.NDArray[np.float64], y: npt.NDArray[np.float64], groups: Sequence[npt.NDArray[np.float64]]
) -> tuple[float, float, float]:
    """(ratio, low, high) of the cost of the largest size to the line a + b·n through the others, weighted by 1/cost².

    The interval is from the scatter between repeats, pooled over sizes in relative terms (NaN without repeats), propagated
    through the weighted least squares: prediction = g·c with c the medians of the smaller sizes.
    """
    from scipy.stats import t

    cost = np.exp(y)
    design = np.stack([np.ones(n.size - 1), n[:-1]], axis=1) / cost[:-1, None]
    gain = np.array([1.0, n[-1]]) @ np.linalg.pinv(design) / cost[:-1]
    predicted = float(gain @ cost[:-1])
    if not predicted > 0:
        return math.nan, math.nan, math.nan
    ratio, freedom = float(cost[-1]) / predicted, sum(g.size - 1 for g in groups)
    if freedom < 1:
        return ratio, math.nan, math.nan
    scatter = math.sqrt(sum(float(((np.log(g) - np.log(g).mean()) ** 2).sum()) for g in groups) / freedom)
    # Relative error of each median: π/2 of a mean's variance.
    each = np.array([scatter * math.sqrt(math.pi / 2 / g.size) for g in groups])
    share = gain * cost[:-1] / predicted
    half = float(t.ppf(0.975, freedom)) * math.sqrt(float(((share * each[:-1]) ** 2).sum()) + float(each[-1]) ** 2)
    return ratio, ratio * math.exp(-half), ratio * math.exp(half)


def _knee(x: npt.NDArray[np.float64], y: npt.NDArray[np.float64], groups: Sequence[npt.NDArray[np.float64]]) -> float:
    power = (y[-1] - y[-2]) / (x[-1] - x[-2])
    if not power > 0.05:
        return math.nan
    scale = (math.exp(y[-1]) - math.exp(y[0])) / (math.exp(power * x[-1]) - math.exp(power * x[0]))
    constant = math.exp(y[0]) - scale * math.exp(power * x[0])
    scatter = float(groups[0].std(ddof=1)) if groups[0].size > 1 else 0.0
    if scale <= 0 or constant <= max(2.0 * scatter, 0.02 * math.exp(y[0])):
        return math.nan
    return float((constant / scale) ** (1.0 / power))


def measure_scaling(
    label: str, *, axis: Axis = "pixels", sizes: Sequence[int] | None = None, repeats: int = 5, slices: int = 64,
    pixels: int = 2**16, electrons: float = 500.0, seed: int = 1, time_s: float = 60.0,
    memory_bytes: int = 4 * 2**30,
) -> list[Cost]:  # fmt: skip
    """Time a gated estimator over sizes.

    Main arguments:
        label: `name[key=value]`. axis: the size that is varied; the other is fixed at `slices` or `pixels`.
    Other arguments:
        sizes: at least three; images are square, or nearly. repeats: visits of each size.
        electrons: photoelectrons of an echo over all slices. seed: of order and noise. time_s, memory_bytes: limits of a call.

    A size at which the estimator fails gives a `Cost` with its status. Raises InputError for too few sizes.
    """
    from ...captures.hide import hide_truth
    from ...captures.sizes import sizes_of
    from ..folders.record import machine
    from ..runner.protocol import write_capture, write_meta
    from ..runner.session import Job, Outcome, run_jobs
    from ..suites.spec import Limits

    chosen = sorted(set(sizes or (_PIXELS if axis == "pixels" else _SLICES)))
    if len(chosen) < 3 or chosen[0] < 8:
        raise InputError("Scaling needs at least three sizes of 8 or more.", where="sizes", value=str(chosen))
    rng = np.random.Generator(np.random.PCG64(seed))
    device = str(machine()["device_class"])
    limits = Limits(time_s=time_s, warmup_s=max(120.0, time_s), memory_bytes=memory_bytes, output_bytes=2**20)
    costs: list[Cost] = []
    with tempfile.TemporaryDirectory(prefix="beambench-scaling-") as scratch:
        base = Path(scratch)
        known: dict[int, tuple[str, dict[str, int]]] = {}
        for size in chosen:
            capture = hide_truth(_stack(axis, size, slices, pixels, electrons, rng))
            write_capture(base / str(size), capture)
            write_meta(base / str(size), capture, "matched")
            known[size] = str(capture.attrs["modality"]), sizes_of(capture)
        plan = [(repeat, int(size)) for repeat in range(repeats) for size in rng.permutation(chosen)]
        jobs = [Job(index, base / str(size), "matched", *known[size]) for index, (_, size) in enumerate(plan)]

        def take(outcome: Outcome) -> None:
            repeat, size = plan[outcome.job.index]
            costs.append(
                Cost(
                    label, axis, size, repeat, device, outcome.cpu_s, outcome.wall_s, outcome.peak_bytes, outcome.status
                )
            )

        run_jobs(label, jobs, limits, base / "scratch", take)
    return costs


def _stack(axis: Axis, size: int, slices: int, pixels: int, electrons: float, rng: np.random.Generator) -> Any:
    """A Gaussian stack of the given size: delays of the echoes spread over the middle half of the window."""
    from ..written.gated_stack import GaussianRig, stack_capture

    count, number = (slices, size) if axis == "pixels" else (size, pixels)
    rows = max(1, math.isqrt(number))
    cols = -(-number // rows)
    # The window is fixed; more slices sample it more finely.
    rig = GaussianRig(slices=count, step_s=16e-9 / count)
    tau = rig.start_s + rig.centre_s + 16e-9 * rng.uniform(0.25, 0.75, (rows, cols))
    counts = rng.poisson(rig.electrons(tau, electrons, 2.0 * 64 / count)).astype(np.uint16)
    return stack_capture(rig, counts)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print exponents of the named estimators on both axes."""
    import argparse

    parser = argparse.ArgumentParser(prog="python -m beambench.benchmarks.checks.scaling", description=__doc__)
    parser.add_argument("estimators", nargs="+")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--json", action="store_true", help="every timed call as a line of JSON")
    parser.add_argument("--out", type=Path, help="folder for scaling.csv (calls) and exponents.csv")
    chosen = parser.parse_args(arguments)
    calls: list[dict[str, Any]] = []
    fits: list[dict[str, Any]] = []
    print(
        f"{'estimator':36} {'axis':7} exponent  95 % interval      end  over the line          largest s  per element s"
        "  spread   knee"
    )
    for label in chosen.estimators:
        for axis in ("pixels", "slices"):
            costs = measure_scaling(label, axis=axis, repeats=chosen.repeats)
            calls += [asdict(cost) for cost in costs]
            if chosen.json:
                import json

                for cost in costs:
                    print(json.dumps(asdict(cost)))
            fit = fit_exponent(costs)
            fits.append(asdict(fit))
            over = f"{fit.excess:.3f} [{fit.excess_low:.3f}, {fit.excess_high:.3f}]"
            knee = f"{fit.knee:.3g}" if fit.knee == fit.knee else "-"
            print(
                f"{label:36} {axis:7} {fit.value:8.3f}  [{fit.low:.3f}, {fit.high:.3f}] {fit.end:8.3f}  {over:20} "
                f"{fit.largest_s:10.4g} "
                f"{fit.per_element_s:13.3g} {100 * fit.spread:6.1f}% {knee:>6}"
            )
    if chosen.out is not None:
        from ..scores.tables import to_csv

        chosen.out.mkdir(parents=True, exist_ok=True)
        write_text(chosen.out / "scaling.csv", to_csv(calls, [field.name for field in fields(Cost)]))
        write_text(chosen.out / "exponents.csv", to_csv(fits, [field.name for field in fields(Exponent)]))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
