"""Section 6 of Guo et al. 2017, gated wavefront sensing: Eq. 26 to 34 and Figures 13 to 16."""

from __future__ import annotations

import math

import numpy as np

from ...optics.constants import C_M_PER_S
from ...optics.deconvolution import objective_eq32_as_printed, transfer_of
from ...optics.lenslets.guo import dynamic_range_eq34, range_eq26, sensitivity_eq33
from ...optics.water.refraction import water_group_index, water_phase_index
from . import turbulence_sensor as sensor
from .rows import Row, judge_exact, judge_settings
from .turbulence_order import (
    BY_FLOW,
    BY_RANGE,
    CHANCE,
    FOCAL_M,
    PITCH_M,
    PIXEL_M,
    WAVELENGTH_M,
    Reading,
    chance_of_order,
    even,
    frames_needed,
    readings,
    stepped,
)

__all__ = ["PUPILS_M", "turbulence_rows"]

_NAN = math.nan
#: Diameters of the pupil [m]: none is printed. 8 and 20 lenslets.
PUPILS_M = (8 * PITCH_M, 20 * PITCH_M)
#: Arms L1 = L2 [m]: printed as equal, without a length.
_ARM_M = 0.3
_TABLE = "r0 by flow and range; pupil; modes; light"
#: Ratios of r₀ from one setting to the next: nothing printed excludes any.
_STEPS = (1.1, 1.5, 2.0, 3.0, 6.0)


def turbulence_rows() -> list[Row]:
    """All rows of section 6, in the order of the document."""
    return [
        *_range_rows(),
        *_spot_rows(),
        *_series_rows(),
        *_deblurring_rows(),
        *_sensor_rows(),
        *_order_rows(),
        *_text_rows(),
    ]


def _range_rows() -> list[Row]:
    group, phase = (index(WAVELENGTH_M, 20.0, 0.0) for index in (water_group_index, water_phase_index))
    echo = 2.0 * 4.0 * group / C_M_PER_S
    by_phase = float(range_eq26(echo, C_M_PER_S / phase)) - 4.0
    arms = float(range_eq26(echo + 2.0 * _ARM_M / C_M_PER_S, C_M_PER_S / group)) - 4.0
    return [
        Row("Eq. 26", "range with the speed c/n less that with the pulse's speed, target at 4 m", "mm", _NAN, 1e3 * by_phase, 1.0,
            judge_settings(abs(1e3 * error) <= 1.0 for error in (0.0, by_phase)),
            "«the speed of light in the working condition» does not say which: a pulse travels at c over the group index, "
            f"{group:.4f} in fresh water of 20 °C, where the refractive index is {phase:.4f}", "speed"),
        Row("Eq. 26", "range with time counted from the laser less the true one, L1 = L2 = .3 m", "mm", _NAN, 1e3 * arms, 1.0,
            judge_settings(abs(1e3 * error) <= 1.0 for error in (0.0, arms)),
            "L1 = L2 is said to simplify the calculation, but L1 + L2 is part of t₀ where time is counted from the laser. It drops "
            "out where t₀ is counted from the echo of the second prism; the text does not say which", "start of t0; L1"),
    ]  # fmt: skip


def _spot_rows() -> list[Row]:
    moved = sensor.displacement_over_slope()
    aliasing = {alpha: sensor.aliasing_px(alpha) for alpha in (1.0, 1.5, 2.0, 3.0)}
    shown = {(width, alpha, level): sensor.share_shown(0.5, alpha, width, level)
             for width in (5, 8) for alpha in (1.0, 2.0) for level in (0.0, 0.01, 0.05)}  # fmt: skip
    return [
        Row("Eq. 27", "Δx/f over the mean slope of the wavefront", "1", _NAN, moved, 0.01, judge_exact(1.0, moved, 0.01),
            "by diffraction at lenslets behind Kolmogorov turbulence of d/r₀ = .13, 100 of them; the centre of gravity is "
            "taken over "
            "64 λf/d, beyond which .3 % of a displacement lies. The symbols Δd_x, Δd_y that the text explains are not in the "
            "equation"),
        Row("Eq. 28", "greatest error of X_c as a spot crosses a pixel, α = 2, without noise", "px", _NAN, aliasing[2.0], 0.01,
            judge_settings(error <= 0.01 for error in aliasing.values()),
            f"λf/d is {sensor.SPOT_PX:.3f} pixels, so that I^α is sampled finely enough up to that α only: "
            + ", ".join(f"{error:.1g} px for α = {alpha:g}" for alpha, error in aliasing.items())
            + ". The text gives no α, and calls I^α «the α th high intensity value», which is another rule", "α"),
        Row("Eq. 28", "X_c over the displacement, window of 5 pixels, α = 1, background 1 % of the peak", "1", _NAN,
            shown[5, 1.0, 0.01], 0.02, judge_settings(abs(share - 1.0) <= 0.02 for share in shown.values()),
            "a spot moved by half a pixel. A background pulls X_c to the middle of the window, and what leaves the window is lost; "
            f"over windows of 5 and 8 pixels, α of 1 and 2 and backgrounds of 0, 1 and 5 %: {min(shown.values()):.2f} … "
            f"{max(shown.values()):.2f}. L, M, α and the background are not given", "L, M; α; background"),
    ]  # fmt: skip


def _series_rows() -> list[Row]:
    shares = {
        (last, across): sensor.share_of_peak_to_valley(last, across) for last, across in ((10, 8), (15, 8), (66, 20))
    }
    return [
        Row("Eq. 30", "peak-to-valley of the sum up to Noll's mode 15 over that of the wavefront", "1", _NAN, shares[15, 8], 0.05,
            judge_settings(abs(share - 1.0) <= 0.05 for share in shares.values()),
            "least squares from slopes of noise-free spots, Kolmogorov turbulence: "
            + ", ".join(f"{share:.2f} with {last} modes and {across} lenslets across"
                        for (last, across), share in shares.items())
            + ". The text gives neither k nor the order of the modes; C_0, from which the sum starts, is the piston, which slopes "
            "do not show", "k; lenslets"),
    ]  # fmt: skip


def _deblurring_rows() -> list[Row]:
    image = np.kron(np.eye(2), np.ones((8, 8)))  # any image that is not black
    transfer = transfer_of(np.ones((1, 1)), image.shape)
    black, true = (objective_eq32_as_printed(u, transfer, 0.0, 0.01) for u in (np.zeros_like(image), image))
    strengths = tuple(sorted({round(pupil / r0, 6) for pupil in PUPILS_M for r0 in (BY_FLOW[0], BY_FLOW[3])}))
    once, mirrored = ({d: sensor.deblurring_gain_db(d, ways) for d in strengths} for ways in (1, 2))
    worst = strengths[-1]
    flat, _ = sensor.deblurring_gain_db(worst, 0)
    free = "Δ; noise; image; r0; pupil"
    return [
        Row("Eq. 32", "objective as printed of a black image over that of the true image", "1", _NAN, black / true, 0.0,
            "arithmetic" if black >= true else "contradicted",
            "the noise p stands where the image v is meant, which occurs nowhere in it: with noise of zero mean taken as 0 "
            "the minimum "
            "is u = 0, whatever was seen. ‖u‖ for the total variation of u does not change that"),
        Row("Eq. 32", "gain of PSNR as meant, H of the wavefront of one pass, 40 L/min, pupil of 3 mm", "dB", _NAN, once[worst][0],
            _NAN, judge_settings(mean - 1.96 * error > 0.0 for mean, error in once.values()),
            "v for p, total variation for the norm. The lower end of the 95 % interval is above 0 for 10 and 40 L/min and for "
            "pupils of "
            f"1.2 and 3 mm; {flat:.1f} dB of it come from the pupil's own blur, with H of a flat wavefront", free),
        Row("Eq. 32", "the same with H of the wavefront as a mirror gives it", "dB", _NAN, mirrored[worst][0], _NAN,
            judge_settings(mean - 1.96 * error > 0.0 for mean, error in mirrored.values()),
            "behind a mirror the measured phase counts the water twice, the light of an image once. The text does not say "
            "that it was "
            "halved: with H as measured the gain is "
            + ", ".join(f"{mean:.1f} dB for D/r₀ of {d:g}" for d, (mean, _) in mirrored.items()), free),
    ]  # fmt: skip


def _sensor_rows() -> list[Row]:
    least, most = sensitivity_eq33(PIXEL_M, FOCAL_M), dynamic_range_eq34(PITCH_M, FOCAL_M)
    resolved = {n: sensor.angle_error_rad(n) / least for n in (10, 100, 1000, 10000)}
    rays = {eddy: sensor.ray_slope_rad(1e-6, eddy, 4.0) / least for eddy in (1e-3, 1e-2, 0.1)}
    half = 0.5 * sensor.PITCH_PX
    reach = {(alpha, near): sensor.share_shown(half, alpha, 9, neighbours=near) for alpha in (1.0, 2.0, 4.0)
             for near in (True, False)}  # fmt: skip
    return [
        Row("Eq. 33", "θ_min", "rad", 0.002657, least, 5e-7, judge_exact(0.002657, least, 5e-7), "P/f = 17.8 µm/6.7 mm"),
        Row("Eq. 33", "θ_min in degrees", "°", 0.1522, math.degrees(least), 5e-5,
            judge_exact(0.1522, math.degrees(least), 5e-5), ""),
        Row("Eq. 33", "least standard error of a spot's angle at 1,000 photoelectrons over θ_min", "1", _NAN, resolved[1000], 0.5,
            judge_settings(abs(value - 1.0) <= 0.5 for value in resolved.values()),
            "θ_min is called the sensitivity, and is the angle of one pixel. The bound of photon noise on the position of the "
            "spot is "
            + ", ".join(f"{value:.2g} of it at {n:,}" for n, value in resolved.items())
            + " photoelectrons; read noise adds. The tolerance is a factor of about two", "light"),
        Row("Eq. 33", "slope that Δn = 1e-6 gives over 4 m and back, eddies of 1 mm, over θ_min", "1", _NAN, rays[1e-3], _NAN,
            judge_settings(value >= 1.0 for value in rays.values()),
            "if θ_min were the least slope that can be seen, turbulence with the printed Δn ≈ 10⁻⁶ could not be: rms "
            + ", ".join(f"{value:.1g} θ_min for eddies of {1e3 * eddy:g} mm" for eddy, value in rays.items())
            + ". With spots read to a hundredth of a pixel it can", "size of eddies"),
        Row("Eq. 34", "θ_max", "rad", 0.011194, most, 5e-7, judge_exact(0.011194, most, 5e-7), "D/2f = 150 µm/13.4 mm"),
        Row("Eq. 34", "θ_max in degrees", "°", 0.6414, math.degrees(most), 5e-5, judge_exact(0.6414, math.degrees(most), 5e-5), ""),
        Row("Eq. 34", "slope that Eq. 27 and 28 read at θ_max over θ_max, α = 1", "1", _NAN, reach[1.0, True], 0.02,
            judge_settings(abs(value - 1.0) <= 0.02 for value in reach.values()),
            "half of the spot has left the cell, and where all spots move alike half of a neighbour's has come in at the "
            "other side: "
            + ", ".join(f"{value:.2f} (α = {alpha:g}{', neighbours' if near else ''})" for (alpha, near), value in reach.items())
            + ". It limits which lenslet a spot belongs to; the printed centroid no longer measures there", "α; neighbours"),
    ]  # fmt: skip


def _shown(item: str, what: str, quantity: str, r0_m: tuple[float, ...], note: str) -> Row:
    """One row: how often one frame per setting shows the order. The verdict asks for .95 over readings and over steps of r0."""
    found = chance_of_order(Reading(what=what), r0_m)
    over = [chance_of_order(reading, r0_m) for reading in readings(what)]
    steps = {step: chance_of_order(Reading(what=what), stepped(step)) for step in _STEPS}
    text = (
        f"{note} Asked for is .95. {min(over):.2f} … {max(over):.2f} over 8 or 20 lenslets across, ample or little light, "
        "tilt in or out; "
        + ", ".join(f"{chance:.2f}" for chance in steps.values())
        + f" if r₀ falls by {', '.join(f'{step:g}' for step in _STEPS)} from each setting to the next, and by chance alone "
        f"1/24 = {CHANCE:.3f}. Seen once, the order is evidence of a trend at the level of 4 %, and no more"
    )
    return Row(item, quantity, "1", _NAN, found, _NAN, judge_settings(value >= 0.95 for value in (*over, *steps.values())), text,
               _TABLE)  # fmt: skip


def _inlet_row() -> Row:
    """Whether the order of Figure 14 tells that turbulence is weaker away from the inlet."""
    inlet, level = chance_of_order(Reading(), BY_RANGE), chance_of_order(Reading(), even())
    ratios = [
        chance_of_order(reading, BY_RANGE) / chance_of_order(reading, even()) for reading in readings("peak-to-valley")
    ]
    ratios += [chance_of_order(Reading(spot_px=spot_px), stepped(step, r0)) / chance_of_order(Reading(spot_px=spot_px), even(r0))
               for step in _STEPS[2::2] for r0 in (BY_RANGE[3], 4 * BY_RANGE[3]) for spot_px in (0.015, 0.15)]  # fmt: skip
    return Row(
        "Figure 14", "chance of that order over its chance where turbulence is even along the tank", "1", _NAN, inlet / level, _NAN,
        judge_settings(ratio >= 20.0 for ratio in ratios),
        "the text takes the order as verified weakening away from the inlet. A gate selects the reflector, while the phase is "
        "gathered on "
        f"the whole way there and back: it grows with range for even turbulence too, which shows the order in {level:.2f} of "
        "figures. The "
        f"ratio is {min(ratios):.1f} … {max(ratios):.1f} over readings, light and strengths, even if r₀ falls by a factor of "
        "6 per metre; "
        "evidence is commonly called strong from 20", _TABLE,
    )  # fmt: skip


def _order_rows() -> list[Row]:
    spots, height, by_spots = "spots", "peak-to-valley", "by the rms displacement of spots"
    ours = (
        "The strengths are not printed; r₀ by flow and range is our table, so that the trend itself is by construction."
    )
    return [
        _shown("Figure 13", spots, f"chance that one frame per distance shows the order, {by_spots}", BY_RANGE, ours),
        _shown("Figure 14", height, "chance that one frame per distance shows the order, by peak-to-valley", BY_RANGE, ours),
        _inlet_row(),
        _shown("Figure 15", spots, f"chance that one frame per flow rate shows the order, {by_spots}", BY_FLOW, ours),
        _shown("Figure 16", height, "chance that one frame per flow rate shows the order, by peak-to-valley", BY_FLOW, ours),
    ]  # fmt: skip


def _text_rows() -> list[Row]:
    """What section 6.3 says without a number: runs, radians, the peak-to-valley «ratio»."""
    needed = {name: [frames_needed(reading, r0) for reading in readings("peak-to-valley")]
              for name, r0 in (("distance", BY_RANGE), ("flow rate", BY_FLOW))}  # fmt: skip
    rows = [
        Row("Flow runs", f"frames per {name} whose mean peak-to-valley shows the order in 95 of 100 sets", "1", _NAN,
            frames_needed(Reading(), r0), _NAN, judge_settings(number <= 1 for number in
                                                             (*needed[name], frames_needed(Reading(), stepped(6.0)))),
            f"{min(needed[name])} … {max(needed[name])} over the readings of the figures, 1 if r₀ falls by a factor of 6 from each "
            "setting to the next. The text shows one frame each and says itself that repeats would not look alike", _TABLE)
        for name, r0 in (("distance", BY_RANGE), ("flow rate", BY_FLOW))
    ]  # fmt: skip
    ratio = chance_of_order(Reading(what="ratio"), BY_FLOW)
    by_ratio = [chance_of_order(Reading(what="ratio"), stepped(step)) for step in _STEPS]
    index = water_phase_index(WAVELENGTH_M, 20.0, 0.0)
    factors = {
        "vacuum, target diffuse": 1.0,
        "water, target diffuse": index,
        "vacuum, mirror": 2.0,
        "water, mirror": 2.0 * index,
    }
    return [
        *rows,
        Row("Phase in radians", "2πW/λ over the phase of the water once through, λ of vacuum, mirror", "1", _NAN,
            factors["vacuum, mirror"], 0.01, judge_settings(abs(value - 1.0) <= 0.01 for value in factors.values()),
            "the coefficients are multiplied by 2π/λ, without a word on λ in vacuum or water, nor on the way through the "
            "water twice: "
            + ", ".join(f"{value:.2f} ({name})" for name, value in factors.items()), "wavelength; target"),
        Row("Peak-to-valley", "chance that the ratio of peak to valley shows the order of flow rates in one frame each", "1", _NAN,
            ratio, _NAN, judge_settings(value >= 0.95 for value in (ratio, *by_ratio)),
            "the text: «the peak-to-valley ratio … increased as the flow rate increased». A ratio does not change with the "
            "strength "
            f"of turbulence, so that the order comes by chance, 1/24 = {CHANCE:.3f}, however r₀ falls; a difference is meant, "
            "as in "
            "the row of Figure 16", _TABLE),
    ]  # fmt: skip
