# SPDX-License-Identifier: Apache-2.0
"""Objects move as much from frame to frame at any frame period."""

import re

from lowsnr_bringup.plan import graph
from lowsnr_common.core.records import Estimate
from lowsnr_common.settings.declare import declared_settings
from lowsnr_common.settings.flat_values import build_settings
from lowsnr_common.settings.flat_values import flat_values
from lowsnr_common.settings.frame_period import at_frame_period
from lowsnr_common.settings.frame_period import at_unit_period
from lowsnr_common.settings.frame_period import TIME_POWERS
from lowsnr_detect.parts.registry import detector_class
from lowsnr_detect.parts.registry import DETECTORS
from lowsnr_track.pda_mmpf import PdaMmpf
import numpy as np
import pytest

PERIOD_S = 0.04
detector_class('sdt')  # makes every detector register itself
# Settings in seconds that are not about motion: the wall clock and the frame period itself.
OTHERS = {'answer_within_s', 'frame_period_s', 'patience_s', 'silence_s'}


def test_every_setting_with_a_second_in_its_unit_is_known():
    timed = set()
    for node in graph.known_nodes():
        for cls in graph.settings_classes(node):
            for name, item in declared_settings(cls).items():
                units = re.findall(r'\[([^\]]*)\]', item.doc)
                if any(unit == 's' or '/s' in unit for unit in units):
                    timed.add(name.rpartition('.')[2])
    assert set(TIME_POWERS) <= timed <= set(TIME_POWERS) | OTHERS


def test_values_and_defaults_are_scaled():
    scaled = at_frame_period(PdaMmpf, {
        'motion.max_speed_mps': 2.0, 'motion.turn_rates_deg_s': [0.0, 10.0]}, 0.5)
    assert scaled['motion.max_speed_mps'] == 4.0
    assert scaled['motion.turn_rates_deg_s'] == (0.0, 20.0)
    assert scaled['motion.acceleration_density'] == 8 * PdaMmpf().motion.acceleration_density
    assert scaled['life.lifetime_s'] == 0.5 * PdaMmpf().life.lifetime_s
    assert 'particles' not in scaled


def test_same_detections_give_the_same_tracks_at_any_frame_period(seed):
    """Velocities differ by the frame period; everything else is equal."""
    answers = []
    for period_s in (1.0, PERIOD_S):
        values = {'sensor.frame_period_s': period_s, 'rows': 30, 'cols': 40, 'particles': 200}
        tracker = build_settings(PdaMmpf, values | at_frame_period(PdaMmpf, values, period_s))
        state, rng = tracker.init(), np.random.default_rng(seed)
        scatter = np.random.default_rng(seed)
        outputs = []
        for k in range(1, 26):
            x, y = np.array([4.0 + 0.6 * k, 20.0 - 0.3 * k]) + scatter.normal(0.0, 0.3, 2)
            detection = Estimate(
                np.array([x, np.nan, y, np.nan]), np.full((4, 4), np.nan), 0.95)
            state, output = tracker.step(state, [detection], k * period_s, rng)
            outputs.append([*output.confirmed, *output.tentative])
        answers.append(outputs)
    found = 0
    for slow, fast in zip(*answers):
        assert [item.id for item in slow] == [item.id for item in fast]
        for one, other in zip(slow, fast):
            per_frame = np.array([1.0, PERIOD_S, 1.0, PERIOD_S])
            assert other.state * per_frame == pytest.approx(one.state, abs=1e-6)
            assert other.score == pytest.approx(one.score, abs=1e-9)
            found += 1
    assert found >= 25


@pytest.mark.parametrize('name', sorted(DETECTORS))
@pytest.mark.parametrize('period_s', [PERIOD_S, 1.0 / 30.0, 7.0])
def test_detector_at_unit_period_is_that_of_the_configuration(name, period_s):
    kind = detector_class(name)
    one = kind()
    values = {'sensor.frame_period_s': period_s}
    other = build_settings(kind, values | at_frame_period(kind, {}, period_s))
    assert at_unit_period(one) is one
    assert flat_values(at_unit_period(other)) == flat_values(one)


@pytest.mark.parametrize('name', ['hmm', 'mmtbd2', 'tbd1', 'cusum'])
def test_detector_decides_the_same_at_unit_period(name, seed):
    """Which is why its calibration does not depend on the period."""
    kind = detector_class(name)
    values = {'sensor.frame_period_s': PERIOD_S} | (
        {'particles': 300} if 'tbd' in name else {})
    fast = build_settings(kind, values | at_frame_period(kind, {}, PERIOD_S))
    peaks = []
    for detector in (fast, at_unit_period(fast)):
        frames, rng = np.random.default_rng(seed), np.random.default_rng(seed)
        state = detector.init((9, 11))
        found = []
        for _ in range(12):
            state, declared = detector.step(state, frames.standard_normal((9, 11)), rng)
            found.append(float(declared.peak))
        peaks.append(found)
    np.testing.assert_allclose(peaks[0], peaks[1], rtol=1e-6, atol=1e-6)
