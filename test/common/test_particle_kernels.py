# SPDX-License-Identifier: Apache-2.0
"""The compiled loops compute what plain NumPy does, for the same random numbers."""

from dataclasses import replace
import os
from pathlib import Path
import shutil
import subprocess
import sys

from common import numpy_particles
from lowsnr_common.core import particle_kernels as kernels
from lowsnr_common.core.likelihood import state_log_ratio
from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.motion import MotionModes
from lowsnr_common.core.particles import pick
from lowsnr_common.core.particles import systematic_resample
import numpy as np
import pytest

BATCHES = [(), (3,), (2, 3)]
SENSOR = SensorModel(snr_db=7.0, noise_std=1.7, cell_size_m=1.5)
# Some units in the last place of numbers of the size of the result.
ROUNDING = {'rtol': 1e-13, 'atol': 1e-13}


def twice(seed=5):
    """Return two generators that draw the same numbers."""
    return np.random.default_rng(seed), np.random.default_rng(seed)


@pytest.mark.parametrize('batch', BATCHES)
@pytest.mark.parametrize('rates', [(0.0, 20.0), (0.0, 20.0, -20.0), (5.0, 1.0, 2.0, 3.0, 4.0)])
def test_modes_switch_as_in_numpy(rng, batch, rates):
    motion = MotionModes(turn_rates_deg_s=rates, mode_sojourn_s=2.0)
    modes = rng.integers(len(rates), size=(*batch, 500))
    one, other = twice()
    after = motion.switch(modes, 0.7, one)
    assert np.array_equal(after, numpy_particles.switch(motion, modes, 0.7, other))
    assert after.dtype == modes.dtype
    assert one.random() == other.random()


@pytest.mark.parametrize('batch', BATCHES)
@pytest.mark.parametrize('density', [0.0, 0.3])
@pytest.mark.parametrize('rates', [(0.0,), (0.0, 20.0, -20.0)])
def test_states_move_as_in_numpy(rng, batch, density, rates):
    motion = MotionModes(turn_rates_deg_s=rates, acceleration_density=density)
    states = 20.0 * rng.standard_normal((*batch, 500, 4))
    modes, kept = rng.integers(len(rates), size=(*batch, 500)), states.copy()
    one, other = twice()
    after = motion.move(states, modes, 0.7, one)
    expected = numpy_particles.move(motion, states, modes, 0.7, other)
    np.testing.assert_allclose(after, expected, **ROUNDING)
    assert np.array_equal(states, kept)
    assert one.random() == other.random()


@pytest.mark.parametrize('batch', BATCHES)
@pytest.mark.parametrize('kind', [np.float64, np.float32])
def test_ratio_of_cells_is_numpy_s_to_the_bit(rng, batch, kind):
    frames, states = frames_and_states(rng, batch, kind)
    found = state_log_ratio(SENSOR, frames, states)
    assert np.array_equal(found, numpy_particles.state_log_ratio(SENSOR, frames, states))
    assert 0.1 < np.mean(found == -np.inf) < 0.9


@pytest.mark.parametrize('batch', BATCHES)
@pytest.mark.parametrize('blur', [0.05, 0.6, 1.4])
def test_ratio_with_blur_is_numpy_s(rng, batch, blur):
    sensor = replace(SENSOR, blur_m=blur)
    frames, states = frames_and_states(rng, batch, float)
    np.testing.assert_allclose(
        state_log_ratio(sensor, frames, states),
        numpy_particles.state_log_ratio(sensor, frames, states), rtol=1e-12, atol=1e-11)


def test_state_of_nan_is_outside_the_frame():
    states = np.full((1, 4), np.nan)
    for sensor in (SENSOR, replace(SENSOR, blur_m=0.6)):
        assert state_log_ratio(sensor, np.zeros((7, 5)), states) == [-np.inf]


@pytest.mark.parametrize('batch', BATCHES)
@pytest.mark.parametrize('size', [1, 2, 300])
@pytest.mark.parametrize('count', [1, 77, 1000])
def test_resampling_draws_what_numpy_draws(rng, batch, size, count):
    log_weights = 3.0 * rng.standard_normal((*batch, size))
    log_weights[..., rng.random(size) < 0.2] = -np.inf
    one, other = twice()
    assert np.array_equal(
        systematic_resample(log_weights, count, one),
        numpy_particles.systematic_resample(log_weights, count, other))


@pytest.mark.parametrize('batch', BATCHES)
def test_picked_particles_are_numpy_s(rng, batch):
    chosen = rng.integers(40, size=(*batch, 60))
    states, modes = rng.random((*batch, 40, 4)), rng.integers(3, size=(*batch, 40))
    assert np.array_equal(pick(modes, chosen), np.take_along_axis(modes, chosen, axis=-1))
    assert np.array_equal(
        pick(states, chosen), np.take_along_axis(states, chosen[..., None], axis=-2))


def test_arrays_need_not_be_contiguous(rng):
    motion, wide = MotionModes(), rng.random((6, 50, 8))
    states, modes = wide[::2, :, ::2], np.asfortranarray(rng.integers(3, size=(3, 50)))
    frames = np.asfortranarray(rng.random((3, 7, 5)))
    one, other = twice()
    np.testing.assert_allclose(
        motion.move(states, modes, 1.0, one),
        numpy_particles.move(motion, states, modes, 1.0, other), **ROUNDING)
    assert np.array_equal(
        state_log_ratio(SENSOR, frames, states),
        numpy_particles.state_log_ratio(SENSOR, frames, states))
    one, other = twice()
    assert np.array_equal(
        systematic_resample(wide[:, :, 0].T, 9, one),
        numpy_particles.systematic_resample(wide[:, :, 0].T, 9, other))


def test_numba_is_imported_at_the_first_call_of_a_loop():
    program = (
        'import sys; import lowsnr_common.core.particles as p; assert "numba" not in sys.modules; '
        'import numpy as np; p.systematic_resample(np.zeros(3), 3, np.random.default_rng(0)); '
        'assert "numba" in sys.modules')
    subprocess.run([sys.executable, '-c', program], check=True, env=environment())


def test_loops_run_where_no_folder_can_be_written(tmp_path):
    # A file is where the folders of the machine code would be.
    package = Path(kernels.__file__).parents[1]
    shutil.copytree(
        package, tmp_path / package.name, ignore=shutil.ignore_patterns('__pycache__'))
    (tmp_path / package.name / 'core' / '__pycache__').touch()
    (tmp_path / 'home').touch()
    program = (
        'import numpy as np; import lowsnr_common.core.particles as p; '
        f'assert p.__file__.startswith({str(tmp_path)!r}); '
        'print(*p.systematic_resample(np.zeros(3), 3, np.random.default_rng(0)))')
    found = subprocess.run(
        [sys.executable, '-c', program], check=True, capture_output=True, text=True,
        env=environment(
            PYTHONPATH=tmp_path, HOME=tmp_path / 'home', XDG_CACHE_HOME=tmp_path / 'home'))
    assert found.stdout == '0 1 2\n'


def frames_and_states(rng, batch, kind):
    """Return frames (..., 7, 5) and states (..., 80, 4), inside the frame and outside."""
    states = np.zeros((*batch, 80, 4))
    states[..., [0, 2]] = 1.5 * rng.uniform(-1.5, [5.5, 7.5], (*batch, 80, 2))
    return (2.0 * rng.standard_normal((*batch, 7, 5)) + 0.5).astype(kind), states


def environment(**changes):
    """Return the environment of a process that imports the package from the same folder."""
    package = Path(kernels.__file__).parents[2]
    return {**os.environ, 'PYTHONPATH': str(package), **{k: str(v) for k, v in changes.items()}}
