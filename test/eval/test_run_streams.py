"""A batch of runs draws what each run draws alone."""

from lowsnr_common.core.streams import stream
from lowsnr_eval.study.run_streams import RunStreams
import numpy as np
import pytest

RUNS = (4, 9, 2)


def generators():
    return [stream(3, 'detector', run) for run in RUNS]


def test_every_run_draws_what_its_own_stream_gives():
    batch = RunStreams(generators())
    drawn = [
        batch.random((3, 1)), batch.standard_normal((3, 5, 4)),
        batch.uniform(-0.5, 0.5, (3, 7)), batch.integers(3, size=(3, 6)), batch.random((3, 2))]
    for number, own in enumerate(generators()):
        alone = [
            own.random((1,)), own.standard_normal((5, 4)), own.uniform(-0.5, 0.5, (7,)),
            own.integers(3, size=(6,)), own.random((2,))]
        for one, other in zip(drawn, alone):
            assert np.array_equal(one[number], other)


def test_size_that_does_not_start_with_the_runs_is_refused():
    with pytest.raises(ValueError, match='must start with 3 runs'):
        RunStreams(generators()).random((2, 4))
