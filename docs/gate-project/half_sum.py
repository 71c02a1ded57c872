"""Half sum: the delay at which half of the light of a gated stack has been collected."""

import numpy as np
import xarray as xr

from beambench.estimators import estimator, range_result, read_stack


@estimator("gated", cites="none: an example of a project that is gated")
def half_sum(capture: xr.Dataset, *, least_sigmas: float = 5.0) -> xr.Dataset:
    """Range of the median of the counts over delay, above the median count of each pixel."""
    stack = read_stack(capture)
    rig = stack.instrument
    used = stack.slices[stack.group < stack.signal]
    time = stack.centroid_delay_s[stack.group[stack.group < stack.signal]]
    order = np.argsort(time, kind="stable")
    light = (stack.counts[used[order]] - rig.offset_dn) / rig.dn_per_pe
    below = np.cumsum(light - np.median(light, axis=0), axis=0)
    total = below[-1]
    noise = np.sqrt(used.size * (rig.excess * np.maximum(light.mean(axis=0), 0.0) + rig.floor_var))
    index = np.clip((below >= 0.5 * total).argmax(axis=0), 1, used.size - 1)
    here, before = (np.take_along_axis(below, i[None], axis=0)[0] for i in (index, index - 1))
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (0.5 * total - before) / (here - before)
        sigma = np.sqrt(0.5 * np.pi * rig.responses[0].variance_s2 / total)
    tau = time[order][index - 1] + (share + 0.5) * stack.spacing_s()
    return range_result(*rig.to_range(tau, sigma), total > least_sigmas * noise)
