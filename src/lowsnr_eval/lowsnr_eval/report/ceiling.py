# SPDX-License-Identifier: Apache-2.0
"""What no detector can pass: the P_D of one that knows the path and the first frame."""

from __future__ import annotations

from lowsnr_common.core.measurement import SensorModel
import numpy as np
from scipy.special import ndtr
from scipy.special import ndtri


def has_ceiling(sensor: SensorModel) -> bool:
    """Return whether the closed form holds: Gaussian noise, and one cell of known intensity."""
    return sensor.is_normal and sensor.blur_m == 0.0


def ceiling(sensor: SensorModel, pfa: np.ndarray, frames: int) -> np.ndarray:
    """
    Return the mean P_D, over the frames of an object, of the test that knows its path.

    After n frames the log-likelihood ratio of a known path is Gaussian with a deflection of
    ``d = sqrt(n) I / sigma``, so that ``P_D = Phi(d - Phi^-1(1 - P_FA))``; by the lemma of Neyman
    and Pearson no test of the same frames has a greater one.

    Parameters
    ----------
    sensor
        Sensor for which :func:`has_ceiling` holds.
    pfa
        False-alarm probability in every frame, of any shape.
    frames
        Number of frames with the object.

    """
    deflection = np.sqrt(np.arange(1, frames + 1)) * 10.0 ** (sensor.snr_db / 20.0)
    return np.asarray(ndtr(deflection + ndtri(pfa)[..., None]).mean(axis=-1))
