# SPDX-License-Identifier: Apache-2.0
"""Compressed video: what a codec copies from frame to frame is background, not a measurement."""

from dataclasses import replace

from lowsnr_sensor.conditioning import codec
import numpy as np
import pytest
from sensor.camera_scene import at_object
from sensor.camera_scene import camera_scene
from sensor.camera_scene import conditioned
from sensor.camera_scene import DEFAULT

SHAPE = (64, 80)


def compressed(rng, frames=60, speed=0.2, peak=40.0):
    """Return frames (T, rows, cols) whose blocks change at times, and an object's places x, y."""
    scene = rng.integers(30, 34, SHAPE)
    row, col = np.mgrid[:SHAPE[0], :SHAPE[1]]
    truth = np.stack([20.0 + speed * np.arange(frames), np.full(frames, 30.3)], axis=1)
    out = np.empty((frames, *SHAPE), np.uint8)
    for k, (x, y) in enumerate(truth):
        for top, left in rng.integers(0, np.array(SHAPE) // 8, (4, 2)) * 8:
            scene[top:top + 8, left:left + 8] = rng.integers(30, 34)
        out[k] = np.rint(scene + peak * np.exp(-((row - y)**2 + (col - x)**2) / 1.62))
    return out, truth


def test_trail_of_an_object_is_background_after_twelve_frames(rng):
    frames, _ = compressed(rng, peak=0.0)
    frames[25:, 40, 60:62] += 30
    outputs = conditioned(frames)
    seen = np.array([output.cells[19:22, 29:32].max() for output in outputs])
    assert seen[25:29].min() > 4.0
    assert seen[37:].max() < 1.0


@pytest.mark.parametrize('speed', [0.2, 1.0])
def test_object_that_moves_is_not_absorbed_as_copies_are(rng, speed):
    frames, truth = compressed(rng, speed=speed)
    seen = at_object(conditioned(frames), truth)
    assert np.median(seen[25:]) > 8.0
    assert seen[25:].min() > 4.0


def test_nothing_is_copied_in_video_without_compression():
    frames, _ = camera_scene()
    state = DEFAULT.init(frames[0].shape)
    for frame in np.rint((frames - 1000.0) / 40.0 + 12.0).clip(0).astype(np.uint8):
        state, _ = DEFAULT.step(state, frame)
    assert state.codec < codec.CODED
    assert not state.copies.any()


@pytest.mark.parametrize('motion', [(0, 0), (2, -3), (-1, 0)])
def test_copies_are_counted_in_the_scene(rng, motion):
    wide = 1.0 + rng.permutation(40 * 40).reshape(40, 40).astype(np.float32)
    state = DEFAULT.init((20, 24))
    position = np.array([0.2, -0.3])
    for k in range(4):
        top, left = np.array([8, 10]) + k * np.array(motion)
        frame = wide[top:top + 20, left:left + 24]
        place = tuple(position + k * np.array(motion))
        count = codec.counted(state, frame, place, codec=1.0)
        state = replace(state, copies=count, previous=frame, position=place)
    # The first of them differs from the zeros before it.
    assert count.max() == 3
    down, right = (3 * abs(step) for step in motion)
    assert np.count_nonzero(count == 3) == (20 - down) * (24 - right)


def test_level_approaches_what_was_copied_four_times():
    state, _ = DEFAULT.step(DEFAULT.init((4, 5)), np.full((4, 5), 10.0))
    count = np.arange(20, dtype=np.uint8).reshape(4, 5)
    level = codec.settled(state.planes, np.full((4, 5), 15.0, np.float32), count).level
    np.testing.assert_allclose(level, np.where(count >= 4, 11.5, 10.0), rtol=1e-6)
