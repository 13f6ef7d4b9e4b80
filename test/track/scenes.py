# SPDX-License-Identifier: Apache-2.0
"""Small scenes of detections for the tracker."""

from lowsnr_common.core.records import Estimate
import numpy as np

VARIANCE = 0.5


def detection(x, y, score=0.9, variance=VARIANCE):
    cov = np.full((4, 4), np.nan)
    cov[np.ix_([0, 2], [0, 2])] = np.diag([variance, variance])
    return Estimate(np.array([x, np.nan, y, np.nan]), cov, score)


def observed(positions, size, rng, false=0.5, detected=0.9, variance=0.3):
    """
    Return detections of objects at positions (n, 2) and false ones in a frame of size (2,).

    The log odds of scores are exponential with means of 5 and 1.
    """
    size = np.asarray(size)
    seen = np.asarray(positions).reshape(-1, 2)
    seen = seen[rng.random(len(seen)) < detected]
    noise = rng.uniform(-0.5, size - 0.5, (rng.poisson(false), 2))
    found = np.concatenate([seen + np.sqrt(variance) * rng.standard_normal(seen.shape), noise])
    odds = rng.exponential(np.repeat([5.0, 1.0], [len(seen), len(noise)]))
    inside = np.all((found >= -0.5) & (found < size - 0.5), axis=1)
    return [detection(*place, score=1.0 / (1.0 + np.exp(-x)), variance=variance)
            for place, x in zip(found[inside], odds[inside])]


def follow(tracker, frames, rng, first=1):
    """Return the outputs for successive frames of detections, one second apart."""
    state, outputs = tracker.init(), []
    for k, detections in enumerate(frames, start=first):
        state, output = tracker.step(state, detections, float(k), rng)
        outputs.append(output)
    return outputs


def everything(output):
    return output.confirmed + output.tentative


def straight(count, start=(4.0, 3.0), velocity=(0.5, 0.2)):
    return np.array(start) + np.arange(count)[:, None] * velocity
