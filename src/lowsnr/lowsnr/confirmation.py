# SPDX-License-Identifier: Apache-2.0
"""
The existence at which tracks are confirmed, from recorded frames without objects.

:mod:`lowsnr_bringup.plan.confirmation` finds it by simulated frames, of which it has as many as
it needs.  Recorded frames hold a few false tracks, so that a tail is fitted to them.

A tracker whose model is right has the odds of existence of a false track exceed ``c`` times what
they were at birth with a probability of at most ``1 / c`` (Ville 1939): their largest logarithm
is exponentially distributed with a mean of one.  Clutter makes that mean larger and false tracks
more frequent.  Both are estimated from the false tracks of the frames, and the threshold is where
the tail has the rate that was asked.  For rates above that of the tail, tracks are counted.
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import replace
from typing import Any

from lowsnr.chain import LOG
from lowsnr.chain import TrackerRun
from lowsnr.plan import Chain
from lowsnr.plan import plain
from lowsnr.sequence import detected
from lowsnr.sequence import shown_progress
from lowsnr.sequence import started
from lowsnr_common.core.streams import stream
from lowsnr_common.settings.declare import declared_settings
from lowsnr_track.track_management import TrackLife
from lowsnr_track.tracks import MAX_EXISTENCE
import numpy as np
from scipy.special import expit
from scipy.special import logit

# The tail begins at these log odds, an existence of .12.
TAIL = -2.0
# What is known of the mean excess before the first track: that of one track in clutter.
_PRIOR_TRACKS, _PRIOR_MEAN = 1.0, 1.5
# A largest existence that is less probable is reported.  Clutter has a smaller mean excess: in
# Student t noise of 4 degrees of freedom it is about 2.
_IMPROBABLE, _LARGEST_MEAN = 1e-3, 3.0
_DRAWS = 2_000
# Log odds that every track reaches.
_LEAST = -100.0


@dataclass(frozen=True)
class RecordedConfirmation:
    """
    The existence probability of confirmation for a rate of false tracks, with its evidence.

    Parameters
    ----------
    probability, low, high
        Existence probability of confirmation, and its 95 % interval.
    asked, measured
        False tracks a frame: asked, and those of the frames that reach ``probability``.
    tracks, frames
        Number of false tracks that the tail was fitted to, and of the frames without objects, but
        for those in which the conditioner learns the background.
    arguments
        Arguments of :func:`lowsnr.track`, with all settings: ``lowsnr.track(frames,
        **found.arguments)`` confirms so.

    """

    probability: float
    low: float
    high: float
    asked: float
    measured: float
    tracks: int
    frames: int
    arguments: dict[str, Any]

    def __str__(self) -> str:
        """Return what was asked and found, as a sentence."""
        return (
            f'confirm_probability {self.probability:.4g} (95 %: {self.low:.4g} to '
            f'{self.high:.4g}) for {self.asked:g} false tracks a frame; measured '
            f'{self.measured:.3g} in {self.frames} frames without objects (tail of '
            f'{self.tracks} tracks)')


@dataclass(frozen=True)
class FalseTrackTail:
    """
    The tail of the largest log odds of existence of false tracks, exponential above ``TAIL``.

    Every rate of them is as likely as any other before the frames, so that n tracks in K frames
    have an expected rate of (n + 1) / K.

    Parameters
    ----------
    frames, tracks, excess
        Number of frames, of tracks in the tail, and the sum of what they exceed ``TAIL`` by.
    below : (n,) ndarray
        Largest log odds of the other tracks, falling.

    """

    frames: int
    tracks: int
    excess: float
    below: np.ndarray

    @classmethod
    def of(cls, largest: np.ndarray, frames: int) -> FalseTrackTail:
        """Return the tail of tracks with these largest existences, (n,)."""
        log_odds = logit(largest)
        excess = log_odds[log_odds > TAIL] - TAIL
        below = -np.sort(-log_odds[log_odds <= TAIL])
        return cls(frames, len(excess), float(excess.sum()), below)

    def log_odds(self, asked: float) -> float:
        """Return the log odds of existence that ``asked`` false tracks a frame reach."""
        mean = (self.excess + _PRIOR_TRACKS * _PRIOR_MEAN) / (self.tracks + _PRIOR_TRACKS)
        return float(self._reached(np.array((self.tracks + 1.0) / self.frames), mean, asked))

    def interval(self, asked: float, rng: np.random.Generator) -> tuple[float, float]:
        """Return the 95 % interval of :meth:`log_odds`, by draws of mean and rate."""
        rate = rng.gamma(self.tracks + 1.0, 1.0 / self.frames, _DRAWS)
        mean = (self.excess + _PRIOR_TRACKS * _PRIOR_MEAN) / rng.gamma(
            self.tracks + _PRIOR_TRACKS, size=_DRAWS)
        low, high = np.quantile(
            self._reached(rate, mean, asked), [0.025, 0.975], method='nearest')
        return float(low), float(high)

    def improbable(self, largest: np.ndarray) -> bool:
        """Return whether a track exists more surely than the tail of the others allows."""
        excess = logit(largest[largest > expit(TAIL)]) - TAIL
        if not len(excess):
            return False
        mean = min(float(np.median(excess)) / np.log(2.0), _LARGEST_MEAN)
        return bool(len(excess) * np.exp(-excess.max() / mean) < _IMPROBABLE)

    def _reached(
        self, rate: np.ndarray, mean: np.ndarray | float, asked: float,
    ) -> np.ndarray:
        """Return the log odds that ``asked`` tracks a frame reach, by rate and mean of a tail."""
        ranked = np.append(self.below, _LEAST)
        more = np.clip((asked - rate) * self.frames, 0, len(self.below)).astype(int)
        return np.where(rate > asked, TAIL + mean * np.log(rate / asked), ranked[more])


def confirm_by_frames(
    frames: np.ndarray, chain: Chain, false_tracks: float, shown: bool,
) -> RecordedConfirmation:
    """
    Return when a tracker confirms for a rate of false tracks a frame.

    Parameters
    ----------
    frames : (K, rows, cols) ndarray
        Frames without objects.
    chain
        The chain that processes them, and that is to process frames with objects.
    false_tracks
        False tracks a frame.
    shown
        Whether progress is shown.

    Raises
    ------
    ValueError
        If the rate is not in (0, 1), or is asked for in the settings as well.

    """
    asked = replace(
        declared_settings(TrackLife)['false_tracks'], ge=None, gt=0.0).check(plain(false_tracks))
    if chain.tracker.life.false_tracks:
        raise ValueError(
            'settings: tracker.life.false_tracks simulates white noise; the argument '
            'false_tracks takes its place: leave it out')
    largest = _largest_existences(frames, chain, shown)
    count = len(frames) - (chain.conditioner.warm_up_frames if chain.conditioner else 0)
    tail = FalseTrackTail.of(largest, count)
    odds = [tail.log_odds(asked), *tail.interval(asked, stream(chain.seed, 'calibration'))]
    at, low, high = np.clip(
        expit(odds), chain.tracker.life.delete_probability, MAX_EXISTENCE).tolist()
    if tail.improbable(largest):
        LOG.warning(
            'confirm: a track in these frames has an existence of %.6g, far more than the others: '
            'leave out frames with objects', largest.max())
    return RecordedConfirmation(
        at, low, high, asked, float(np.sum(largest >= at)) / count, tail.tracks, count,
        _arguments(chain, at))


def _arguments(chain: Chain, at: float) -> dict[str, Any]:
    """Return the arguments of a call that confirms at an existence, and releases no later."""
    life = chain.tracker.life
    return {
        'detector': chain.name, 'condition': 'off' if chain.conditioner is None else 'on',
        'seed': chain.seed, 'settings': chain.settings() | {
            'tracker.life.confirm_probability': at,
            'tracker.life.release_probability': min(at, life.release_probability)}}


def _largest_existences(frames: np.ndarray, chain: Chain, shown: bool) -> np.ndarray:
    """Return the largest existence of every track, (n,)."""
    every = chain.tracker.life.delete_probability
    tracker = TrackerRun(replace(chain, tracker=replace(chain.tracker, life=replace(
        chain.tracker.life, confirm_probability=every, release_probability=every))))
    detector, largest = started(chain, shown), dict[str, float]()
    with shown_progress('tracking', len(frames), 'frames', shown) as advance:
        for (k, where), found in detected(chain, detector, frames, {}, advance):
            for item in tracker.step(found, where, k * chain.period_s):
                largest[item.id] = max(item.score, largest.get(item.id, 0.0))
    return np.array(list(largest.values()), dtype=float)
