# SPDX-License-Identifier: Apache-2.0
"""Random streams: the children of one root seed, each for one use."""

import itertools

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
