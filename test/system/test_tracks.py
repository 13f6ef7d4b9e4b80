# SPDX-License-Identifier: Apache-2.0
"""Several objects in one scenario are followed on the real graph, each by one track."""

import math

import pytest

GATE = 1.5


def followers(received):
    """Return, for every object, the ids of the tracks nearest to it in each frame."""
    found = {}
    for truth, tracks in zip(received['ground_truth'], received['tracks']):
        for item in truth.detections:
            near = [(distance(item, track), track.id) for track in tracks.detections]
            near = [pair for pair in near if pair[0] <= GATE]
            found.setdefault(item.id, []).append(min(near)[1] if near else None)
    return found


def distance(one, other):
    """Return the distance of two entries in cells."""
    a, b = one.bbox.center.position, other.bbox.center.position
    return math.hypot(a.x - b.x, a.y - b.y)


@pytest.mark.parametrize(('scenario', 'objects'), [('three_objects', 3), ('crossing', 2)])
def test_each_object_has_one_track_of_its_own(published, scenario, objects):
    found = followers(published(scenario))
    assert len(found) == objects
    for ids in found.values():
        assert ids.count(None) <= 8  # until the track is confirmed
    # One id each: where two objects meet in a cell the nearest track may be the other's.
    owners = {name: max(set(ids) - {None}, key=ids.count) for name, ids in found.items()}
    assert len(set(owners.values())) == objects
    for name, ids in found.items():
        strange = [k for k, one in enumerate(ids) if one not in (None, owners[name])]
        assert len(strange) <= (3 if scenario == 'crossing' else 0), (name, ids)
        assert ids[-1] == owners[name]
