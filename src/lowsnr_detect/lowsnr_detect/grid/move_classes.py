# SPDX-License-Identifier: Apache-2.0
"""
Transitions between cells: the classes are histories of up to two moves of whole cells.

They are those of HMM (:mod:`lowsnr_detect.parts.moves`), without the rare ones: transitions
below 0.4 % are dropped, and so are histories of fewer than one object in a thousand.  The
probabilities that are left are scaled to a sum of one.
"""

from __future__ import annotations

import functools

from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.motion import MotionModes
from lowsnr_detect.grid.transitions import grouped
from lowsnr_detect.grid.transitions import Transitions
from lowsnr_detect.parts.moves import move_model
import numpy as np

_LEAST_PROB, _LEAST_HISTORY = 0.004, 0.001


@functools.lru_cache(maxsize=32)
def move_transitions(motion: MotionModes, sensor: SensorModel, order: int) -> Transitions:
    """Return the transitions of the move model of an order; the class numbers follow from it."""
    model = move_model(motion, sensor, order)
    dropped, kept = model.history.shape
    moves, history = len(model.moves), model.history.ravel()
    probs = model.kernel.transpose(2, 0, 1).reshape(len(history), moves)
    source, move = np.indices(probs.shape)
    # The older of two remembered moves is dropped, the new one is remembered.
    target = (source * 0, move, source % kept * moves + move)[order]
    prob = np.where(probs < _LEAST_PROB, 0.0, probs)
    common = history >= _LEAST_HISTORY
    prob = np.where(common[source] & common[target], prob, 0.0)
    common &= prob.sum(axis=1) > 0.0
    number, used = np.cumsum(common) - 1, prob > 0.0
    used &= common[source] & common[target]
    velocity = model.velocity.reshape(-1, 2)[common]
    return Transitions(
        **grouped(
            number[source[used]], number[target[used]], model.moves[move[used]], prob[used],
            int(common.sum())),
        switch=np.ones((1, 1)), appears=history[common] / history[common].sum(),
        velocity=velocity, velocity_cov=model.velocity_cov.reshape(-1, 2, 2)[common])
