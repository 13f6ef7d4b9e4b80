# SPDX-License-Identifier: Apache-2.0
"""Confirmation for a rate of false tracks, by frames without objects."""

import lowsnr
from lowsnr.confirmation import FalseTrackTail
from lowsnr.confirmation import TAIL
import numpy as np
import pytest
from scipy.special import expit
from scipy.special import logit
from scipy.stats import poisson

# A declaration in about one frame of five, so that there are false tracks to count.
FAST = {
    'cdt.operating_point': 'manual', 'cdt.threshold': 1.5, 'tracker.particles': 200,
    'tracker.life.birth_density': 3e-4}
ASKED = 0.02


def empty(seed, frames=400):
    """Return frames of white noise."""
    return np.random.default_rng(seed).standard_normal((frames, 14, 14))


def number_of_tracks(frames, found):
    """Return the number of tracks that are confirmed."""
    return len(set(lowsnr.track(frames, **found.arguments).tracks.id.tolist()))


def test_confirms_as_many_false_tracks_as_were_asked():
    found = lowsnr.confirm(empty(0, 1500), ASKED, 'cdt', 10, settings=FAST)
    assert found.tracks > 30
    assert found.low < found.probability < found.high
    # The threshold errs by its interval, and the counted tracks by their own.
    rates = [ASKED * np.exp(logit(found.probability) - logit(at))
             for at in (found.high, found.low)]
    counted = number_of_tracks(empty(1, 1500), found)
    assert poisson.ppf(1e-3, 1500 * rates[0]) <= counted <= poisson.ppf(0.999, 1500 * rates[1])


def test_counts_each_track_by_its_largest_existence():
    found = lowsnr.confirm(empty(2), ASKED, 'cdt', 10, settings=FAST)
    tracks = lowsnr.track(empty(2), 'cdt', 10, settings=FAST | {
        'tracker.life.confirm_probability': 0.005,
        'tracker.life.release_probability': 0.005}).tracks
    largest = np.array([
        tracks.score[tracks.id == number].max() for number in set(tracks.id.tolist())])
    assert found.tracks == np.sum(largest > expit(TAIL)) > 5
    assert found.measured * 400 == pytest.approx(np.sum(largest >= found.probability))
    # Merging prefers confirmed tracks, so that a track may be another one.
    assert number_of_tracks(empty(2), found) == pytest.approx(found.measured * 400, abs=1)


def test_tail_has_the_rate_that_was_asked(rng):
    # 4,000 tracks that exceed the tail by 2 in the mean, in 10,000 frames.
    largest = TAIL + rng.exponential(2.0, 4000)
    tail = FalseTrackTail.of(expit(np.append(largest, [-9.0, -5.0])), 10_000)
    assert tail.tracks == 4000
    for asked in (0.1, 0.001):
        exact = TAIL + 2.0 * np.log(0.4 / asked)
        error = np.hypot(2.0, 2.0 * np.log(0.4 / asked)) / np.sqrt(4000)
        assert tail.log_odds(asked) == pytest.approx(exact, abs=4.0 * error)


def test_tracks_of_clutter_are_not_improbable(rng):
    for mean in (1.0, 2.0):
        for tracks in (1, 3, 30):
            found = [expit(TAIL + rng.exponential(mean, tracks)) for _ in range(300)]
            reported = np.mean([FalseTrackTail.of(some, 500).improbable(some) for some in found])
            assert reported < 0.05
    # Three objects among eleven false tracks, and one alone.
    assert all(FalseTrackTail.of(some, 60).improbable(some) for some in (
        expit(np.append(TAIL + rng.exponential(1.5, 11), [20.0, 22.0, 25.0])), expit([22.0])))


@pytest.mark.parametrize('mean', [1.0, 2.0, 3.0])
@pytest.mark.parametrize('rate', [0.02, 0.06])
def test_interval_covers_the_exact_threshold(rng, mean, rate):
    exact, inside, above = TAIL + mean * np.log(rate / 0.001), 0, 0
    for _ in range(400):
        tail = FalseTrackTail.of(
            expit(TAIL + rng.exponential(mean, rng.poisson(rate * 500))), 500)
        low, high = tail.interval(0.001, rng)
        inside += low <= exact <= high
        above += tail.log_odds(0.001) > exact
    assert 0.91 <= inside / 400 <= 0.99  # 95 % with a standard error of 1.1 %
    assert 0.3 <= above / 400 <= 0.7  # the threshold is neither too low nor too high


def test_frames_without_any_track_give_a_threshold():
    found = lowsnr.confirm(np.zeros((30, 14, 14), np.uint8), 0.001, condition='on')
    warm_up = found.arguments['settings']['conditioner.warm_up_frames']
    assert (found.tracks, found.measured, found.frames) == (0, 0.0, 30 - warm_up)
    assert found.low < found.probability < found.high


@pytest.mark.parametrize('objects', [1, 3])
def test_objects_in_the_frames_are_reported(caplog, objects):
    frames = empty(5, 60)
    frames[:, [2, 6, 11][:objects], [3, 10, 5][:objects]] += 8.0
    lowsnr.confirm(frames, 0.001, 'cdt', 10, settings=FAST)
    assert sum('frames with objects' in text for text in caplog.messages) == 1
    caplog.clear()
    lowsnr.confirm(empty(5, 60), ASKED, 'cdt', 10, settings=FAST)
    assert not caplog.messages


def test_rate_may_be_a_number_of_numpy():
    rates = (np.float32(0.25), np.float64(0.25), 0.25)
    assert len({lowsnr.confirm(empty(6, 20), rate, 'cdt', 10, settings=FAST).probability
                for rate in rates}) == 1


@pytest.mark.parametrize('rate', [0.0, 1.0, -0.1, float('nan'), '0.1', None])
def test_rates_that_are_none_are_refused(rate):
    with pytest.raises(ValueError, match='false_tracks = ') as error:
        lowsnr.confirm(empty(0, 3), rate, 'cdt', settings=FAST)
    assert '\n' not in str(error.value)


def test_a_rate_in_the_settings_is_refused():
    with pytest.raises(ValueError, match='leave it out'):
        lowsnr.confirm(empty(0, 3), ASKED, 'cdt', settings=FAST | {
            'tracker.life.false_tracks': 0.01})


def test_arguments_are_those_of_the_call_with_the_confirmation_found():
    found = lowsnr.confirm(empty(3, 100), ASKED, 'cdt', 10, settings=FAST, seed=3)
    first = lowsnr.track(empty(4, 60), **found.arguments)
    again = lowsnr.track(empty(4, 60), 'cdt', 10, seed=3, settings=FAST | {
        'tracker.life.confirm_probability': found.probability,
        'tracker.life.release_probability': min(found.probability, 0.3)})
    assert first.tracks.tobytes() == again.tracks.tobytes()
    assert first.settings == again.settings
