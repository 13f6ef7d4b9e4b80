# SPDX-License-Identifier: Apache-2.0
"""The conditioner turns real frames into unit white noise, and keeps objects."""

from dataclasses import replace
from pathlib import Path

from lowsnr_common.core.frame_map import overlaps
from lowsnr_common.core.measurement import SensorModel
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
from sensor.camera_scene import cells_of
from sensor.camera_scene import conditioned
from sensor.camera_scene import DEFAULT
import yaml

FILE = Path(__file__).resolve().parents[2] / 'config' / 'conditioner.yaml'


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


def test_cosmic_rays_are_limited_and_a_bright_object_is_not():
    frames, truth = camera_scene(amplitude=20.0)
    frames[40, 11, 11] += 1000.0
    frames[40, 51:54, 20:26] += 600.0
    outputs = conditioned(frames)
    for rows, cols in ((slice(4, 7), slice(4, 7)), (slice(24, 28), slice(9, 14))):
        # The limit of 3.5, less the mean of the surroundings.
        assert 2.5 < outputs[40].cells[rows, cols].max() < 4.0
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
