"""The conditioner turns background, uneven noise and cosmic rays into unit white noise."""

from dataclasses import replace
from pathlib import Path

from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.records import Malformed
from lowsnr_common.settings.flat_values import flat_values
from lowsnr_common.settings.flat_values import flatten
from lowsnr_common.settings.node_settings import TruthSettings
from lowsnr_detect.calibration.operating_point import calibrated
from lowsnr_detect.parts.registry import detector_class
from lowsnr_sensor.conditioning import background
from lowsnr_sensor.conditioning.conditioner import ConditioningSettings
import numpy as np
import pytest
from scipy import stats
import yaml

FILE = Path(__file__).resolve().parents[2] / 'config' / 'conditioner.yaml'
PLAIN = ConditioningSettings(binning=1)


def conditioned(settings, frames):
    """Return the cells of a sequence of frames."""
    state, outputs = settings.init(frames[0].shape), []
    for frame in frames:
        state, cells = settings.step(state, frame)
        outputs.append(cells)
    return np.array(outputs)


def test_file_holds_every_setting_with_its_default():
    values = flatten(yaml.safe_load(FILE.read_text())['/**/conditioner']['ros__parameters'])
    assert values == flat_values(ConditioningSettings()) | {'truth': TruthSettings().truth}


@pytest.mark.parametrize('count', [3, 4, 9, 30])
def test_past_level_has_the_variance_of_a_mean(rng, count):
    values = rng.standard_normal((count, 300, 400))
    level = background.past_level(values, background.past_median(values), np.ones((300, 400)))
    # 2 % as documented, and 4 sigma of the variance of 120,000 values.
    assert level.var() == pytest.approx(1.0 / count, rel=0.02 + 4 * (2 / 120_000) ** 0.5)


def test_past_level_is_robust_to_an_object_in_a_third_of_the_frames(rng):
    values = rng.standard_normal((31, 40, 40))
    values[5:15] += 20.0
    level = background.past_level(values, background.past_median(values), np.ones((40, 40)))
    assert level.mean() < 1.5


def test_limited_square_has_mean_one_for_noise_and_is_bounded():
    grid = np.linspace(-9, 9, 20_001)
    mean = np.trapezoid(background.limited_square(grid) * stats.norm.pdf(grid), grid)
    assert mean == pytest.approx(1.0, abs=1e-6)
    assert background.limited_square(np.array([1e6])) < 10.0


def test_box_mean_is_the_mean_of_the_cells_in_the_frame(rng, grid_shape):
    plane = rng.standard_normal(grid_shape)
    found = background.box_mean(plane, 2)
    for row, col in np.ndindex(grid_shape):
        part = plane[max(0, row - 2):row + 3, max(0, col - 2):col + 3]
        assert found[row, col] == pytest.approx(part.mean())


def test_steepness_is_the_largest_step_to_a_neighbour():
    plane = np.zeros((4, 5))
    plane[1, 2] = 3.0
    expected = np.zeros((4, 5))
    expected[[1, 0, 2, 1, 1], [2, 2, 2, 1, 3]] = 3.0
    np.testing.assert_array_equal(background.steepness(plane), expected)


def test_binned_cells_are_sums_over_full_squares():
    plane = np.arange(35.0).reshape(5, 7)
    cells = background.binned(plane, 2)
    assert cells.shape == (2, 3)
    assert cells[0, 0] == (0 + 1 + 7 + 8) / 2
    assert ConditioningSettings(binning=2).cells(np.array([0.5, 2.5])).tolist() == [0.0, 1.0]
    assert PLAIN.cells(np.array([3.0])).tolist() == [3.0]


@pytest.mark.parametrize('binning', [1, 2])
def test_conditioned_noise_is_white_and_of_unit_variance(rng, binning):
    settings = ConditioningSettings(binning=binning)
    scene = 100.0 + np.arange(24.0)[:, None] + np.zeros(32)
    unevenness = np.linspace(4.0, 5.0, 32)
    frames = scene + unevenness * rng.standard_normal((40, 160, 24, 32))
    answers = conditioned(settings, frames)[8:]
    count = answers.size
    assert answers.std() == pytest.approx(1.0, abs=0.02)
    columns = answers.std(axis=(0, 1, 2))
    assert columns.min() > 0.92
    assert columns.max() < 1.08
    assert abs(np.mean(answers)) < 4 * count**-0.5 + 0.01
    # Successive frames are uncorrelated: 4 sigma of the mean of so many products.
    assert abs(np.mean(answers[1:] * answers[:-1])) < 4 * count**-0.5 + 0.02


def test_cells_are_zero_until_the_background_is_known(rng):
    answers = conditioned(PLAIN, rng.standard_normal((8, 12, 12)))
    known = answers.any(axis=(1, 2))
    assert known.tolist() == [False] * 5 + [True] * 3
    assert answers.dtype == np.float32


def test_cells_depend_on_no_later_frame(rng):
    frames = rng.standard_normal((20, 12, 14))
    np.testing.assert_array_equal(conditioned(PLAIN, frames)[:12], conditioned(PLAIN, frames[:12]))


def test_batch_of_sequences_equals_single_sequences(rng):
    frames = rng.standard_normal((12, 3, 10, 14))
    together = conditioned(PLAIN, frames)
    np.testing.assert_allclose(together[:, 1], conditioned(PLAIN, frames[:, 1]), rtol=1e-5)


def test_offset_and_gain_of_the_camera_have_no_effect(rng):
    frames = rng.standard_normal((30, 20, 20))
    np.testing.assert_allclose(
        conditioned(PLAIN, 1000.0 + 64.0 * frames), conditioned(PLAIN, frames), atol=2e-2)


def test_cosmic_ray_is_limited_and_a_passing_object_is_kept(rng):
    settings = ConditioningSettings()
    frames = 50.0 + 4.0 * rng.standard_normal((60, 40, 40))
    frames[40, 11, 11] += 200.0
    for k in range(20, 60):
        frames[k, 20:22, k - 20:k - 18] += 3.0 * 4.0
    cells = conditioned(settings, frames)
    assert cells[40, 5, 5] < 3.5
    along = [cells[k, 10, (k - 20) // 2] for k in range(22, 58, 2)]
    # Four pixels of 3 sigma make a cell of 6, and subtracting the surroundings costs little.
    assert np.mean(along) > 3.5


def test_jitter_of_the_camera_does_not_pass_static_edges(rng):
    scene = np.where(np.arange(40)[:, None] < 20, 20.0, 220.0) * np.ones((40, 60))
    shifts = rng.normal(0.0, 0.1, 80)
    frames = [scene + shift * np.gradient(scene, axis=0) + rng.standard_normal(scene.shape)
              for shift in shifts]
    steady = conditioned(ConditioningSettings(jitter_px=0.2), frames)[20:]
    assert abs(steady[:, 9:11]).max() < 4.0


def test_codec_patterns_of_8_bit_video_stay_below_the_noise():
    frames = np.full((30, 32, 32), 30, dtype=np.uint8)
    frames[15:, 8:16, 8:16] += 2
    answers = conditioned(ConditioningSettings(), frames)
    assert abs(answers).max() < 2.0
    assert np.isfinite(answers).all()


def test_frames_without_noise_give_finite_cells():
    frames = np.zeros((12, 16, 16))
    frames[8, 4, 4] = 1.0
    assert np.isfinite(conditioned(PLAIN, frames)).all()


def test_frame_of_another_size_is_rejected(rng):
    state, _ = PLAIN.step(PLAIN.init((8, 9)), rng.standard_normal((8, 9)))
    with pytest.raises(Malformed) as caught:
        PLAIN.step(state, np.zeros((9, 8)))
    assert caught.value.reason == 'change of size'
    assert len(state.history) == 1
    with pytest.raises(Malformed) as caught:
        ConditioningSettings().init((1, 9))
    assert caught.value.reason == 'too small'


def test_warm_up_longer_than_the_background_is_rejected():
    with pytest.raises(ValueError, match='warm_up_frames = 9'):
        ConditioningSettings(warm_up_frames=9, background_frames=8)


@pytest.mark.slow
def test_white_noise_keeps_the_calibrated_false_alarm_rate():
    settings, runs, first, rng = ConditioningSettings(), 50, 60, np.random.default_rng(0)
    detectors = [detector_class(name)(sensor=SensorModel(snr_db=8.0)) for name in ('sdt', 'cusum')]
    detectors = [
        replace(item, threshold=calibrated(item, 0.01, (20, 20)).threshold) for item in detectors]
    conditioner = settings.init((runs, 40, 40))
    states = [item.init((runs, 20, 20)) for item in detectors]
    alarms = []
    for _ in range(first + 400):
        frames = 500.0 + 7.0 * rng.standard_normal((runs, 40, 40))
        conditioner, cells = settings.step(conditioner, frames)
        steps = [item.step(state, cells.astype(float), rng)
                 for item, state in zip(detectors, states)]
        states = [state for state, _ in steps]
        alarms.append([declared.any for _, declared in steps])
    shares = np.mean(alarms[first:], axis=0)
    # 20 % of the rate, and 3 standard errors over runs, for 20,000 frames of each.
    tolerance = 0.002 + 3 * shares.std(axis=1, ddof=1) / runs**0.5
    assert np.all(abs(shares.mean(axis=1) - 0.01) < tolerance), shares.mean(axis=1)
