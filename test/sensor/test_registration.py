# SPDX-License-Identifier: Apache-2.0
"""The conditioner follows the motion of the camera, and only that."""

from lowsnr_sensor.conditioning.conditioner import ConditioningSettings
from lowsnr_sensor.conditioning.registration import phase_correlation
from lowsnr_sensor.conditioning.registration import spectrum
import numpy as np
import pytest
import scipy.ndimage
from sensor.camera_scene import at_object
from sensor.camera_scene import camera_scene


def conditioned(frames, **settings):
    """Return the outputs of a sequence of frames."""
    conditioner = ConditioningSettings(**settings)
    state, outputs = conditioner.init(frames[0].shape), []
    for frame in frames:
        state, output = conditioner.step(state, frame)
        outputs.append(output)
    return outputs


def motions(outputs):
    """Return the motion scene to image of each frame, x, y."""
    return np.array([output.to_image for output in outputs])


@pytest.fixture(scope='module')
def texture():
    """Return a scene of 400 x 500 pixels with structure of all sizes, of deviation 40."""
    rng = np.random.default_rng(3)
    plane = sum(scale * scipy.ndimage.gaussian_filter(rng.standard_normal((400, 500)), scale)
                for scale in (1.5, 4.0, 12.0))
    return 500.0 + 40.0 * plane / plane.std()


def seen(texture, corner, rng, shape=(120, 160)):
    """Return the frame whose pixel (0, 0) is at ``corner`` of the scene, with noise."""
    plane = scipy.ndimage.shift(texture, [-place for place in corner], order=5, mode='nearest')
    return plane[:shape[0], :shape[1]] + 4.0 * rng.standard_normal(shape)


@pytest.mark.parametrize('motion', [(0, 0), (3, -8), (-10, 10), (21, 14)])
def test_phase_correlation_finds_whole_motions(texture, rng, motion):
    before = seen(texture, (60, 70), rng)
    after = seen(texture, (60 + motion[0], 70 + motion[1]), rng)
    down, right, response = phase_correlation(spectrum(after), spectrum(before), after.shape)
    assert (down, right) == pytest.approx(motion, abs=0.6)
    assert response > 0.3


def test_phase_correlation_of_two_scenes_has_no_response(rng):
    now, past = (spectrum(frame) for frame in rng.standard_normal((2, 120, 160)))
    assert phase_correlation(now, past, (120, 160))[2] < 0.3


def test_pan_is_followed_to_a_fraction_of_a_pixel(texture, rng):
    steps = np.concatenate([np.full((10, 2), (0.3, 1.7)), np.full((8, 2), (2.0, 10.0)),
                            rng.normal(0.0, 1.0, (10, 2))])
    corners = np.concatenate([[(50.0, 60.0)], (50.0, 60.0) + np.cumsum(steps, axis=0)])
    outputs = conditioned([seen(texture, corner, rng) for corner in corners])
    error = motions(outputs) + (corners - corners[0])[:, ::-1]
    assert np.median(np.hypot(*error.T)) < 0.1
    assert np.hypot(*error.T).max() < 0.2
    assert sum(any(output.shift) for output in outputs) > 3
    ends = np.cumsum([output.shift for output in outputs], axis=0)
    np.testing.assert_array_equal(ends, [output.origin for output in outputs])
    # What is known of the scene stays at its noise in spite of the motion.
    cells = np.array([output.cells for output in outputs[10:]])
    assert cells[cells != 0.0].std() == pytest.approx(1.0, abs=0.15)


def test_jitter_of_one_pixel_costs_no_object_and_raises_no_alarm(rng):
    shifts = rng.normal(0.0, 1.0, (60, 2))
    still, places = camera_scene(amplitude=4.0)
    moving, truth = camera_scene(amplitude=4.0, shifts=shifts)
    wanted = np.median(at_object(conditioned(still), places)[10:])
    outputs = conditioned(moving)
    error = motions(outputs) - shifts
    # The scene has the place of the first frames, which is known to no better than these.
    error -= np.median(error, axis=0)
    assert np.median(np.hypot(*error.T)) < 0.2
    assert np.median(at_object(outputs, truth)[10:]) > 0.85 * wanted
    alarms, blind = (
        np.mean([output.cells > 6.0 for output in found[10:]])
        for found in (outputs, conditioned(moving, registration=False)))
    assert alarms < 0.5 * blind


@pytest.mark.parametrize('level', [0.0, 1000.0])
def test_noise_alone_is_no_motion(rng, level):
    frames = level + 9.0 * rng.standard_normal((40, 64, 80))
    assert not motions(conditioned(frames)).any()


def test_bright_object_is_no_motion_of_the_camera(rng):
    frames, _ = camera_scene(amplitude=60.0)
    assert abs(motions(conditioned(frames))).max() < 0.1


def test_cut_starts_anew_and_is_named(texture, rng):
    frames = [seen(texture, (20, 30), rng) for _ in range(12)]
    frames += [seen(texture, (230, 290), rng) for _ in range(12)]
    outputs = conditioned(frames)
    named = [(k, output.event) for k, output in enumerate(outputs) if output.event]
    assert named[0] == (0, 'start')
    assert [event for _, event in named[1:]] == ['cut']
    assert 12 <= named[1][0] <= 14
    assert outputs[-1].cells.std() == pytest.approx(1.0, abs=0.15)
