# SPDX-License-Identifier: Apache-2.0
"""The functions of lowsnr: what they return, what they refuse, and what they leave alone."""

import io
import json
import math
import sys

import lowsnr
import numpy as np
import pytest
from scipy.stats import norm

FAST = {'cdt.operating_point': 'manual', 'cdt.threshold': 6.0}
SHAPE = (12, 17)


@pytest.fixture
def frames(rng):
    """Return white noise with an object of 20 dB that moves along a row."""
    made = rng.standard_normal((15, *SHAPE))
    for k in range(15):
        made[k, 5, 1 + k] += 10.0
    return made


@pytest.fixture
def camera(rng):
    """Return 8-bit frames of a level scene in which a bright spot moves along a row."""
    rows, cols = np.indices((48, 64))
    return np.rint([
        100.0 + rng.normal(0.0, 4.0, (48, 64))
        + 80.0 * np.exp(-((cols - 8.0 - 2.0 * k)**2 + (rows - 21.0)**2) / 2.0)
        for k in range(20)]).astype(np.uint8)


def test_object_is_detected_and_tracked_where_it_is(frames):
    result = lowsnr.track(frames, 'cdt', 20, settings=FAST, period_s=0.5)
    truth = {(k, 1.0 + k, 5.0) for k in range(15)}
    assert truth <= set(zip(
        *(result.detections[name].tolist() for name in ('frame', 'x', 'y'))))
    tracks = result.tracks[result.tracks.frame >= 8]
    assert tracks.frame.tolist() == list(range(8, 15))
    assert len(set(tracks.id.tolist())) == 1
    np.testing.assert_allclose(tracks.x, 1.0 + tracks.frame, atol=1.5)
    np.testing.assert_allclose(tracks.time_s, 0.5 * tracks.frame)
    assert result.detections.dtype.names == (
        'frame', 'time_s', 'x', 'y', 'v_x', 'v_y', 'sd_x', 'sd_y', 'sd_v_x', 'sd_v_y', 'score')


def test_detect_declares_what_track_does(frames):
    alone = lowsnr.detect(frames, 'cdt', 20, settings=FAST)
    both = lowsnr.track(frames, 'cdt', 20, settings=FAST)
    assert alone.detections.tobytes() == both.detections.tobytes()
    assert len(alone.detections) >= 15


def test_settings_of_a_result_repeat_it(frames):
    first = lowsnr.track(frames, 'cdt', 20, settings=FAST | {'tracker.particles': np.int64(50)})
    assert (first.settings['tracker.particles'], first.settings['cdt.sensor.snr_db']) == (50, 20)
    assert first.thresholds == {'threshold': 6.0}
    again = lowsnr.track(frames, **first.arguments)
    assert again.tracks.tobytes() == first.tracks.tobytes()
    assert again.settings == first.settings


@pytest.mark.parametrize(('made', 'options'), [
    ('frames', {'detector': 'cdt', 'snr_db': 20, 'settings': FAST}), ('camera', {})])
def test_arguments_of_a_result_repeat_it_whatever_period_and_seed(request, made, options):
    taken = request.getfixturevalue(made)
    first = lowsnr.track(taken, period_s=0.5, seed=5, **options)
    again = lowsnr.track(taken, **json.loads(json.dumps(first.arguments)))
    assert len(first.tracks)
    for name in ('detections', 'tracks'):
        assert getattr(again, name).tobytes() == getattr(first, name).tobytes()
    assert again.arguments == first.arguments
    assert (first.period_s, first.seed) == (0.5, 5)
    other = lowsnr.track(taken, **first.arguments | {'seed': 6})
    assert other.tracks.tobytes() != first.tracks.tobytes()


def test_frames_of_a_camera_are_conditioned_with_adaptive_thresholds(camera):
    result = lowsnr.track(camera)
    assert (result.detector, result.conditioned, result.events) == ('auto', True, {0: 'start'})
    assert result.settings['auto.operating_point'] == 'adaptive'
    assert result.settings['conditioner.binning'] == 2
    assert result.alarm_rate.asked == 0.01
    found = result.tracks[result.tracks.frame >= 15]
    assert len(found) == 5
    np.testing.assert_allclose(found.x, 8.0 + 2.0 * found.frame, atol=2.0)
    np.testing.assert_allclose(found.y, 21.0, atol=2.0)


def test_conditioned_cells_are_white_and_lie_where_their_maps_say(camera):
    found = lowsnr.condition(camera)
    assert (found.cells.shape, found.cells.dtype) == ((20, 24, 32), np.float32)
    for k in range(10, 20):
        row, col = np.unravel_index(found.cells[k].argmax(), found.cells[k].shape)
        np.testing.assert_allclose(
            found.maps[k].pixels(np.array([col, row])), (8.0 + 2.0 * k, 21.0), atol=2.0)
    assert 0.7 < np.std(found.cells[10:, :6]) < 1.3
    assert lowsnr.condition(camera, settings={'conditioner.binning': 1}).cells.shape[1:] == (
        48, 64)


def test_simulated_frames_are_the_truth_in_white_noise():
    made = lowsnr.simulate('example4', snr_db=30.0, seed=3)
    assert (made.frames.shape, made.frames.dtype, made.snr_db) == ((40, 20, 20), np.float32, 30.0)
    assert made.truth.frame.tolist() == list(range(4, 35))
    noise = made.frames.copy()
    for row in made.truth:
        noise[row.frame, round(row.y), round(row.x)] -= 10.0**1.5
    assert abs(noise.mean()) < 4.0 / math.sqrt(noise.size)
    assert abs(noise.std() - 1.0) < 4.0 / math.sqrt(2 * noise.size)
    assert lowsnr.simulate('example4', snr_db=30.0, seed=3).frames.tobytes() == (
        made.frames.tobytes())


def test_calibrated_threshold_is_that_of_the_normal_distribution(monkeypatch, tmp_path):
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
    found = lowsnr.calibrate(tuple(np.array([8, 9])), 'cdt', 10.0, false_alarm_prob=0.1)
    # A frame of n cells is empty with the probability Phi(z)^n.
    z = norm.ppf(0.9 ** (1.0 / 72.0))
    intensity = 10.0**0.5
    assert found.threshold == pytest.approx(
        intensity * (2.0 * z - intensity) / 2.0, abs=2.0 * np.ptp(found.interval))
    assert (found.false_alarm_prob, found.shape) == (0.1, (8, 9))
    result = lowsnr.detect(np.random.default_rng(1).standard_normal((9, 8, 9)), 'cdt', 10,
                           false_alarm_prob=0.1)
    assert result.thresholds['threshold'] == found.threshold  # from the same file


@pytest.mark.parametrize('kind', [np.float16, np.float32, np.float64, np.int16, np.uint8])
def test_frames_are_not_written_to(frames, kind):
    own = np.rint(100.0 + 10.0 * frames).astype(kind) if kind in (np.int16, np.uint8) else (
        frames.astype(kind))
    before = own.copy()
    own.flags.writeable = False
    lowsnr.track(own, 'cdt', 20, settings=FAST)
    assert own.tobytes() == before.tobytes()


def test_tables_are_read_only_records(frames):
    table = lowsnr.track(frames, 'cdt', 20, settings=FAST).tracks
    with pytest.raises(ValueError, match='read-only'):
        table['x'] = 0.0
    assert table[0].x == table['x'][0] == table.x[0]


def test_masked_pixels_have_no_value(camera):
    masked = np.ma.masked_array(camera, mask=np.zeros(camera.shape, bool))
    masked[:, 20:23] = np.ma.masked  # the row of the object
    plain, hidden = lowsnr.condition(camera).cells, lowsnr.condition(masked).cells
    assert plain[10:].max() > 2.0 * hidden[10:].max()


@pytest.mark.parametrize('whole', [False, True])
def test_masked_integers_are_conditioned_as_integers_are(camera, whole):
    value = 255 if whole else int(camera[0, 0, 0])  # which no pixel has, or some have
    masked = np.ma.masked_equal(camera, value)
    assert np.ma.is_masked(masked) != whole
    found = lowsnr.detect(masked, 'cdt')
    assert found.conditioned
    apart = lowsnr.detect(list(masked), 'cdt')
    assert apart.detections.tobytes() == found.detections.tobytes()
    plain = lowsnr.detect(camera, 'cdt').detections
    assert (plain.tobytes() == found.detections.tobytes()) == whole


class Mute:
    """A stream as some hosts put it in the place of stderr."""

    def write(self, text):
        """Drop the text."""

    def flush(self):
        """Do nothing."""


CLOSED = io.StringIO()
CLOSED.close()


@pytest.mark.parametrize('stream', [None, Mute(), CLOSED], ids=['none', 'mute', 'closed'])
@pytest.mark.parametrize('shown', [None, True])
def test_process_needs_no_stderr(monkeypatch, frames, stream, shown):
    monkeypatch.setattr('lowsnr.sequence._DELAY_S', 0.0)
    monkeypatch.setattr(sys, 'stderr', stream)
    found = lowsnr.track(frames, 'cdt', 20, settings=FAST, progress=shown)
    monkeypatch.undo()
    assert len(found.detections) >= 15


@pytest.mark.parametrize(('count', 'lines'), [(0, 1), (3, 4), (10, 11), (31, 12)])
def test_printed_table_has_its_columns_and_first_and_last_rows(count, lines):
    table = lowsnr.simulate('example4').truth[:count]
    shown = str(table).splitlines()
    assert len(shown) == lines
    assert shown[0].split() == list(table.dtype.names)
    assert len({len(line) for line in shown if '...' not in line}) == 1
    if count:
        assert [int(shown[row].split()[0]) for row in (1, -1)] == [4, 3 + count]


@pytest.mark.parametrize('shown', [None, True])
def test_progress_is_for_terminals_unless_asked_for(capfd, monkeypatch, frames, shown):
    monkeypatch.setattr('lowsnr.sequence._DELAY_S', 0.0)
    lowsnr.track(frames, 'cdt', 20, settings=FAST, progress=shown)
    assert ('15 of 15 frames' in capfd.readouterr().err) == bool(shown)
