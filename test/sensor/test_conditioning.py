"""The conditioner turns real frames into unit white noise, and keeps objects."""

from dataclasses import replace
from pathlib import Path

from lowsnr_common.core.frame_map import overlaps
from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.records import Malformed
from lowsnr_common.settings.flat_values import flat_values
from lowsnr_common.settings.flat_values import flatten
from lowsnr_detect.calibration.operating_point import calibrated
from lowsnr_detect.parts.registry import detector_class
from lowsnr_sensor.conditioning.conditioner import ConditioningSettings
import numpy as np
import pytest
import scipy.ndimage
from sensor.camera_scene import at_object
from sensor.camera_scene import camera_scene
import yaml

FILE = Path(__file__).resolve().parents[2] / 'config' / 'conditioner.yaml'
DEFAULT = ConditioningSettings()


def conditioned(frames, settings=DEFAULT):
    """Return the outputs of a sequence of frames."""
    state, outputs = settings.init(np.shape(frames[0])), []
    for frame in frames:
        state, output = settings.step(state, frame)
        outputs.append(output)
    return outputs


def cells_of(frames, settings=DEFAULT):
    """Return the cells of a sequence of frames."""
    return np.array([output.cells for output in conditioned(frames, settings)])


def test_file_holds_every_setting_with_its_default():
    values = flatten(yaml.safe_load(FILE.read_text())['/**/conditioner']['ros__parameters'])
    assert values == flat_values(DEFAULT)


@pytest.mark.parametrize('binning', [1, 2])
def test_map_of_an_output_leads_to_its_object(rng, binning):
    settings = ConditioningSettings(binning=binning)
    frames = 100.0 + rng.standard_normal((30, 40, 61))
    row, col = np.mgrid[:40, :61]
    frames[-2:] += 60.0 * np.exp(-((row - 20.3)**2 + (col - 33.8)**2) / 2.0)
    output = conditioned(frames, settings)[-1]
    where = settings.frame_map(output, 'camera', (40, 61))
    assert (where.size, where.frame_id) == ((61, 40), 'camera')
    peak = np.unravel_index(np.argmax(output.cells), output.cells.shape)
    assert abs(where.pixels(np.array(peak[::-1], float)) - (33.8, 20.3)).max() <= binning / 2.0


def test_scene_after_a_cut_lies_where_no_earlier_cell_was(rng):
    frames = 100.0 + rng.standard_normal((24, 40, 60))
    frames[12:] = 100.0 + 50.0 * scipy.ndimage.gaussian_filter(
        rng.standard_normal((40, 60)), 2.0) * 8.0 + rng.standard_normal((12, 40, 60))
    outputs = conditioned(frames)
    cut = [output.event for output in outputs].index('cut')
    before, after = (
        DEFAULT.frame_map(output, '', (40, 60)) for output in outputs[cut - 1:cut + 1])
    assert not overlaps(after.moved_since(before), outputs[0].cells.shape)
    np.testing.assert_allclose(after.pixels(np.zeros(2)), [0.5, 0.5])


@pytest.mark.parametrize('binning', [1, 2])
def test_conditioned_noise_is_of_unit_variance_and_white_in_time(rng, binning):
    unevenness = np.linspace(4.0, 6.0, 120)
    frames = 100.0 + np.arange(96.0)[:, None] + unevenness * rng.standard_normal((60, 96, 120))
    outputs = conditioned(frames, ConditioningSettings(binning=binning))
    cells = np.array([output.cells for output in outputs])[10:]
    assert cells.std() == pytest.approx(1.0, abs=0.03)
    columns = cells.std(axis=(0, 1))
    assert columns.min() > 0.85
    assert columns.max() < 1.15
    assert abs(cells.mean()) < 0.01
    # Of 50 frames of more than 2,000 cells each: 4 standard errors are .013.
    assert abs(np.mean(cells[1:] * cells[:-1])) < 0.03
    assert all(output.to_image == (0.0, 0.0) for output in outputs)


def test_cells_are_zero_until_the_background_is_known(rng):
    outputs = conditioned(rng.standard_normal((8, 12, 14)))
    assert [bool(output.cells.any()) for output in outputs] == [False] * 5 + [True] * 3
    assert outputs[0].event == 'start'
    assert outputs[7].cells.dtype == np.float32


def test_cells_depend_on_no_later_frame(rng):
    frames = rng.standard_normal((20, 12, 14))
    np.testing.assert_array_equal(cells_of(frames)[:12], cells_of(frames[:12]))


@pytest.mark.parametrize('kind', [np.float32, np.uint16])
def test_offset_and_gain_of_the_camera_have_no_effect(rng, kind):
    frames = rng.standard_normal((30, 20, 24))
    np.testing.assert_allclose(
        cells_of((1000.0 + 64.0 * frames).astype(kind)), cells_of(frames), atol=5e-2)


def test_frame_of_another_size_is_rejected(rng):
    state, _ = DEFAULT.step(DEFAULT.init((8, 9)), rng.standard_normal((8, 9)))
    with pytest.raises(Malformed) as caught:
        DEFAULT.step(state, np.zeros((9, 8)))
    assert caught.value.reason == 'change of size'
    with pytest.raises(Malformed) as caught:
        DEFAULT.init((1, 9))
    assert caught.value.reason == 'too small'


@pytest.mark.parametrize('value', [np.nan, np.inf, -np.inf])
def test_frames_without_a_value_leave_no_trace(rng, value):
    frames = 50.0 + 3.0 * rng.standard_normal((30, 40, 48))
    state = DEFAULT.init((40, 48))
    for frame in frames[:20]:
        state, _ = DEFAULT.step(state, frame)
    after, output = DEFAULT.step(state, np.full((40, 48), value))
    assert output.event == 'blank'
    for frame in frames[20:]:
        state, wanted = DEFAULT.step(state, frame)
        after, found = DEFAULT.step(after, frame)
        np.testing.assert_array_equal(found.cells, wanted.cells)


@pytest.mark.parametrize('kind', [np.float64, np.uint16])
@pytest.mark.parametrize('value', [0.0, 65535.0])
@pytest.mark.parametrize('count', [1, 3])
def test_black_or_bright_first_frames_blind_for_ten_frames_at_most(kind, value, count):
    frames, truth = camera_scene(amplitude=4.0)
    steady = at_object(conditioned(frames), truth)
    frames[:count] = value
    seen = at_object(conditioned(np.rint(frames).astype(kind)), truth)
    assert np.median(seen[count + 10:]) > 0.85 * np.median(steady[count + 10:])


def test_cosmic_rays_are_limited_and_a_bright_object_is_not():
    frames, truth = camera_scene(amplitude=20.0)
    frames[40, 11, 11] += 1000.0
    frames[40, 51:54, 20:26] += 600.0
    outputs = conditioned(frames)
    for rows, cols in ((slice(4, 7), slice(4, 7)), (slice(24, 28), slice(9, 14))):
        assert 3.0 < outputs[40].cells[rows, cols].max() < 6.0
        assert abs(outputs[41].cells[rows, cols]).max() < 3.5
    seen = at_object(outputs, truth)[10:]
    # A filter of .8 pixel sums to 2.8: pixels limited at 3.5 could not exceed 10.
    assert np.median(seen) > 11.0


@pytest.mark.parametrize('peak', [4.0, 8.0])
def test_passing_object_keeps_its_matched_filter_ratio(peak):
    frames, truth = camera_scene(amplitude=peak)
    seen = at_object(conditioned(frames), truth)[10:]
    # The energy of the point spread: peak * sqrt(pi) * .9 = 1.6 peak; a cell at a random position
    # of the object, and the subtracted surroundings, cost up to a third of it.
    assert 1.0 * peak < np.median(seen) < 1.6 * peak


def disturbed(name, frames):
    """Return frames whose level changes as a whole from frame 30 on."""
    late = (np.arange(len(frames)) >= 30)[:, None, None]
    cols = np.arange(frames.shape[2])
    return {
        'step': frames + 400.0 * late,
        'gain': np.where(late, 1.4 * frames - 300.0, frames),
        'drift': frames + 15.0 * np.arange(len(frames))[:, None, None],
        'region': frames + 400.0 * late * (cols < 24),
        'stripes': frames + 40.0 * np.random.default_rng(5).standard_normal(
            (len(frames), frames.shape[1], 1)),
    }[name]


@pytest.mark.parametrize('name', ['step', 'gain', 'drift', 'region', 'stripes'])
def test_change_of_the_whole_frame_blinds_for_no_more_than_three_frames(name):
    frames, truth = camera_scene(amplitude=4.0)
    steady = at_object(conditioned(frames), truth)
    outputs = conditioned(disturbed(name, frames))
    seen = at_object(outputs, truth)
    assert np.median(seen[33:]) > 0.85 * np.median(steady[33:])
    cells = np.array([output.cells for output in outputs])[33:]
    assert np.mean(abs(cells) > 4.0) < 2e-3
    assert cells.std() == pytest.approx(1.0, abs=0.1)
    assert [output.event for output in outputs[1:]] == [''] * (len(outputs) - 1)


def test_change_of_level_is_reported():
    frames, _ = camera_scene()
    assert conditioned(disturbed('step', frames))[30].offset == pytest.approx(400.0, abs=2.0)
    frames[:, 10:20, 10:20] += 2000.0
    assert conditioned(disturbed('gain', frames))[30].gain == pytest.approx(1.4, abs=0.02)


@pytest.mark.parametrize(('event', 'value'), [
    ('flat', 1100), ('saturated', 65535), ('blank', np.nan)])
def test_frame_without_content_is_named_and_the_next_is_conditioned(event, value):
    frames, truth = camera_scene(amplitude=4.0)
    frames = frames if event == 'blank' else np.rint(frames).astype(np.uint16)
    steady = conditioned(frames)
    frames[25:28] = value
    outputs = conditioned(frames)
    assert [output.event for output in outputs[24:29]] == ['', *3 * [event], '']
    assert not np.any([output.cells for output in outputs[25:28]])
    assert at_object(outputs, truth)[28] > 0.7 * at_object(steady, truth)[28]


def test_first_frame_without_content_is_named():
    outputs = conditioned(np.full((2, 8, 9), np.nan))
    assert [output.event for output in outputs] == ['blank', 'blank']


@pytest.mark.parametrize('steps', [0.5, 1.0, 2.0, 3.0])
def test_noise_below_one_grey_step_hides_nothing(steps):
    frames, truth = camera_scene(amplitude=4.0)
    eight = np.clip(np.rint((frames - 1000.0) / 20.0 * steps + 12.0), 0, 255).astype(np.uint8)
    outputs = conditioned(eight)
    assert outputs[-1].noise_floor == DEFAULT.noise_floor
    # Rounding adds 1/12 to the variance of steps^2.
    kept = steps / np.hypot(steps, 12**-0.5)
    wanted = np.median(at_object(conditioned(frames), truth)[10:])
    assert np.median(at_object(outputs, truth)[10:]) > 0.85 * kept * wanted


def test_codec_is_recognised_and_its_patterns_stay_below_the_noise(rng):
    frames = np.full((40, 64, 64), 30)
    for k in range(1, 40):
        frames[k] = frames[k - 1]
        for row, col in rng.integers(0, 8, (6, 2)):
            frames[k, 8 * row:8 * row + 8, 8 * col:8 * col + 8] = 30 + rng.integers(-2, 3)
    outputs = conditioned(frames.astype(np.uint8))
    assert outputs[-1].noise_floor == DEFAULT.codec_floor
    assert max(abs(output.cells).max() for output in outputs) < 4.0


def test_pixels_without_a_value_are_not_observed(rng):
    frames = 50.0 + 3.0 * rng.standard_normal((30, 40, 48))
    frames[:, :, :9] = np.nan
    frames[20, 10:20, 30:40] = np.inf
    cells = cells_of(frames)
    assert np.isfinite(cells).all()
    assert not cells[:, :, :3].any()
    assert not cells[20, 6:9, 16:19].any()
    assert cells[21:, 6:9, 16:19].all()


@pytest.mark.parametrize('kind', ['hot', 'dead', 'blinking'])
def test_defective_pixels_raise_no_alarm(rng, kind):
    frames = 1000.0 + 20.0 * rng.standard_normal((80, 40, 48))
    frames[:, 20, 24] = {
        'hot': 30_000.0, 'dead': 0.0, 'blinking': 1000.0 + 400.0 * rng.integers(0, 2, 80)}[kind]
    assert cells_of(frames)[10:, 8:12, 10:14].max() < 5.0


def test_frames_without_noise_give_finite_cells():
    frames = np.zeros((12, 16, 16))
    frames[8, 4, 4] = 1.0
    assert np.isfinite(cells_of(frames)).all()


@pytest.mark.slow
def test_white_noise_keeps_the_calibrated_false_alarm_rate():
    runs, first, count, rng = 100, 60, 200, np.random.default_rng(0)
    detector = detector_class('sdt')(sensor=SensorModel(snr_db=8.0))
    detector = replace(detector, threshold=calibrated(detector, 0.01, (20, 20)).threshold)
    shares = []
    for _ in range(runs):
        cells = cells_of(500.0 + 7.0 * rng.standard_normal((first + count, 40, 40)))
        memory, alarms = detector.init((20, 20)), []
        for frame in cells:
            memory, declared = detector.step(memory, frame.astype(float), rng)
            alarms.append(bool(declared.any))
        shares.append(np.mean(alarms[first:]))
    # 20 % of the rate, and 3 standard errors over runs, for 20,000 frames.
    assert abs(np.mean(shares) - 0.01) < 0.002 + 3 * np.std(shares, ddof=1) / runs**0.5
