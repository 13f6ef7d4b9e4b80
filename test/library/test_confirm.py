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


def number_of_tracks(frames, settings):
    """Return the number of tracks that are confirmed."""
    return len(set(lowsnr.track(frames, 'cdt', 10, settings=FAST | settings).tracks.id.tolist()))


def test_confirms_as_many_false_tracks_as_were_asked():
    found = lowsnr.confirm(empty(0, 1500), ASKED, 'cdt', 10, settings=FAST)
    assert found.tracks > 30
    assert found.low < found.probability < found.high
    # The threshold errs by its interval, and the counted tracks by their own.
    rates = [ASKED * np.exp(logit(found.probability) - logit(at))
             for at in (found.high, found.low)]
    counted = number_of_tracks(empty(1, 1500), found.settings)
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
    assert number_of_tracks(empty(2), found.settings) == round(found.measured * 400)


def test_tail_has_the_rate_that_was_asked(rng):
    # 4,000 tracks that exceed the tail by 2 in the mean, in 10,000 frames.
    largest = TAIL + rng.exponential(2.0, 4000)
    tail = FalseTrackTail.of(np.append(largest, [-9.0, -5.0]), 10_000)
    assert tail.tracks == 4000
    for asked in (0.1, 0.001):
        exact = TAIL + 2.0 * np.log(0.4 / asked)
        error = np.hypot(2.0, 2.0 * np.log(0.4 / asked)) / np.sqrt(4000)
        assert tail.log_odds(asked) == pytest.approx(exact, abs=4.0 * error)


def test_interval_covers_the_exact_threshold(rng):
    exact, inside = TAIL + 1.25 * np.log(0.05 / 0.001), 0
    for _ in range(400):
        tracks = TAIL + rng.exponential(1.25, rng.poisson(0.05 * 600))
        low, high = FalseTrackTail.of(tracks, 600).interval(0.001, rng)
        inside += low <= exact <= high
    assert 0.92 <= inside / 400 <= 0.99  # 95 % with a standard error of 1.1 %; the prior helps


def test_frames_without_any_track_give_a_threshold():
    found = lowsnr.confirm(np.zeros((30, 14, 14), np.uint8), 0.001, condition='on')
    assert (found.tracks, found.measured, found.frames) == (0, 0.0, 30)
    assert found.low < found.probability < found.high


@pytest.mark.parametrize('rate', [0.0, 1.0, -0.1, float('nan'), '0.1', None])
def test_rates_that_are_none_are_refused(rate):
    with pytest.raises(ValueError, match='false_tracks = ') as error:
        lowsnr.confirm(empty(0, 3), rate, 'cdt', settings=FAST)
    assert '\n' not in str(error.value)


def test_a_rate_in_the_settings_is_refused():
    with pytest.raises(ValueError, match='leave it out'):
        lowsnr.confirm(empty(0, 3), ASKED, 'cdt', settings=FAST | {
            'tracker.life.false_tracks': 0.01})


def test_settings_repeat_a_run_with_them():
    settings = FAST | lowsnr.confirm(empty(3, 100), ASKED, 'cdt', 10, settings=FAST).settings
    first = lowsnr.track(empty(4, 60), 'cdt', 10, settings=settings)
    again = lowsnr.track(empty(4, 60), **first.arguments)
    assert first.tracks.tobytes() == again.tracks.tobytes()
