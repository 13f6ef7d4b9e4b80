"""Small scenes of detections for the tracker."""

from lowsnr_common.core.records import Estimate
import numpy as np

VARIANCE = 0.5


def detection(x, y, score=0.9, variance=VARIANCE):
    cov = np.full((4, 4), np.nan)
    cov[np.ix_([0, 2], [0, 2])] = np.diag([variance, variance])
    return Estimate(np.array([x, np.nan, y, np.nan]), cov, score)


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
