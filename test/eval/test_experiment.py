# SPDX-License-Identifier: Apache-2.0
"""Experiments: batches and single runs agree, and figures are those of theory."""

from dataclasses import replace

from lowsnr_bringup.plan.empty_tracks import of_run
from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.motion import MotionModes
from lowsnr_common.core.streams import stream
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_detect.parts.registry import detector_class
from lowsnr_detect.parts.registry import DETECTORS
from lowsnr_eval.study import experiment
from lowsnr_eval.study.experiment import Block
from lowsnr_eval.study.experiment import run_block
from lowsnr_eval.study.experiment import simulate_run
from lowsnr_eval.study.offline_chain import Chain
from lowsnr_eval.study.offline_chain import detect
from lowsnr_eval.study.offline_chain import group_by_statistic
from lowsnr_eval.study.offline_chain import RunStreams
from lowsnr_eval.study.offline_chain import track
from lowsnr_sensor.scenario import Scenario
from lowsnr_sensor.scenario import ScenarioObject
from lowsnr_sensor.simulator import simulate_frames
from lowsnr_sensor.trajectories import Leg
from lowsnr_sensor.trajectories import Start
from lowsnr_track.pda_mmpf import PdaMmpf
import numpy as np
import pytest
from scipy.stats import norm

detector_class('sdt')
SENSOR = SensorModel(snr_db=9.0)
OBJECT = ScenarioObject(
    first_frame=3, last_frame=9, start=Start(x_m=1.2, y_m=4.9, heading_deg=-30.0),
    legs=(Leg(until_frame=9, speed_mps=0.4),))
SCENARIO = Scenario(frames=10, rows=7, cols=5, objects=(OBJECT,))
FEW = {'particles': 300, 'birth_particles': 100}


def small(name, **settings):
    """Return a detector of few particles."""
    cls = detector_class(name)
    few = {key: value for key, value in FEW.items() if key in cls.__dataclass_fields__}
    return cls(sensor=SENSOR, **few, **settings)


def block(*chains, scenario=SCENARIO, first=0, count=3, crowded_runs=1, sensor=SENSOR):
    return Block(scenario, sensor, Evaluation(), chains, 11, first, count, crowded_runs)


def chain(detector, point='nominal', runs=100, tracker=None):
    return Chain('it', point, detector, tracker, runs)


def arrays(result):
    return result.detection.arrays() | {
        f'tracking {key}': value for key, value in result.tracking.arrays().items()}


@pytest.mark.parametrize('name', sorted(DETECTORS))
def test_run_is_the_same_alone_and_in_a_batch(name):
    one = chain(small(name), tracker=PdaMmpf(sensor=SENSOR, rows=7, cols=5, particles=50))
    batch = arrays(run_block(block(one, crowded_runs=3))['it', 'nominal'])
    for run in range(3):
        alone = run_block(block(one, first=run, count=1, crowded_runs=3))['it', 'nominal']
        for key, values in arrays(alone).items():
            assert np.allclose(values[0], batch[key][run], atol=1e-9, equal_nan=True), key


@pytest.mark.parametrize('name', sorted(DETECTORS))
def test_batch_declares_what_a_single_step_declares(name):
    _, frames = simulate_run(SCENARIO, SENSOR, 11, 0)
    detector = small(name, threshold=0.5)
    (answers,) = detect([detector], frames[None], 11, 0)
    memory, rng = detector.init(frames[0].shape), stream(11, 'detector', 0)
    for frame, answer in zip(frames, answers):
        memory, declared = detector.step(memory, frame, rng)
        for one, other in zip(declared.estimates(), of_run(answer, 0), strict=True):
            assert np.allclose(one.state, other.state, equal_nan=True)
            assert one.score == pytest.approx(other.score)


@pytest.mark.parametrize('name', sorted(DETECTORS))
def test_thresholds_together_declare_what_they_declare_alone(name):
    _, frames = simulate_run(SCENARIO, SENSOR, 11, 0)
    detectors = [replace(small(name), threshold=value) for value in (2.0, -1.0, 4.0)]
    together = detect(detectors, frames[None], 11, 0)
    for detector, answers in zip(detectors, together):
        (alone,) = detect([detector], frames[None], 11, 0)
        for one, other in zip(answers, alone):
            assert np.array_equal(one.score, other.score)
            assert np.array_equal(one.state, other.state, equal_nan=True)


def test_only_one_posterior_serves_all_thresholds():
    shared = [chain(small('mmtbd2'), 'a'), chain(replace(small('mmtbd2'), threshold=3.0), 'b')]
    assert [len(group) for group in group_by_statistic(shared)] == [2]
    assert [len(group) for group in group_by_statistic([chain(small('sdt'), 'a')] * 2)] == [1, 1]
    other = replace(shared[0], detector=small('mmtbd2', motion=MotionModes(max_speed_mps=2.0)))
    assert len(group_by_statistic([*shared, other])) == 2


def test_frames_are_those_of_the_sensor_node():
    truth, frames = simulate_run(SCENARIO, SENSOR, 11, 0)
    objects = SCENARIO.truth(1.0, 1.0, stream(11, 'truth'))
    assert np.array_equal(
        frames, simulate_frames(objects, SENSOR, SCENARIO.shape, stream(11, 'noise')))
    assert np.isfinite(truth[2:9]).all()
    assert np.isnan(truth[[0, 1, 9]]).all()


def test_cdt_detects_as_often_as_theory_says():
    # An estimate in any of the cells within the gate hits; 400 runs of 7 frames, 4 sigma.
    detector = small('cdt').nominal()
    result = run_block(block(chain(detector, runs=400), count=400))['it', 'nominal']
    truth, _ = simulate_run(SCENARIO, SENSOR, 11, 0)
    intensity = SENSOR.intensity
    bound = detector.threshold / intensity + intensity / 2.0
    quiet, expected = norm.cdf(bound), []
    rows, cols = np.indices((7, 5))
    for x, _, y, _ in truth[2:9]:
        near = np.sum(np.hypot(cols - x, rows - y) <= 1.5)
        expected.append(1.0 - norm.cdf(bound - intensity) * quiet ** (near - 1))
    share = result.detection.hit[:, 2:9].mean(axis=0)
    expected = np.array(expected)
    assert np.all(abs(share - expected) < 4.0 * np.sqrt(expected * (1 - expected) / 400))
    empty = 1.0 - quiet**35
    declared = (result.detection.declared[:, [0, 1, 9]] > 0).mean()
    assert abs(declared - empty) < 4.0 * np.sqrt(empty * (1 - empty) / 1200)


def test_same_detections_of_a_run_are_tracked_once(monkeypatch):
    tracked = []

    def count(tracker, detections, period_s, rng):
        tracked.append(detections)
        return track(tracker, detections, period_s, rng)

    monkeypatch.setattr(experiment, 'track', count)
    tracker = PdaMmpf(sensor=SENSOR, rows=7, cols=5, particles=50)
    never = [chain(replace(small(name), threshold=1e3), name, tracker=tracker)
             for name in ('cdt', 'sdt')]
    some = chain(replace(small('cdt'), threshold=2.0), 'some', tracker=tracker)
    results = run_block(block(*never, some, crowded_runs=3))
    assert len(tracked) == 6
    alone = run_block(block(some, crowded_runs=3))
    for key, values in arrays(alone['it', 'some']).items():
        assert np.array_equal(values, arrays(results['it', 'some'])[key], equal_nan=True)


def test_chain_takes_part_in_its_first_runs_only():
    few, all_of_them = chain(small('cdt'), 'few', runs=2), chain(small('cdt'), 'all')
    results = run_block(block(few, all_of_them))
    assert len(results['it', 'few'].detection) == 2
    assert len(results['it', 'all'].detection) == 3
    assert set(run_block(block(few, all_of_them, first=2))) == {('it', 'all')}


def test_crowded_chain_is_tracked_in_few_runs():
    tracker = PdaMmpf(sensor=SENSOR, particles=20)
    crowd = chain(replace(small('cdt'), threshold=-100.0), tracker=tracker)
    result = run_block(block(crowd))['it', 'nominal']
    assert (len(result.detection), len(result.tracking)) == (3, 1)
    assert len(run_block(block(crowd, first=3))['it', 'nominal'].tracking) == 0


def test_two_objects_at_a_time_are_rejected():
    other = replace(OBJECT, id='other')
    with pytest.raises(ValueError, match='frame 3'):
        run_block(block(scenario=replace(SCENARIO, objects=(OBJECT, other))))


STREAM_RUNS = (4, 9, 2)


def generators():
    return [stream(3, 'detector', run) for run in STREAM_RUNS]


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


def test_size_that_does_not_start_with_the_runs_is_rejected():
    with pytest.raises(ValueError, match='3 runs'):
        RunStreams(generators()).random((2, 4))
