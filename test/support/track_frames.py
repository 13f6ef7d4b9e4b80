# SPDX-License-Identifier: Apache-2.0
"""Frames of tracks and objects for the tests of the metrics of tracks."""

from lowsnr_eval.track_metrics.track_frame import TrackFrame
import numpy as np


def frame(k, objects, tracks, existence=None):
    """Return a frame of positions by name."""
    places = [np.reshape([*each.values()], (-1, 2)).astype(float) for each in (objects, tracks)]
    stated = np.full(len(tracks), 0.9) if existence is None else np.array(existence, dtype=float)
    return TrackFrame(float(k), [*objects], places[0], [*tracks], places[1], stated)
