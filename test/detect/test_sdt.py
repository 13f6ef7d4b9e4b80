# SPDX-License-Identifier: Apache-2.0
"""SDT decides as the enumeration of every path does, and with one frame as CDT does."""

from dataclasses import replace
import itertools
import math

from detect.oracles import PathTest
from lowsnr_common.core.destination import Destination
from lowsnr_common.core.measurement import SensorModel
from lowsnr_detect.detectors.cdt import CDT
from lowsnr_detect.detectors.sdt import SDT
from lowsnr_detect.parts.destination_moves import cell_likelihoods
from lowsnr_detect.parts.destination_moves import move_likelihoods
from lowsnr_detect.parts.moves import move_model
from lowsnr_detect.parts.wald_bounds import wald_bounds
import numpy as np
import pytest

SHAPE = (4, 3)
FRAMES = 5
SENSOR = SensorModel(snr_db=3.0, noise_std=2.0)
# Every crossing cell is declared: the oracle does not thin.
CELLS = {'thinning_reach': 0, 'max_detections': 12, 'sensor': SENSOR}


def declared_cells(detector, frames):
    """Return the declared cells of each frame."""
    state, found = detector.init(frames.shape[1:]), []
    for frame in frames:
        state, declared = detector.step(state, frame, None)
        found.append({(int(e.state[2]), int(e.state[0])) for e in declared.estimates()})
    return found


def declare_all(detector, frames):
    """Return the declarations of each frame (..., K, rows, cols)."""
    state = detector.init((*frames.shape[:-3], *frames.shape[-2:]))
    answers = []
    for k in range(frames.shape[-3]):
        state, declared = detector.step(state, frames[..., k, :, :], None)
        answers.append(declared)
    return answers


def same(one, other, names=('peak', 'score', 'state', 'cov')):
    """Tell whether two declarations are equal, bit for bit."""
    return all(np.array_equal(getattr(one, name), getattr(other, name), equal_nan=True)
               for name in names)


@pytest.mark.parametrize('restart', ['all', 'unused'])
@pytest.mark.parametrize(('most', 'radius', 'upper', 'move_prior'), [
    (3, 1, 2.5, False), (3, 1, 100.0, False), (4, 1, 2.0, False), (3, 2, 3.0, False),
    (4, 0, 1.5, False), (3, 1, 2.0, True), (2, 1, 0.5, False)])
def test_decides_as_the_enumeration_of_all_paths(rng, restart, most, radius, upper, move_prior):
    detector = SDT(**CELLS, max_iterations=most, radius=radius, restart=restart, threshold=1.0,
                   upper_threshold=upper, move_prior=move_prior, alpha=0.1, beta=0.1)
    model = move_model(detector.motion, SENSOR, 0)
    log_move = dict(zip(map(tuple, model.moves), np.log(model.kernel.ravel())))
    oracle = PathTest(
        SENSOR.intensity, SENSOR.noise_std, most, radius, restart, wald_bounds(0.1, 0.1)[0],
        upper, 1.0, log_move if move_prior else None)
    seen = 0
    for _ in range(12):
        frames = 2.0 * rng.standard_normal((FRAMES, *SHAPE)) + 0.5
        found = declared_cells(detector, frames)
        assert found == oracle.run(frames)
        seen += sum(map(len, found))
    assert seen > 10


@pytest.mark.parametrize('blur', [0.0, 0.7])
def test_one_frame_is_cdt(rng, blur):
    sensor = replace(SENSOR, blur_m=blur)
    frames = 2.0 * rng.standard_normal((4, FRAMES, 7, 5)) + 1.0
    one = SDT(sensor=sensor, max_iterations=1, threshold=0.4)
    cdt = CDT(sensor=sensor, threshold=0.4)
    for a, b in zip(declare_all(one, frames), declare_all(cdt, frames), strict=True):
        assert a.any.any()
        assert same(a, b, ('peak', 'score', 'state'))
        assert a.cov == pytest.approx(b.cov, rel=1e-12, nan_ok=True)


@pytest.mark.parametrize('settings', [
    {}, {'restart': 'unused'}, {'radius': 2}, {'move_prior': True}, {'max_iterations': 1},
    {'move_prior': True, 'destination': Destination(probability=0.9, x_m=9.0, arrival_frame=9)}])
@pytest.mark.parametrize('regions', [2, 3, 64])
def test_regions_in_parallel_give_the_same_bits(rng, settings, regions):
    frames = 1.2 * rng.standard_normal((2, 12, 23, 17))
    whole = SDT(threshold=6.0, upper_threshold=8.0, **settings)
    parts = replace(whole, regions=regions)
    for a, b in zip(declare_all(whole, frames), declare_all(parts, frames), strict=True):
        assert same(a, b)


def test_peak_is_above_the_threshold_where_something_is_declared(rng):
    frames = rng.standard_normal((20, 12, 7, 5))
    for upper in (6.0, 100.0):
        detector = SDT(max_iterations=3, threshold=4.0, upper_threshold=upper)
        answers = declare_all(detector, frames)
        assert any(answer.any.any() for answer in answers)
        for answer in answers:
            assert np.array_equal(answer.peak > 4.0, answer.any)


def test_object_in_its_cell_adds_up_as_eq_7_says():
    sensor = SensorModel(snr_db=0.0)
    detector = SDT(sensor=sensor, max_iterations=4, threshold=-1.0)
    frames = np.zeros((4, *SHAPE))
    frames[:, 2, 1] = 1.3
    peaks = [answer.peak for answer in declare_all(detector, frames)]
    assert peaks[:3] == [-math.inf] * 3
    assert peaks[3] == pytest.approx(4 * (1.3 - 0.5))


def test_nominal_bounds_are_walds():
    nominal = SDT(alpha=0.02, beta=0.1, threshold=9.0).nominal()
    assert nominal.threshold == 0.0
    assert nominal.upper_threshold == pytest.approx(math.log(0.9 / 0.02))


@pytest.mark.parametrize('arrival', [3, 5, 20])
def test_with_a_destination_the_best_of_all_paths_counts(rng, arrival):
    # The bounds are out of reach, so that no path is dropped or declared early.
    to = Destination(probability=0.9, x_m=2.0, y_m=3.0, std_m=0.8, arrival_frame=arrival)
    detector = SDT(sensor=SENSOR, max_iterations=3, move_prior=True, destination=to,
                   threshold=1e6, beta=1e-200)
    frames = 2.0 * rng.standard_normal((FRAMES, *SHAPE))
    ratio = SENSOR.log_likelihood_ratio(frames)
    model = move_model(detector.motion, SENSOR, 0)
    known = to, detector.motion, SENSOR, 0
    answers = declare_all(detector, frames)
    for last in range(2, FRAMES):
        best = -math.inf
        for start, *moves in itertools.product(np.ndindex(*SHAPE), range(9), range(9)):
            cell, total = np.array(start), ratio[last - 2][start]
            if to.is_ahead(last - 1):
                total += math.log(cell_likelihoods(*known, last - 1, SHAPE)[0, 0][start])
            for number, move in zip((last, last + 1), moves):
                prob = model.kernel[0, move, 0]
                if to.is_ahead(number):
                    factor, mean = move_likelihoods(*known, number, SHAPE)
                    prob *= factor[0, move, *cell] / mean[0, 0, *cell]
                cell = cell + model.moves[move]
                if not np.all((cell >= 0) & (cell < SHAPE)):
                    break
                total += math.log(prob) + ratio[number - 1, *cell]
            else:
                best = max(best, total)
        assert answers[last].peak == pytest.approx(best, abs=2e-6)  # in float32


def test_destination_needs_the_move_prior():
    with pytest.raises(ValueError, match='SDT.move_prior'):
        SDT(destination=Destination(probability=0.5))


@pytest.mark.parametrize('snr_db', [6.0, 9.0])
def test_stated_error_of_a_position_is_that_of_simulated_objects(snr_db):
    rng, runs, shape = np.random.default_rng(5), 400, (15, 13)
    detector = SDT(sensor=SensorModel(snr_db=snr_db), threshold={6.0: 8.1, 9.0: 12.5}[snr_db])
    start, velocity = rng.uniform(4.5, 7.5, (runs, 2)), rng.uniform(-0.5, 0.5, (runs, 2))
    frames, objects = rng.standard_normal((runs, 7, *shape)), []
    for k in range(7):
        objects.append(start + k * velocity)
        col, row = np.rint(objects[-1]).astype(int).T
        frames[np.arange(runs), k, row, col] += detector.sensor.intensity
    last = declare_all(detector, frames)[-1]
    errors = last.state[..., [0, 2]] - objects[-1][:, None]
    # The nearest one; the others beside the object are false.
    errors = np.nan_to_num(errors, nan=np.inf)
    away = np.hypot(*np.moveaxis(errors, -1, 0))
    nearest, near = away.argmin(axis=1), away.min(axis=1) <= 3.0
    squared = np.mean(errors[near, nearest[near]]**2, axis=-1)
    stated = np.nanmax(last.cov[..., 0, 0])
    # Four standard errors, and a tenth for the rule, which is fitted at four ratios.
    assert len(squared) > 100
    assert abs(squared.mean() - stated) < 4 * squared.std() / len(squared)**0.5 + 0.1 * stated
