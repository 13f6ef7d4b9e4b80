# SPDX-License-Identifier: Apache-2.0
"""The likelihood ratio of a state is the ratio of the densities of the whole frame."""

from dataclasses import replace

from lowsnr_common.core.likelihood import state_log_ratio
from lowsnr_common.core.measurement import SensorModel
import numpy as np
import pytest

SHAPE = (7, 5)
SENSOR = SensorModel(snr_db=9.0, noise_std=2.0, cell_size_m=1.5)


@pytest.fixture
def states(rng):
    """Return states inside and outside the frame, (2, 40, 4)."""
    states = np.zeros((2, 40, 4))
    states[..., [0, 2]] = 1.5 * rng.uniform(-1.5, [5.5, 7.5], (2, 40, 2))
    return states


@pytest.mark.parametrize('blur', [0.0, 0.6, 1.2])
def test_ratio_is_that_of_the_gaussian_densities(rng, states, blur):
    sensor = replace(SENSOR, blur_m=blur)
    frames = 2.0 * rng.standard_normal((2, *SHAPE)) + 0.5
    found = state_log_ratio(sensor, frames, states)
    inside = 0
    for run, number in np.ndindex(2, 40):
        state, frame = states[run, number], frames[run]
        col, row = state[0] / 1.5 + 0.5, state[2] / 1.5 + 0.5
        if not (0 <= col < 5 and 0 <= row < 7):
            assert found[run, number] == -np.inf
            continue
        inside += 1
        signal = sensor.signal(state, SHAPE)
        exact = (np.sum(frame**2) - np.sum((frame - signal)**2)) / (2.0 * 2.0**2)
        # The point spread is cut off at five widths.
        assert found[run, number] == pytest.approx(exact, abs=1e-3)
    assert inside > 20


def test_ratio_of_a_cell_centre_is_that_of_its_cell(rng):
    frame = rng.standard_normal(SHAPE)
    row, col = np.divmod(np.arange(35), 5)
    states = np.zeros((35, 4))
    states[:, 0], states[:, 2] = 1.5 * col, 1.5 * row
    for blur in (0.0, 0.9):
        sensor = replace(SENSOR, blur_m=blur)
        assert state_log_ratio(sensor, frame, states) == pytest.approx(
            sensor.log_likelihood_ratio(frame).ravel())
