"""The line finder of Kusters 1992, Eq. 3.1-3.19, its filters, frames without laser, several returns, and rows without a line."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from scipy.stats import norm

from beambench.benchmarks.bounds.laser_line import column_sigma, line_noise
from beambench.benchmarks.written.laser_line import written_capture
from beambench.captures.hide import hide_truth
from beambench.estimators import run_estimator
from beambench.estimators.builtin import BUILTIN
from beambench.optics import crest
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene
from beambench.scenes.rigs.laser_line import laser_line_rig
from beambench.scenes.scene import Scene

#: Every finder of lines that ships.
FINDERS = tuple(name for name in BUILTIN if name.startswith("line-"))
ONE_ROW = tuple(name for name in FINDERS if name not in ("line-steger", "line-derivative"))


def _scene(lens_px: float = 0.735, **changes: object) -> Scene:
    """256 rows of 64 columns in two frames; 12 bits, 10 e of read noise. A line of σ = .75 px by default."""
    values = {
        "rig.camera.cols": 64, "rig.lens_sigma_px": lens_px, "rig.detector.adc_bits": 12,
        "rig.detector.gain_dn_per_e": 0.05, "rig.detector.offset_dn": 100.0, "rig.detector.read_noise_e": 10.0,
    }  # fmt: skip
    return load_scene("spotscan-wall", values | changes)


def _phases() -> np.ndarray:
    return 30.0 + np.linspace(-0.5, 0.5, 512, endpoint=False).reshape(2, 256)


def _found(label: str, capture: xr.Dataset) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(errors [px], errors over their standard errors, valid) of the lit frames' first returns."""
    found = run_estimator(label, hide_truth(capture)).isel({"return": 0})
    on = capture["laser_on"].values
    error = (found["column"] - capture["truth_column"].isel({"return": 0})).values[on]
    return error, error / found["sigma"].values[on], found["valid"].values[on]


# --- the equations --------------------------------------------------------------------------------------------------


def test_the_direction_is_the_eigenvector_of_the_least_eigenvalue() -> None:
    """1000 random Hessians: numpy's eigenvectors know nothing of angles. A wrong sign, root or half angle fails."""
    xx, xy, yy = np.random.default_rng(31).standard_normal((3, 1000))
    hessian = np.moveaxis(np.array([[xx, xy], [xy, yy]]), 2, 0)
    value, vector = np.linalg.eigh(hessian)
    least = vector[:, :, 0] * np.where(vector[:, :1, 0] < 0, -1.0, 1.0)
    across = crest.across_eq3_15(xx, xy, yy)
    np.testing.assert_allclose(across.T, least, atol=1e-9)
    np.testing.assert_allclose(crest.least_second_eq3_9(xx, xy, yy), value[:, 0], atol=1e-12)
    theta = np.arctan2(across[1], across[0])
    np.testing.assert_allclose(crest.second_eq3_2(xx, xy, yy, theta), value[:, 0], atol=1e-12)
    np.testing.assert_allclose(crest.extremal_eq3_4(xx, xy, yy, theta), 0.0, atol=1e-12)
    np.testing.assert_allclose(crest.tan_twice_eq3_5(xx, xy, yy), np.tan(2.0 * theta), rtol=1e-6)
    for sign, number in ((-1, 0), (1, 1)):
        twice = 2.0 * np.arctan2(vector[:, 1, number], vector[:, 0, number])
        np.testing.assert_allclose(crest.sin_twice_eq3_6(xx, xy, yy, sign), np.sin(twice), atol=1e-9)
        np.testing.assert_allclose(crest.cos_twice_eq3_7(xx, xy, yy, sign), np.cos(twice), atol=1e-9)
    np.testing.assert_allclose(crest.cos_twice_eq3_10(xx, xy, yy), np.cos(2.0 * theta), atol=1e-9)
    np.testing.assert_allclose(crest.absolute_cosine_eq3_11(xx, xy, yy), np.abs(least[:, 0]), atol=1e-9)
    np.testing.assert_allclose(crest.absolute_sine_eq3_12(xx, xy, yy), np.abs(least[:, 1]), atol=1e-9)
    np.testing.assert_allclose(crest.radical_eq3_13(xx, xy, yy), value[:, 1] - value[:, 0], atol=1e-12)
    np.testing.assert_allclose(crest.sin_twice_eq3_14(xx, xy, yy), np.sin(2.0 * theta), atol=1e-9)


def test_derivatives_in_a_direction_are_those_along_a_straight_way() -> None:
    """I = exp(−x² − xy − 2y²) at (.3, −.2), stepped by 1e-4 along θ: truncation 1e-8."""

    def image(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.exp(-(x**2) - x * y - 2.0 * y**2)

    x, y, h = 0.3, -0.2, 1e-4
    i = float(image(np.array(x), np.array(y)))
    gx, gy = -(2 * x + y) * i, -(x + 4 * y) * i
    xx, xy, yy = ((2 * x + y) ** 2 - 2) * i, ((2 * x + y) * (x + 4 * y) - 1) * i, ((x + 4 * y) ** 2 - 4) * i
    for theta in np.linspace(0.0, 3.0, 7):
        way = image(x + h * np.array([-1, 0, 1]) * np.cos(theta), y + h * np.array([-1, 0, 1]) * np.sin(theta))
        assert crest.directional_eq3_1(gx, gy, theta) == pytest.approx((way[2] - way[0]) / (2 * h), abs=1e-7)
        assert crest.second_eq3_2(xx, xy, yy, theta) == pytest.approx((way[2] - 2 * way[1] + way[0]) / h**2, abs=1e-6)
        s = np.array([np.cos(theta), np.sin(theta)])
        assert crest.directional_eq3_17(gx, gy, s) == pytest.approx(crest.directional_eq3_1(gx, gy, theta), abs=1e-12)
    expected = crest.directional_eq3_17(gx, gy, crest.across_eq3_15(xx, xy, yy))
    assert crest.crest_slope_eq3_19(gx, gy, xx, xy, yy) == pytest.approx(float(expected))


def _by_eigenvectors(image: np.ndarray, row: int) -> float:
    """The crossing of one row, pixel by pixel, with numpy.gradient and numpy.linalg.eigh."""
    dy, dx = np.gradient(image)
    peak = int(np.argmax(image[row]))
    best = np.nan
    for left in range(peak - 2, peak + 2):
        bends = []
        for col in (left, left + 1):
            i = image[row - 1 : row + 2, col - 1 : col + 2]
            xx, yy = i[1, 2] - 2 * i[1, 1] + i[1, 0], i[2, 1] - 2 * i[1, 1] + i[0, 1]
            xy = 0.25 * (i[2, 2] - i[2, 0] - i[0, 2] + i[0, 0])
            bends.append(np.linalg.eigh(np.array([[xx, xy], [xy, yy]])))
        value, vector = min(bends, key=lambda pair: pair[0][0])
        s = vector[:, 0] * np.sign(vector[0, 0])
        a, b = (s[0] * dx[row, col] + s[1] * dy[row, col] for col in (left, left + 1))
        if value[0] < 0 and a > 0 and b <= 0:
            place = left + a / (a - b)
            if not abs(best - peak) <= abs(place - peak):
                best = place
    return best


@pytest.mark.parametrize("slope", [0.0, 0.2, -0.8])
def test_the_finder_is_the_zero_crossing_by_eigenvectors(slope: float) -> None:
    """Lines that lean by up to .8 columns per row. The median of a row, which the finder takes off, changes no derivative."""
    column = 30.0 + slope * (np.arange(256) % 24 - 12) + 0.31
    capture = written_capture(_scene(), 4e4, 0.75, 20.0, column, averaged=True)
    found = run_estimator("line-derivative", hide_truth(capture))
    image = capture["counts"].values[0].astype(np.float64)
    rows = [row for row in range(4, 252) if 3 < row % 24 < 21]
    mine = np.array([_by_eigenvectors(image, row) for row in rows])
    assert found["valid"].values[0, rows, 0].all()
    # Counts are float32: 1e-7 of 1400 DN over a slope of 400 DN per pixel.
    np.testing.assert_allclose(found["column"].values[0, rows, 0], mine, atol=2e-5)


# --- noise, filters and resolution ------------------------------------------------------------------------------------


@pytest.mark.parametrize("prefilter", [0.0, 0.7, 1.0])
@pytest.mark.parametrize("width", [0.5, 0.75, 1.2])
def test_the_stated_error_of_the_derivative_finder_is_true(width: float, prefilter: float) -> None:
    """Noise and pixel locking: 2000 rows, whose errors beside each other are alike over the filter: z within 8 %."""
    z = []
    for seed in range(4):
        scene = _scene(float(np.sqrt(width**2 - 0.145**2)))
        capture = written_capture(scene, 4000.0, width, 20.0, _phases(), seed=seed)
        _, over, valid = _found(f"line-derivative[prefilter_px={prefilter}]", capture)
        assert valid.mean() > 0.95  # the rows beside the image's edges are refused
        z.append(over[valid])
    assert np.sqrt((np.concatenate(z) ** 2).mean()) == pytest.approx(1.0, abs=0.08)


def test_filtering_lowers_noise_and_blurs_along_the_line() -> None:
    """Of a wide line the filter halves the noise, below the bound of a row alone; a step of the line takes rows to follow, none
    without a filter but for the 3 rows of the derivatives."""
    rms, scene = {}, _scene(1.2)
    for prefilter in (0.0, 1.5):
        capture = written_capture(scene, 1500.0, 1.2, 20.0, _phases(), seed=5)
        error, _, valid = _found(f"line-derivative[prefilter_px={prefilter}]", capture)
        rms[prefilter] = float(np.sqrt((error[valid] ** 2).mean()))
    bound = float(column_sigma(np.array(1500.0), np.array(1.2), np.array(20.0), line_noise(laser_line_rig(scene))))
    assert rms[1.5] < 0.5 * rms[0.0] and rms[1.5] < bound < rms[0.0]
    step = np.where(np.arange(256) < 128, 30.0, 31.0)
    late = {}
    for prefilter in (0.0, 1.5):
        capture = written_capture(scene, 4e4, 1.2, 20.0, step, averaged=True)
        error, _, valid = _found(f"line-derivative[prefilter_px={prefilter}]", capture)
        late[prefilter] = int((valid[0] & (np.abs(error[0]) > 0.05)).sum())
    assert late[0.0] <= 2 and 3 <= late[1.5] <= 12


def _mass_by_hand(row: np.ndarray, sigma_px: float) -> float:
    """The row above its median, cut to 11 pixels about its peak, smoothed, and its centre of mass above .3 of the peak."""
    row = row - np.median(row)
    peak = int(np.argmax(row))
    cut = row[peak - 5 : peak + 6]
    far = int(np.ceil(4 * sigma_px))
    g = np.exp(-0.5 * (np.arange(-far, far + 1) / sigma_px) ** 2)
    smooth = np.convolve(cut, g / g.sum(), mode="full")[far:-far]
    kept = [5]
    for way in (-1, 1):
        k = 5 + way
        while 0 <= k < 11 and smooth[k] >= 0.3 * smooth[5]:
            kept.append(k)
            k += way
    return peak - 5 + float(np.average(kept, weights=smooth[kept]))


def test_a_filter_before_the_centre_of_mass_keeps_a_true_error() -> None:
    """The reading is that of the smoothed row, and its stated error is true or up to a fifth too large: near a threshold the
    noise of a pixel counts in full. Pixel locking does not fall with the filter: .073 px without, .099 with .8 px."""
    capture = written_capture(_scene(0.479), 4000.0, 0.5, 20.0, _phases(), averaged=True)
    found = run_estimator("line-centroid[prefilter_px=0.8]", hide_truth(capture))["column"].values[0, :, 0]
    mine = [_mass_by_hand(row.astype(np.float64), 0.8) for row in capture["counts"].values[0]]
    np.testing.assert_allclose(found, mine, atol=1e-5)
    for width, prefilter in ((0.5, 0.0), (0.5, 0.8), (0.75, 0.8), (0.75, 1.0)):
        over = []
        for seed in range(4):
            scene = _scene(float(np.sqrt(width**2 - 0.145**2)))
            capture = written_capture(scene, 4000.0, width, 20.0, _phases(), seed=seed)
            _, z, valid = _found(f"line-centroid[prefilter_px={prefilter}]", capture)
            assert valid.all()
            over.append(z)
        assert 0.8 < np.sqrt((np.array(over) ** 2).mean()) < 1.1


# --- frames without laser ---------------------------------------------------------------------------------------------


def _lit_by_a_lamp(capture: xr.Dataset, seed: int, per_col: float, base: float = 50.0) -> xr.Dataset:
    """The capture's frames, drawn anew, with light of a lamp that rises by `per_col` photoelectrons from column to column."""
    rng = np.random.default_rng(seed)
    gain, offset = 0.05, 100.0
    mean = (capture["counts"].values - offset) / gain + base + per_col * np.arange(capture.sizes["col"])
    drawn = rng.poisson(np.maximum(mean, 0.0)) + 10.0 * rng.standard_normal(mean.shape)
    counts = np.clip(np.floor(drawn * gain + offset + 0.5), 0, 4095).astype(np.uint16)
    made = capture.assign(counts=(capture["counts"].dims, counts, capture["counts"].attrs))
    return made.assign_attrs({key: value for key, value in capture.attrs.items() if key != "averaged"})


@pytest.mark.parametrize("name", FINDERS)
def test_light_of_a_lamp_is_subtracted_with_its_noise(name: str) -> None:
    """A lamp's light that rises across the row hides the line; frames without laser take it away, and the stated error holds the
    noise of both. Two such frames: 512 rows in two lit ones, 4 seeds. That of a centre of mass above a threshold is up to a
    fifth too large."""
    scene = _scene(**{"rig.frames.lit": 2, "rig.frames.laser_off": 2})
    column = np.concatenate([_phases(), _phases()])
    clean = written_capture(scene, 4000.0, 0.75, 0.0, column, averaged=True)
    over, kept = [], []
    for seed in range(4):
        capture = _lit_by_a_lamp(clean, seed, 150.0)
        _, z, valid = _found(f"{name}[off_frames=subtracted]", capture)
        assert valid.mean() > 0.94
        over.append(z[valid])
        kept.append(_found(name, capture)[2].mean())
    # Rows are independent but for the mean dark frame that both lit frames share, and for the filters of two finders.
    least = 0.78 if name == "line-centroid" else 0.88
    assert least < np.sqrt((np.concatenate(over) ** 2).mean()) < 1.12
    # Without it: most rows are lost to the brighter end of the row.
    assert np.mean(kept) < 0.5
    capture = _lit_by_a_lamp(clean, 9, 0.0)
    same = _found(f"{name}[off_frames=subtracted]", capture)[1]
    assert least - 0.03 < np.sqrt(np.nanmean(same**2)) < 1.15


def test_what_cannot_be_subtracted_is_refused() -> None:
    """No frame without laser, or none that is valid; a pixel that is clipped without laser spoils the windows that hold it."""
    capture = hide_truth(written_capture(_scene(), 4000.0, 0.75, 20.0, _phases(), seed=1))
    with pytest.raises(InputError, match="without laser"):
        run_estimator("line-ml[off_frames=subtracted]", capture)
    with pytest.raises(InputError, match="not allowed"):
        run_estimator("line-ml[off_frames=all]", capture)
    scene = _scene(**{"rig.frames.lit": 1, "rig.frames.laser_off": 1})
    pair = written_capture(scene, 4000.0, 0.75, 20.0, _phases(), seed=1)
    with pytest.raises(InputError, match="none that is valid"):
        run_estimator("line-ml[off_frames=subtracted]", hide_truth(pair.assign_coords(valid=("frame", [True, False]))))
    counts = pair["counts"].values.copy()
    counts[1, 10, 31] = 4095
    found = run_estimator(
        "line-ml[off_frames=subtracted]", hide_truth(pair.assign(counts=(pair["counts"].dims, counts)))
    )
    assert not found["valid"].values[0, 10, 0] and found["valid"].values[0, :10].all()
    assert not found["valid"].values[1].any()  # the frame without laser has no line of its own


# --- returns and refusals -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", FINDERS)
def test_every_finder_reports_several_returns(name: str) -> None:
    """Two lines 24 columns apart, the brighter first; a third, which is not there, is refused."""
    scene, left, right = _scene(), _phases() - 12.0, _phases() + 12.0
    one, two = (
        written_capture(scene, light, 0.75, 20.0, column, averaged=True)
        for light, column in ((1e4, left), (2.5e4, right))
    )
    both = one.assign(counts=one["counts"] + two["counts"] - np.float32(101.0)).assign_attrs(one.attrs)
    found = run_estimator(f"{name}[returns=3]", hide_truth(both))
    assert found["column"].shape == (2, 256, 3)
    valid = found["valid"].values
    assert not valid[..., 2].any() and valid[..., :2].mean() > 0.9
    for number, column in ((0, right), (1, left)):
        error = (found["column"].values[..., number] - column)[valid[..., number]]
        assert np.abs(error).max() < 0.51  # a pixel's half, and rounding, for whole pixels


@pytest.mark.parametrize("name", FINDERS)
def test_a_row_without_a_line_is_refused_but_for_a_stated_rate(name: str) -> None:
    """Noise alone, 256 photoelectrons and 64 columns: at 3.5 standard deviations at most 64 · Q(3.5) = 1.5 % of the rows pass, of
    Gaussian noise; at 5, 1.8e-5. Poisson noise of 256 has a skewness of 1/16, which makes Q(3.5) 1.3 times as large."""
    passed, rows = {3.5: 0, 5.0: 0}, 0
    fine = _scene(**{"rig.detector.gain_dn_per_e": 0.5})
    for seed in range(12):
        # 1 DN is 2 photoelectrons, a tenth of the noise: coarser steps would raise the threshold.
        capture = hide_truth(written_capture(fine, 0.0, 0.75, 256.0, _phases(), seed=seed))
        rows += 512
        for least in passed:
            valid = run_estimator(f"{name}[least_sigmas={least}]", capture)["valid"].values
            passed[least] += int(valid.sum())
    expected = rows * 64 * float(norm.sf(3.5))
    # Up to four standard deviations of a Poisson count above 1.3 times that; none is expected at 5 (.11 in 6144 rows).
    assert passed[3.5] <= 1.3 * expected + 4.0 * np.sqrt(1.3 * expected)
    assert passed[5.0] <= 2
    if name == "line-peak":
        # What has nothing else to refuse reaches most of the rate: windows end within the image, 54 of 64 columns.
        assert passed[3.5] >= 0.5 * expected


@pytest.mark.parametrize("name", FINDERS)
def test_dark_and_saturated_frames_give_no_points(name: str) -> None:
    scene = _scene(**{"rig.frames.lit": 2, "rig.frames.laser_off": 1})
    column = np.concatenate([_phases(), _phases()[:1]])
    capture = hide_truth(written_capture(scene, 4000.0, 0.75, 20.0, column, seed=1))
    for level in (0, 100, 4095):
        counts = np.full(capture["counts"].shape, level, np.uint16)
        for label in (name, f"{name}[off_frames=subtracted]", f"{name}+triangulate-refractive"):
            found = run_estimator(label, capture.assign(counts=(capture["counts"].dims, counts)))
            assert not found["valid"].values.any(), (label, level)
