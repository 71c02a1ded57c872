"""Waveforms that hold more than one echo: the background below later returns and tails, the first return, several returns.

The records are drawn here, from an error function (a Gaussian response of 2 ns σ, collected over each sample) and
an exponential tail; nothing of the generator or of the estimators' response is used.
"""

from __future__ import annotations

import json
from functools import lru_cache
from math import erf, sqrt
from typing import Any

import numpy as np
import pytest
import xarray as xr

from beambench.captures.hide import hide_truth
from beambench.estimators import run_estimator
from beambench.generator.generate import generate
from beambench.optics.constants import C_M_PER_S
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene

SHOTS, SAMPLES, STEP_S, SIGMA_S = 200, 160, 1e-9, 2e-9
TOP_E, LEVEL_E, READ_E = 350.0, 20.0, 2.0
LATER_S, TAIL_S = 22e-9, 40e-9
TAU_S = 30e-9


@lru_cache(maxsize=1)
def _template_capture() -> xr.Dataset:
    return hide_truth(generate(load_scene("counter", {"rig.record.shots": SHOTS}), seed=1, rtol=5e-3))


def _share(tau: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Part of an echo at tau (shot) that each sample collects (shot, sample)."""
    edges = np.concatenate([time - STEP_S / 2, time[-1:] + STEP_S / 2])
    x = (edges[None, :] - tau[:, None]) / (SIGMA_S * sqrt(2))
    return np.asarray(np.diff(0.5 * np.vectorize(erf)(x), axis=1))


def record(
    second: float, tail: float, seed: int = 3, first: float = 1.0, dark: int = 0, later_s: float = LATER_S
) -> tuple[xr.Dataset, np.ndarray]:
    """(capture, τ of the first echo (shot)): echoes of TOP_E·first and, later by later_s, TOP_E·second at the top, a tail of
    TOP_E·tail after the second one; the last `dark` shots are taken with the laser off."""
    rng = np.random.default_rng(seed)
    time = STEP_S * np.arange(SAMPLES)
    tau = TAU_S + STEP_S * rng.random(SHOTS)
    height = STEP_S / (SIGMA_S * sqrt(2 * np.pi))
    mean = TOP_E / height * (first * _share(tau, time) + second * _share(tau + later_s, time))
    after = time[None, :] - tau[:, None] - later_s
    mean += TOP_E * tail * np.where(after > 0, np.exp(-np.maximum(after, 0) / TAIL_S), 0.0)
    mean[SHOTS - dark :] = 0.0
    electrons = rng.poisson(mean + LEVEL_E) + READ_E * rng.normal(size=mean.shape)
    base = _template_capture()
    rig: dict[str, Any] = json.loads(base.attrs["rig"])
    u = STEP_S / 8 * np.arange(-80, 81)
    rig["response"] = {"start_s": float(u[0]), "step_s": STEP_S / 8, "value": list(np.exp(-0.5 * (u / SIGMA_S) ** 2))}
    rig["detector"]["readout"] |= {"gain_dn_per_e": 1.0, "offset_dn": 100.0, "read_noise_e": READ_E, "adc_bits": 12}
    rig["detector"].pop("avalanche", None)
    signal = np.rint(100 + electrons).clip(0, 4095).astype(np.uint16)
    capture = xr.Dataset(
        {"signal": (("shot", "sample"), signal)},
        coords={"time": ("sample", time), "laser_on": ("shot", np.arange(SHOTS) < SHOTS - dark)},
        attrs=base.attrs | {"rig": json.dumps(rig)},
    )
    return capture, tau


def late_ns(label: str, capture: xr.Dataset, tau: np.ndarray) -> tuple[float, float]:
    """(mean error in ns, its standard error) of all lit shots, each of which must be answered."""
    rig = json.loads(capture.attrs["rig"])
    found = run_estimator(label, capture)
    lit = capture["laser_on"].values
    assert found["valid"].values[lit].all() and not found["valid"].values[~lit].any()
    error = found["range"].values[lit] * 2 * rig["medium"]["group_index"] / C_M_PER_S - tau[lit]
    return 1e9 * float(error.mean()), 1e9 * float(error.std() / np.sqrt(error.size))


HALF = "waveform-constant-fraction[smooth=0.0,background={}]"


def test_the_background_is_read_below_later_returns_and_tails() -> None:
    capture, tau = record(second=0.5, tail=0.2, dark=20)
    late = {how: late_ns(HALF.format(how), capture, tau)[0] for how in ("outside", "robust", "before", "off-shots")}
    # The mean of all that the first echo cannot reach is too high by the light there. At half height the edge of a Gaussian
    # has the slope √(2 ln 2)/2σ: a level too high by d of the height is late by d/2 of it, d/2·σ/.589 = 1.7 d ns for σ = 2 ns.
    time = STEP_S * np.arange(SAMPLES)
    echo = TOP_E / (STEP_S / (SIGMA_S * sqrt(2 * np.pi)))
    clear = np.abs(time - TAU_S) > 4 * SIGMA_S
    after = time - TAU_S - LATER_S
    light = 0.5 * echo * _share(np.array([TAU_S + LATER_S]), time)[0]
    light += 0.2 * TOP_E * np.where(after > 0, np.exp(-np.maximum(after, 0) / TAIL_S), 0)
    predicted = 0.5 * light[clear].mean() / TOP_E * SIGMA_S * 1e9 / 0.5887
    assert predicted > 0.08
    # Straight lines between samples of half a σ err by .02 ns at half height, whatever the level is: differences count.
    clean = late_ns(HALF.format("outside"), *record(second=0.0, tail=0.0))[0]
    assert abs(clean) < 0.05
    assert late["outside"] - clean == pytest.approx(predicted, rel=0.25)
    # A tail that stays below four standard deviations of the mean of 16 samples is not seen. The noise is 4.9 electrons, its
    # spread among the lower samples of a tail up to 1.6 times that: 8 of 350 electrons, .04 ns, and .01 ns of noise.
    assert abs(late["robust"] - clean) < 0.05 < 0.6 * (late["outside"] - clean)
    assert abs(late["before"] - clean) < 0.03 and abs(late["off-shots"] - clean) < 0.03


@pytest.mark.parametrize("label", ["waveform-average", "waveform-constant-fraction", "waveform-leading-edge"])
def test_robust_is_the_plain_mean_where_there_is_nothing_else(label: str) -> None:
    capture, tau = record(second=0.0, tail=0.0)
    robust, plain = (late_ns(f"{label}[background={how}]", capture, tau) for how in ("robust", "outside"))
    # A sample of noise beyond the limit, one in some 100,000, is left out with its neighbours.
    assert robust[0] == pytest.approx(plain[0], abs=0.25 * plain[1])


@pytest.mark.parametrize("label", ["waveform-first-return", "waveform-several-returns"])
@pytest.mark.parametrize("second", [0.6, 2.5])
def test_the_first_return_is_read_however_bright_the_second_is(label: str, second: float) -> None:
    capture, tau = record(second=second, tail=0.0)
    late, error = late_ns(label, capture, tau)
    # Straight lines between the samples: as above. The fit has no such error.
    assert abs(late) < (0.05 if label == "waveform-first-return" else 4 * error)
    if second > 1:
        brightest = late_ns("waveform-constant-fraction", capture, tau)[0]
        assert brightest == pytest.approx(LATER_S * 1e9, abs=0.1)


def test_several_returns_are_counted_timed_and_stated_truly() -> None:
    capture, tau = record(second=0.6, tail=0.0)
    rig = json.loads(capture.attrs["rig"])
    to_s = 2 * rig["medium"]["group_index"] / C_M_PER_S
    found = run_estimator("waveform-several-returns", capture)
    ranges, sigmas = found["return_range"].values * to_s, found["return_sigma"].values * to_s
    number = np.isfinite(ranges).sum(axis=1)
    # A third echo by chance: 1 of 1,000 shots as stated; 4 of 200 lie 8 standard deviations beyond.
    assert (number >= 2).all() and (number > 2).sum() < 4
    two = number == 2
    for at, truth in ((0, tau), (1, tau + LATER_S)):
        z = ((ranges[:, at] - truth) / sigmas[:, at])[two]
        # n standard normal errors: mean within 4/√n of 0, mean square within 4√(2/n) of 1.
        assert abs(z.mean()) < 4 / np.sqrt(z.size) and abs((z**2).mean() - 1) < 4 * np.sqrt(2 / z.size)
    for pick, delay in (("first", 0.0), ("last", LATER_S), ("brightest", 0.0)):
        late, _ = late_ns(f"waveform-several-returns[pick={pick}]", capture.isel(shot=two), tau[two])
        assert late == pytest.approx(1e9 * delay, abs=0.02)
    alone = run_estimator("waveform-several-returns", record(second=0.0, tail=0.0)[0])
    assert (np.isfinite(alone["return_range"].values).sum(axis=1) == 1).mean() > 0.98


def test_two_echoes_that_overlap_are_told_apart_and_their_sigma_says_how_well() -> None:
    capture, tau = record(second=0.7, tail=0.0, later_s=4e-9)
    found = run_estimator("waveform-several-returns", capture)
    rig = json.loads(capture.attrs["rig"])
    z = (found["range"].values * 2 * rig["medium"]["group_index"] / C_M_PER_S - tau) / (
        found["sigma"].values * 2 * rig["medium"]["group_index"] / C_M_PER_S
    )
    assert (np.isfinite(found["return_range"].values).sum(axis=1) == 2).all()
    assert np.sqrt((z**2).mean()) == pytest.approx(1.0, abs=4 / np.sqrt(2 * SHOTS) + 0.1)


def test_single_photon_tags_keep_their_coverage_and_analog_records_their_threshold() -> None:
    capture = generate(
        load_scene("single-photon", {"rig.laser.pulse_energy_j": 1e-15, "rig.record.shots": 400}), seed=5, rtol=5e-3
    )
    hidden = hide_truth(capture)
    photons = hidden["signal"].values.sum(axis=1)
    assert 1 < photons.mean() < 100
    default, strict = (run_estimator(f"waveform-ml{p}", hidden)["valid"].values for p in ("", "[min_snr=4.0]"))
    assert default.mean() > 0.9 > strict.mean()
    noise = record(second=0.0, tail=0.0, first=0.0)[0]
    for name in (
        "waveform-ml",
        "waveform-matched",
        "waveform-average",
        "waveform-constant-fraction",
        "waveform-gaussian",
    ):
        # 40 places and a threshold of 4σ: .0013 of shots, and a few more where the height is chosen as the largest.
        assert run_estimator(name, noise)["valid"].values.mean() < 0.1, name


@pytest.mark.parametrize("name", ["average", "coates", "constant-fraction", "gaussian", "matched", "ml", "several-returns",
                                  "first-return"])  # fmt: skip
def test_of_one_photon_the_stated_error_is_the_width_of_the_response(name: str) -> None:
    capture = hide_truth(generate(load_scene("single-photon", {"rig.record.shots": 20}), seed=5, rtol=5e-3))
    signal = np.zeros_like(capture["signal"].values)
    signal[:, 60] = 1
    result = run_estimator(f"waveform-{name}[min_snr=0.0]", capture.assign(signal=(("shot", "sample"), signal)))
    rig = json.loads(capture.attrs["rig"])
    u, value = np.arange(len(rig["response"]["value"])) * rig["response"]["step_s"], np.array(rig["response"]["value"])
    width = np.sqrt(np.average((u - np.average(u, weights=value)) ** 2, weights=value))
    half = C_M_PER_S / (2 * rig["medium"]["group_index"])
    # Nothing tells one photon's place in the pulse: σ_R, and no method can do better than half of it.
    assert (result["sigma"].values[result["valid"].values] > 0.5 * width * half).all()


def test_dark_shots_must_be_there() -> None:
    with pytest.raises(InputError, match="no shot with the laser off"):
        run_estimator(HALF.format("off-shots"), record(second=0.0, tail=0.0)[0])
