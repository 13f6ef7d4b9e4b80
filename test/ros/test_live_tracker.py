# SPDX-License-Identifier: Apache-2.0
"""Parameters set on a running tracker node: they apply at once, and all tracks are kept."""

from lowsnr_track.pda_mmpf import PdaMmpf
from lowsnr_track.tracker_node import TrackerNode
from node_client import live_names
import pytest

LIVE = {
    'detection.probability', 'detection.gate_probability', 'detection.clutter_density',
    'detection.secondary_density', 'detection.repeated', 'life.birth_density',
    'life.confirm_probability', 'life.release_probability', 'life.delete_probability'}


@pytest.fixture
def tracker(started):
    """Return a client of a tracker."""
    return started(TrackerNode, rows=16, cols=24)


def test_live_parameters_are_probabilities_densities_and_thresholds(tracker):
    assert live_names(tracker.node, PdaMmpf) == LIVE


def test_thresholds_in_the_wrong_order_are_rejected(tracker):
    result = tracker.set('life.confirm_probability', 0.2)
    assert not result.successful
    assert 'confirm_probability' in result.reason
    assert tracker.get('life.confirm_probability') == [0.5]
    assert tracker.set_together(
        life__confirm_probability=0.2, life__release_probability=0.1).successful
    assert tracker.node.tracker.life.confirm_probability == 0.2


def test_every_change_keeps_the_tracks(tracker):
    ids = [tracker.follow((4.0 + 0.5 * k, 6.0)) for k in range(8)]
    assert ids[-1] == ['1']
    for name in sorted(LIVE):
        value, = tracker.get(name)
        assert tracker.set(name, value * 0.999).successful, name
        assert tracker.node.tracker != PdaMmpf(rows=16, cols=24)
        assert tracker.follow((4.0 + 0.5 * tracker.stamp_s, 6.0)) == ['1'], name


def test_confirmation_threshold_applies_from_the_next_frame(tracker):
    assert tracker.set('life.confirm_probability', 0.9999999).successful
    ids = [tracker.follow((4.0 + 0.5 * k, 6.0)) for k in range(6)]
    assert not any(ids)
    assert tracker.set('life.confirm_probability', 0.9).successful
    assert tracker.follow((7.0, 6.0)) == ['1']


def test_new_clutter_density_replaces_the_estimate(tracker):
    tracker.follow((4.0, 6.0))
    assert tracker.set('detection.clutter_density', 0.01).successful
    assert tracker.node._tracker_state.clutter_density == 0.01
    tracker.follow((4.5, 6.0))
    assert 0.005 < tracker.node._tracker_state.clutter_density < 0.01
    assert tracker.set('life.birth_density', 1e-4).successful
    assert 0.005 < tracker.node._tracker_state.clutter_density < 0.01
