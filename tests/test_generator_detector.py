"""The detector chain: moments over many frames, limits, and bits that do not depend on tiling or worker."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from beambench.generator.detector import FixedPattern, detect, fixed_pattern
from beambench.generator.random import BLOCK_ROWS, Stage, blocks, generator
from beambench.scenes.rigs.parts import Detector, Intensifier

BASE: dict[str, object] = {
    "dark_current_e_per_s": 0.0, "exposure_s": 1e-3, "read_noise_e": 0.0, "prnu": 0.0, "dsnu_e": 0.0,
    "gain_dn_per_e": 1.0, "offset_dn": 0.0, "full_well_e": 1e9, "adc_bits": 16, "fixed_pattern_seed": 1,
}  # fmt: skip


def sensor(**changes: object) -> Detector:
    return Detector.model_validate(BASE | changes)


def flat_frames(mean: float, detector: Detector, frames: int = 10_000, seed: int = 5) -> NDArray[np.float64]:
    """`frames` readings of one pixel: slices of a 4×4 sensor (their pixels are independent)."""
    expected = np.full((frames // 16, 4, 4), mean, dtype=np.float32)
    return detect(expected, detector, fixed_pattern(detector, 4, 4), seed, 7).astype(np.float64).ravel()


LEVELS = [0.5, 5.0, 50.0, 500.0, 5000.0]


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("excess", [1.0, 1.6, 2.0])
def test_mean_variance_and_excess_noise_over_ten_thousand_frames(level: float, excess: float) -> None:
    """EMVA 1288: mean K(Gμ + d) + offset, variance K²(G²F²μ + d + σ_r²) + 1/12, within 3 standard errors.

    The standard error of the variance uses the sample's own fourth moment. 15 cells × 2 checks at 3 σ: seeds are fixed,
    so a failure is a change of the chain, not chance.
    """
    gain, dark, read, k, offset = (4.0 if excess > 1 else 1.0), 3.0, 2.5, 1.7, 40.0
    tube = Intensifier(gain=gain, excess_noise_factor=excess, phosphor_sigma_px=0.0) if excess > 1 else None
    chip = sensor(
        dark_current_e_per_s=dark * 1e3, read_noise_e=read, gain_dn_per_e=k, offset_dn=offset, intensifier=tube
    )
    y = flat_frames(level, chip)
    mean = k * (gain * level + dark) + offset
    variance = k**2 * (gain**2 * excess * level + dark + read**2) + 1 / 12
    n = len(y)
    assert abs(y.mean() - mean) <= 3 * np.sqrt(variance / n)
    fourth = np.mean((y - y.mean()) ** 4)
    assert abs(y.var(ddof=1) - variance) <= 3 * np.sqrt((fourth - variance**2) / n)


def test_full_well_and_adc_clip() -> None:
    clipped = flat_frames(5000.0, sensor(full_well_e=1000.0), 160)
    assert (clipped == 1000).all()
    top = flat_frames(5000.0, sensor(adc_bits=10), 160)
    assert (top == 1023).all()
    low = flat_frames(0.0, sensor(read_noise_e=50.0), 1600)
    assert low.min() == 0  # a negative voltage reads as zero, it does not wrap


def test_huge_light_neither_wraps_nor_overflows() -> None:
    assert (flat_frames(1e20, sensor(), 160) == 65535).all()


def test_fixed_patterns_belong_to_the_chip() -> None:
    chip = sensor(prnu=0.05, dsnu_e=4.0)
    a, b = fixed_pattern(chip, 128, 128), fixed_pattern(chip, 128, 128)
    other = fixed_pattern(sensor(prnu=0.05, dsnu_e=4.0, fixed_pattern_seed=2), 128, 128)
    assert np.array_equal(a.response, b.response) and np.array_equal(a.offset_e, b.offset_e)
    assert not np.array_equal(a.response, other.response)
    n = a.response.size
    for values, rms in ((a.response - 1, 0.05), (a.offset_e, 4.0)):
        assert abs(values.mean()) < 4 * rms / np.sqrt(n)
        assert abs(values.std() / rms - 1) < 4 / np.sqrt(2 * n)


def test_phosphor_spread_keeps_the_light_and_correlates_neighbours() -> None:
    """A Gaussian spread of σ keeps every electron and lowers the variance by 1/(4πσ²) (for σ ≳ 1 px)."""
    tube = Intensifier(gain=10.0, excess_noise_factor=1.0, phosphor_sigma_px=1.5)
    plain = Intensifier(gain=10.0, excess_noise_factor=1.0, phosphor_sigma_px=0.0)
    expected = np.full((20, 64, 64), 100.0, dtype=np.float32)
    ones = FixedPattern(np.ones((64, 64), np.float32), np.zeros((64, 64), np.float32))
    blurred = detect(expected, sensor(intensifier=tube), ones, 1, 1).astype(float)
    sharp = detect(expected, sensor(intensifier=plain), ones, 1, 1).astype(float)
    assert blurred.mean() == pytest.approx(sharp.mean(), abs=0.05)  # rounding to DN
    inner = blurred[:, 16:-16, 16:-16]
    assert inner.var() / sharp.var() == pytest.approx(1 / (4 * np.pi * 1.5**2), rel=0.1)
    centred = inner - inner.mean()
    assert np.mean(centred[:, :, 1:] * centred[:, :, :-1]) / inner.var() > 0.8  # photon-transfer gain is misled


def test_bits_do_not_depend_on_the_tiling() -> None:
    """A picture cut into bands of whole blocks gives the same counts as the whole."""
    rng = np.random.default_rng(0)
    expected = rng.uniform(0, 300, (3, 3 * BLOCK_ROWS, 20)).astype(np.float32)
    chip = sensor(read_noise_e=2.0, dark_current_e_per_s=500.0)
    whole = detect(expected, chip, fixed_pattern(chip, 48, 20), 9, 4)
    first = detect(expected[:, :BLOCK_ROWS], chip, fixed_pattern(chip, BLOCK_ROWS, 20), 9, 4)
    assert np.array_equal(whole[:, :BLOCK_ROWS], first)
    shorter = detect(expected[:, : 2 * BLOCK_ROWS], chip, fixed_pattern(chip, 2 * BLOCK_ROWS, 20), 9, 4)
    assert np.array_equal(whole[:, : 2 * BLOCK_ROWS], shorter)
    assert not np.array_equal(whole, detect(expected, chip, fixed_pattern(chip, 48, 20), 9, 5))
    assert not np.array_equal(whole, detect(expected, chip, fixed_pattern(chip, 48, 20), 10, 4))


def test_blocks_cover_all_rows_once() -> None:
    for rows in (1, 15, 16, 17, 100):
        covered = np.concatenate([np.arange(rows)[part] for _, part in blocks(rows)])
        assert np.array_equal(covered, np.arange(rows))


def test_streams_of_different_names_differ_and_stages_keep_their_numbers() -> None:
    names = [(s, k, stage, b) for s in (0, 1) for k in (0, 1, 2**62) for stage in Stage for b in (0, 1)]
    draws = {tuple(generator(*name).integers(0, 2**63, 2)) for name in names}
    assert len(draws) == len(names)
    assert {s.name: int(s) for s in Stage} == {
        "ENERGY": 1, "JITTER": 2, "PHOTONS": 3, "INTENSIFIER": 4, "DARK": 5, "READ": 6, "PRNU": 7, "DSNU": 8,
        "PATHS": 9, "PULSES": 10, "SPECKLE": 11, "INCLINATION": 12, "SCREEN": 20, "POINTING": 21, "IMAGER": 22,
            "HIDDEN": 23, "FAULTS": 24,
    }  # fmt: skip
