# SPDX-License-Identifier: Apache-2.0
"""Random streams: the children of one root seed, each for one use."""

import itertools
import os
import subprocess
import sys

from lowsnr_common.core.particle_kernels import cell_ratio
from lowsnr_common.core.streams import standard_normal
from lowsnr_common.core.streams import stream
import numpy as np
import pytest

USES = ('truth', 'noise', 'detector', 'tracker', 'calibration')


@pytest.mark.parametrize('run', [0, 3])
@pytest.mark.parametrize(('position', 'use'), enumerate(USES))
def test_stream_is_the_spawned_child(position, use, run):
    child = np.random.SeedSequence(7).spawn(run + 1)[run].spawn(len(USES))[position]
    expected = np.random.default_rng(child).random(8)
    np.testing.assert_array_equal(stream(7, use, run).random(8), expected)


def test_streams_of_seed_use_and_run_differ():
    draws = [tuple(stream(seed, use, run).integers(2**63, size=4))
             for seed, use, run in itertools.product((0, 1), USES, (0, 1))]
    assert len(set(draws)) == len(draws)


def test_unknown_use_is_rejected():
    with pytest.raises(ValueError, match='nosie'):
        stream(0, 'nosie')


@pytest.mark.parametrize('shape', [(), (0,), (7,), (999,), (50, 20), (3, 401, 503)])
def test_normal_numbers_are_those_of_numpy_to_the_bit(shape):
    # Of 604,809 numbers about 150 are from the tails, and 7,000 from the edges of the ziggurat.
    cell_ratio(np.zeros((1, 2, 3)), np.zeros((1, 1, 4)), 1.0, 1.0, 1.0)  # so that all compile
    rng, other = stream(3, 'noise'), stream(3, 'noise')
    for _ in range(2):
        np.testing.assert_array_equal(
            np.asarray(standard_normal(shape, rng)).view(np.uint64),
            np.asarray(other.standard_normal(shape)).view(np.uint64))
        assert rng.integers(100, size=3).tolist() == other.integers(100, size=3).tolist()
    assert rng.bit_generator.state == other.bit_generator.state


@pytest.mark.parametrize(('count', 'loaded'), [(99_999, False), (100_000, True)])
def test_a_process_without_loops_loads_the_compiler_for_many_numbers_alone(count, loaded):
    script = (
        'import sys; from lowsnr_common.core.streams import standard_normal, stream; '
        f'standard_normal(({count},), stream(0, "noise")); print("numba" in sys.modules)')
    done = subprocess.run(
        [sys.executable, '-c', script], check=True, capture_output=True, text=True,
        env=os.environ | {'PYTHONPATH': os.pathsep.join(sys.path)})
    assert done.stdout.strip() == str(loaded)
