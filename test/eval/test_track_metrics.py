# SPDX-License-Identifier: Apache-2.0
"""Metrics of tracks against brute force over all pairings, and against cases done by hand."""

from itertools import combinations
from itertools import permutations
from itertools import product

from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_eval.scoring.metrics import distances
from lowsnr_eval.scoring.metrics import gospa
from lowsnr_eval.scoring.metrics import gospa_parts
from lowsnr_eval.track_metrics.chain_metrics import ChainMetrics
from lowsnr_eval.track_metrics.identity import FORGET_AFTER_FRAMES
from lowsnr_eval.track_metrics.identity import Identities
from lowsnr_eval.track_metrics.ospa2 import ospa2
from lowsnr_eval.track_metrics.ospa2 import WindowedOspa2
from lowsnr_eval.track_metrics.siap import Siap
import numpy as np
import pytest
from track_frames import frame

CUTOFF, GATE = 5.0, 1.5
AWAY = (np.nan, np.nan)


def line(*places):
    """Return frames of a row of tracks: for each a dict of x by name."""
    return [{name: (x, 0.0) for name, x in each.items()} for each in places]


def added(metric, objects, tracks):
    for k, (one, other) in enumerate(zip(objects, tracks, strict=True)):
        metric.add(frame(k, one, other))
    return metric


def paths(rng, count, frames=4):
    """Return random paths, each in at least one frame."""
    found = rng.uniform(0.0, 8.0, (count, frames, 2))
    absent = rng.random((count, frames)) < 0.3
    absent[np.arange(count), rng.integers(frames, size=count)] = False
    found[absent] = np.nan
    return found


def ospa2_by_hand(objects, tracks, cutoff, order, time_order):
    """Return the definition, with loops and all permutations."""
    few, many = sorted((objects, tracks), key=len)
    if len(many) == 0:
        return 0.0

    def apart(one, other):
        terms = []
        for here, there in zip(one, other):
            known = [not np.isnan(here[0]), not np.isnan(there[0])]
            if all(known):
                terms.append(min(np.hypot(*(here - there)), cutoff))
            elif any(known):
                terms.append(cutoff)
        return np.mean(np.power(terms, time_order)) ** (1.0 / time_order)

    best = min(sum(apart(one, many[n]) ** order for one, n in zip(few, chosen))
               for chosen in permutations(range(len(many)), len(few)))
    missing = cutoff**order * (len(many) - len(few))
    return ((best + missing) / len(many)) ** (1.0 / order)


@pytest.mark.parametrize(('order', 'time_order'), [(1.0, 1.0), (2.0, 1.0), (1.0, 2.0)])
def test_ospa2_is_its_definition(rng, order, time_order):
    for n, m in product(range(4), repeat=2):
        one, other = paths(rng, n), paths(rng, m)
        assert ospa2(one, other, CUTOFF, order, time_order) == pytest.approx(
            ospa2_by_hand(one, other, CUTOFF, order, time_order), abs=1e-12)


def test_ospa2_is_a_metric(rng):
    for _ in range(50):
        one, two, three = (paths(rng, rng.integers(4)) for _ in range(3))
        assert ospa2(one, one, CUTOFF) == 0.0
        assert ospa2(one, two, CUTOFF) == pytest.approx(ospa2(two, one, CUTOFF))
        assert ospa2(one, three, CUTOFF) <= (
            ospa2(one, two, CUTOFF) + ospa2(two, three, CUTOFF) + 1e-9)


def test_windows_are_those_that_end_in_each_frame(rng):
    places = {'o': paths(rng, 2, 12), 't': paths(rng, 3, 12)}
    metric, found = WindowedOspa2(CUTOFF, window=4), []
    for k in range(12):
        now = [{f'{kind}{n}': path[k] for n, path in enumerate(some) if not np.isnan(path[k, 0])}
               for kind, some in places.items()]
        found.append(metric.add(frame(k, *now)))
    expected = []
    for k in range(12):
        window = [some[:, max(0, k - 3):k + 1] for some in places.values()]
        window = [some[~np.isnan(some[..., 0]).all(axis=1)] for some in window]
        expected.append(ospa2_by_hand(*window, CUTOFF, 1.0, 1.0))
    assert found == pytest.approx(expected)
    assert metric.value == pytest.approx(np.mean(expected))


def test_track_that_changes_its_object_costs_ospa2_and_not_gospa():
    objects = line(*[{'a': 0.0, 'b': 9.0}] * 10)
    kept = line(*[{'1': 0.0, '2': 9.0}] * 10)
    swapped = kept[:5] + line(*[{'2': 0.0, '1': 9.0}] * 5)
    for tracks, expected in ((kept, 0.0), (swapped, CUTOFF / 2)):
        metric = WindowedOspa2(CUTOFF)
        last = [metric.add(frame(k, *each)) for k, each in enumerate(zip(objects, tracks))][-1]
        assert last == pytest.approx(expected)
        assert all(gospa(frame(0, *each).distance, CUTOFF) == 0.0
                   for each in zip(objects, tracks))


def test_track_without_a_place_does_not_exist():
    metric = WindowedOspa2(CUTOFF)
    assert metric.add(frame(0, {'a': AWAY}, {'1': AWAY})) == 0.0
    assert metric.add(frame(1, {'a': (0.0, 0.0)}, {'1': AWAY})) == CUTOFF


def test_gospa_parts_are_those_of_the_best_pairing(rng):
    for n, m in product(range(4), repeat=2):
        distance = distances(rng.uniform(0, 9, (n, 2)), rng.uniform(0, 9, (m, 2)))
        pairings = [[*zip(rows, columns)] for size in range(min(n, m) + 1)
                    for rows in combinations(range(n), size)
                    for columns in permutations(range(m), size)]
        unit = CUTOFF**2 / 2
        local, missed, false = min((
            (sum(distance[pair] ** 2 for pair in pairs), unit * (n - len(pairs)),
             unit * (m - len(pairs))) for pairs in pairings), key=sum)
        assert gospa_parts(distance, CUTOFF) == pytest.approx((local, missed, false))
        assert sum(gospa_parts(distance, CUTOFF)) == pytest.approx(gospa(distance, CUTOFF) ** 2)


def test_siap_of_a_case_done_by_hand():
    # a has track 1, then 1 and 2, then 2, then none, then 2 again; b has none; 3 is false.
    objects = line(*[{'a': 0.0, 'b': 40.0}] * 5, {'b': 40.0})
    tracks = line({'1': 0.5}, {'1': 0.5, '2': 1.0}, {'2': 1.0}, {'3': 20.0}, {'2': 0.0}, {})
    found = added(Siap(GATE), objects, tracks).figures()
    assert found == pytest.approx({
        'completeness': 4 / 11, 'ambiguity': 5 / 4, 'spuriousness': 1 / 6,
        'position_error_m': (0.5 + 0.5 + 1.0 + 1.0) / 5,
        'track_number_changes_per_s': 2 / 2.0,  # 1 to 2, and 2 again; two steps have one track
        'longest_segment': (1.0 + 0.0) / (4.0 + 5.0)})
    assert set(Siap(GATE).figures().values()) == {None}


def least_segments(assigned):
    """Return the least number of segments of one track that cover the frames with a track."""
    best = {0: 0}  # by the number of frames covered
    for start in range(len(assigned)):
        if not assigned[start]:
            best[start + 1] = best[start]
            continue
        for track in assigned[start]:
            stop = start
            while stop < len(assigned) and track in assigned[stop]:
                stop += 1
                best[stop] = min(best.get(stop, 99), best[start] + 1)
    return best[len(assigned)]


def test_track_number_changes_are_the_fewest_that_cover_the_object(rng):
    names = ('1', '2', '3')
    for _ in range(40):
        here = rng.random((12, 3)) < 0.6
        assigned = [[name for name, has in zip(names, row) if has] for row in here]
        tracks = [dict.fromkeys(each, (0.5, 0.0)) for each in assigned]
        siap = added(Siap(GATE), line(*[{'a': 0.0}] * 12), tracks).figures()
        tracked = sum(bool({*one} & {*two}) for one, two in zip(assigned, assigned[1:]))
        if tracked:
            assert siap['track_number_changes_per_s'] == pytest.approx(
                max(least_segments(assigned) - 1, 0) / tracked)


@pytest.mark.parametrize(('tracks', 'switches', 'swaps', 'purity'), [
    # Both pass each other within the gate, and keep their tracks.
    ([{'1': 0.0, '2': 4.0}, {'1': 1.9, '2': 2.1}, {'1': 4.0, '2': 0.0}], 0, 0, 1.0),
    # They exchange their tracks.
    ([{'1': 0.0, '2': 4.0}, {'1': 1.9, '2': 2.1}, {'1': 0.0, '2': 4.0}], 2, 2, 4 / 6),
    # a gets a new track: nobody swaps.
    ([{'1': 0.0, '2': 4.0}, {'2': 2.1}, {'3': 4.0, '2': 0.0}], 1, 0, 1.0),
])
def test_identities_of_two_objects_that_pass(tracks, switches, swaps, purity):
    objects = line({'a': 0.0, 'b': 4.0}, {'a': 2.1, 'b': 1.9}, {'a': 4.0, 'b': 0.0})
    found = added(Identities(GATE), objects, line(*tracks)).figures()
    assert found == pytest.approx({
        'identity_switches': switches, 'identity_swaps': swaps, 'track_purity': purity})


def test_identity_is_known_over_a_gap():
    objects = line(*[{'a': 0.0}] * 4)
    found = added(Identities(GATE), objects, line({'1': 0.0}, {}, {}, {'1': 0.0})).figures()
    assert (found['identity_switches'], found['identity_swaps']) == (0, 0)
    found = added(Identities(GATE), objects, line({'1': 0.0}, {}, {}, {'2': 0.0})).figures()
    assert (found['identity_switches'], found['identity_swaps']) == (1, 0)


def test_object_that_comes_again_under_its_name_is_another_one():
    """Nobody could have followed it while it was away."""
    times = [0, 1, 2, 3, 10, 11, 12, 13]
    objects = line(*[{'a': 0.0} if k % 4 else {} for k in range(1, 8)] + [{}])
    tracks = line(*[{'1': 0.0}] * 3, {}, *[{'2': 0.0}] * 3, {})
    siap, identities = Siap(GATE), Identities(GATE)
    for metric in (siap, identities):
        for k, each in zip(times, zip(objects, tracks, strict=True), strict=True):
            metric.add(frame(k, *each))
    found = siap.figures()
    assert (found['longest_segment'], found['track_number_changes_per_s']) == (1.0, 0.0)
    assert identities.figures() == {
        'identity_switches': 0, 'identity_swaps': 0, 'track_purity': 1.0}


def test_memory_does_not_grow_with_the_run():
    metrics = ChainMetrics(Evaluation())
    for k in range(6 * FORGET_AFTER_FRAMES):
        here = (float(k % 7), 0.0)
        metrics.add(frame(k, {f'o{k // 3}': here}, {f't{k // 3}': here, f'f{k}': (30.0, 0.0)}))
    found = metrics.figures()
    assert found['track_purity'] == 1.0
    assert found['siap']['spuriousness'] == pytest.approx(0.5)
    assert found['siap']['longest_segment'] == 1.0
    assert found['identity_switches'] == 0
    held = [metrics._identities._track_of, metrics._identities._objects_of,
            metrics._identities._object_of, metrics._siap._objects]
    assert max(map(len, held)) <= FORGET_AFTER_FRAMES
