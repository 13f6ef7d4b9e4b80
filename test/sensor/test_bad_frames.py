# SPDX-License-Identifier: Apache-2.0
"""Frames and pixels without content raise no alarm, and the next good frame is conditioned."""

from lowsnr_common.core.records import Malformed
import numpy as np
import pytest
from sensor.camera_scene import at_object
from sensor.camera_scene import camera_scene
from sensor.camera_scene import cells_of
from sensor.camera_scene import conditioned
from sensor.camera_scene import DEFAULT


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
