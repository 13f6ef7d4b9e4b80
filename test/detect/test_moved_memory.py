# SPDX-License-Identifier: Apache-2.0
"""When the cells move over the scene, the memory of a detector stays where the scene is."""

from dataclasses import replace

from lowsnr_common.core.bound_motion import Destinations
from lowsnr_common.core.destination import Destination
from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.motion import MotionModes
from lowsnr_common.settings.node_settings import DetectionSettings
from lowsnr_detect.adaptive.adaptive_detector import AdaptiveDetector
from lowsnr_detect.detectors.sdt import SDT
from lowsnr_detect.node.live_detector import LiveDetector
from lowsnr_detect.parts.cell_detector import CellDetector
from lowsnr_detect.parts.existence import Existence
from lowsnr_detect.parts.moved_memory import moved_memory
from lowsnr_detect.parts.registry import detector_class
from lowsnr_detect.parts.registry import DETECTORS
import numpy as np
import pytest

SENSOR = SensorModel(snr_db=8.0)
SCENE, SHAPE, CORNER, BY = (60, 74), (40, 46), (8, 12), (4, -8)
detector_class('sdt')  # makes every detector register itself
LOCAL = [name for name, cls in DETECTORS.items() if issubclass(cls, CellDetector)]
# What entered, or what the moves of six frames brought from beyond a border, is not in these.
INNER = np.s_[11:-15, 19:-11]


def windowed(scene, corner, shape=SHAPE):
    """Return the part of a scene that cells of a shape see from a corner."""
    (row, col), (rows, cols) = corner, shape
    return np.ascontiguousarray(scene[row:row + rows, col:col + cols])


@pytest.mark.parametrize('name', LOCAL)
def test_statistic_is_that_of_cells_which_stood_still(name, rng):
    detector = detector_class(name)(sensor=SENSOR)
    wide, memory = detector.init(SCENE), detector.init(SHAPE)
    for number in range(6):
        scene = rng.standard_normal(SCENE)
        corner = CORNER if number < 3 else tuple(np.add(CORNER, BY))
        if number == 3:
            memory = moved_memory(memory, detector.init(SHAPE), SHAPE, BY, 1.0)
        wide, expected = detector.statistic(wide, scene)
        memory, plane = detector.statistic(memory, windowed(scene, corner))
    found, known = plane[INNER], windowed(expected, corner)[INNER]
    assert found.size > 100
    assert np.isfinite(known).any()
    np.testing.assert_allclose(found, known, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize('name', ['bernoulli', 'hmm', 'pmf', 'tbd1', 'mmtbd1', 'tbd2', 'mmtbd2'])
def test_posterior_stays_at_the_object(name, rng):
    kind = detector_class(name)
    few = {'particles': 400} if 'particles' in kind.__dataclass_fields__ else {}
    detector = kind(sensor=replace(SENSOR, snr_db=14.0), threshold=-50.0, **few)
    memory, place = detector.init(SHAPE), np.array([22, 20])
    for number in range(8):
        if number == 5:
            memory = moved_memory(memory, detector.init(SHAPE), SHAPE, BY, 1.0)
            place = place - BY
        frame = np.zeros(SHAPE)
        if number < 7:  # the last frame shows nothing: the memory alone knows the place
            frame[tuple(place)] = detector.sensor.intensity
        memory, declared = detector.step(memory, frame, rng)
    item = declared.estimates()[0]
    assert np.hypot(*(item.state[[2, 0]] - place)) < 2.0


def test_particles_move_by_metres():
    detector = detector_class('mmtbd2')(sensor=replace(SENSOR, cell_size_m=0.5), particles=50)
    memory, _ = detector.step(
        detector.init(SHAPE), np.zeros(SHAPE), np.random.default_rng(0))
    moved = moved_memory(memory, detector.init(SHAPE), SHAPE, BY, 0.5)
    np.testing.assert_allclose(
        moved.states - memory.states, np.broadcast_to([4.0, 0.0, -2.0, 0.0], memory.states.shape))


def test_paths_go_to_the_place_where_the_destination_is_in_the_new_cells(rng):
    to = Destination(probability=0.9, x_m=30.0, y_m=16.0, std_m=1.0, arrival_frame=12)
    before = SDT(sensor=SENSOR, move_prior=True, destination=to)
    after = replace(before, destination=replace(to, x_m=to.x_m - BY[1], y_m=to.y_m - BY[0]))
    moved, stood = before.init(SHAPE), after.init(SHAPE)
    for number in range(8):
        scene, corner = rng.standard_normal(SCENE), tuple(np.add(CORNER, BY))
        if number == 3:
            moved = moved_memory(moved, before.init(SHAPE), SHAPE, BY, 1.0)
        moved, found = before.statistic(
            moved, windowed(scene, CORNER if number < 3 else corner))
        stood, known = after.statistic(stood, windowed(scene, corner))
    assert np.isfinite(known[INNER]).sum() > 100
    np.testing.assert_allclose(found[INNER], known[INNER], rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize('size', [1.0, 0.5])
@pytest.mark.parametrize('name', ['hmm', 'tbd2', 'mmtbd2'])
def test_one_destination_stays_in_the_scene(name, size, rng):
    sensor, place = SensorModel(snr_db=16.0, cell_size_m=size), np.array([22, 20])
    detector = detector_class(name)(
        sensor=sensor, existence=Existence(birth_prob=1e-6, death_prob=1e-6, initial_prob=0.5),
        threshold=-50.0, destination=Destination(
            probability=0.99, x_m=28.0 * size, y_m=14.0 * size, std_m=0.3, arrival_frame=12,
            acceleration_density=0.05 * size**2))
    detector = replace(detector, motion=replace(
        detector.motion, acceleration_density=0.05 * size**2, max_speed_mps=1.5 * size))
    memory = detector.init(SHAPE)
    for number in range(12):
        if number == 5:
            memory = moved_memory(memory, detector.init(SHAPE), SHAPE, BY, size)
        frame = np.full(SHAPE, sensor.intensity / 2.0)  # a likelihood ratio of one
        if number == 0:
            frame[:] = 0.0
            frame[tuple(place)] = 2.0 * sensor.intensity
        memory, declared = detector.step(memory, frame, rng)
    where = declared.estimates()[0].state[[2, 0]] / size
    assert where == pytest.approx(np.subtract((14.0, 28.0), BY), abs=1.5)


def test_births_after_a_move_are_bound_for_the_place_in_the_new_cells(rng):
    detector = detector_class('mmtbd2')(
        sensor=replace(SENSOR, cell_size_m=0.5), particles=100, birth_particles=100,
        existence=Existence(birth_prob=0.5), motion=MotionModes(acceleration_density=0.1),
        destinations=Destinations(
            probability=(1.0,), x_m=(9.0,), y_m=(7.0,), std_m=(0.0,), earliest_frame=(20,),
            latest_frame=(20,)))
    memory = detector.init(SHAPE)
    for number in range(4):
        if number == 2:
            memory = moved_memory(memory, detector.init(SHAPE), SHAPE, BY, 0.5)
        memory, _ = detector.step(memory, np.zeros(SHAPE), rng)
    np.testing.assert_allclose(
        memory.bound.place, np.broadcast_to([13.0, 5.0], memory.bound.place.shape))


def test_adaptive_threshold_keeps_what_it_saw_at_its_place(rng):
    detector = AdaptiveDetector(detector_class('cdt')(sensor=SENSOR), 0.5, SHAPE)
    memory = detector.init(SHAPE)
    for _ in range(12):
        frame = rng.standard_normal(SHAPE)
        frame[20, 18] = frame[37, 2] = 9.0
        memory, _ = detector.step(memory, frame, rng)
    moved = moved_memory(memory, detector.init(SHAPE), SHAPE, BY, 1.0)
    (before,), (after,) = memory.tails, moved.tails
    held = {tuple(place) for place in before.held[1:3].T}
    assert {(20.0, 18.0), (37.0, 2.0)} <= held
    assert {tuple(place) for place in after.held[1:3].T} == {
        (row - 4, col + 8) for row, col in held if row >= 4 and col + 8 < SHAPE[1]}
    assert after.crossed[0, 16, 26]
    assert not after.crossed[0, :, :8].any()
    np.testing.assert_allclose(after.maxima.sum(), before.maxima.sum(), rtol=0.5)


def test_counts_of_a_region_move_by_a_region():
    detector = AdaptiveDetector(detector_class('cdt')(sensor=SENSOR), 0.01, (48, 96))
    (tail,) = detector.init((48, 96)).tails
    counts = np.zeros_like(tail.maxima)
    assert counts.shape[1:3] == (2, 4)
    counts[0, 1, 2, 5] = 7.0
    moved = replace(tail, maxima=counts).moved((24, -24), 1.0)
    assert moved.maxima[0, 0, 3, 5] == pytest.approx(7.0)


def test_memory_starts_empty_in_another_scene(rng):
    settings = detector_class('cusum')(sensor=SENSOR), DetectionSettings(operating_point='nominal')
    live, fresh = (LiveDetector('cusum', settings, SHAPE, print) for _ in range(2))
    live.step(rng.standard_normal(SHAPE) + 2.0, rng)
    assert live.move((SHAPE[0], 0)) == []  # every frame before has its answer
    frame = rng.standard_normal(SHAPE) + 1.0
    (one,), (other,) = (each.step(frame, rng) for each in (live, fresh))
    assert one.score.tobytes() == other.score.tobytes()
