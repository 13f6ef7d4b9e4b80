# SPDX-License-Identifier: Apache-2.0
"""The simulated sensor: frames of objects and noise, eqs. (2) and (3), in any model of noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.records import Truth
from lowsnr_common.noise.intensity import draw_offsets_db
import numpy as np


def simulate_frame(
    objects: Sequence[Truth], sensor: SensorModel, shape: tuple[int, int],
    rng: np.random.Generator,
) -> np.ndarray:
    """
    Return one frame Z_k with the given objects.

    Parameters
    ----------
    objects
        Objects present; the SNR of each is that of the sensor plus its offset.
    sensor
        Noise, blur and intensity.
    shape
        Rows and columns.
    rng
        Source of the noise w_k.

    Returns
    -------
    (rows, cols) ndarray of float32
        Cell intensities, in the type of the published image.

    """
    signal = np.zeros(shape)
    for item in objects:
        scale = 10.0 ** (item.snr_offset_db / 20.0)
        signal += scale * sensor.signal(item.state, shape)
    return sensor.noise_model.draw(signal, rng).astype(np.float32)


def simulate_frames(
    truth: Sequence[Sequence[Truth]], sensor: SensorModel, shape: tuple[int, int],
    rng: np.random.Generator,
) -> np.ndarray:
    """Return the (K, rows, cols) float32 frames of a run, equal to those made one by one."""
    return np.stack([simulate_frame(objects, sensor, shape, rng) for objects in truth])


def fluctuating(
    truth: Sequence[Sequence[Truth]], sensor: SensorModel, rng: np.random.Generator,
) -> list[list[Truth]]:
    """Return the objects of a run with the SNR that each has in each frame, as it fluctuates."""
    if sensor.fluctuation == 'constant':
        return [list(present) for present in truth]
    names = dict.fromkeys(item.id for present in truth for item in present)
    offsets = {
        name: draw_offsets_db(sensor.fluctuation, sensor.spread_db, len(truth), rng)
        for name in names}
    return [
        [replace(item, snr_offset_db=item.snr_offset_db + float(offsets[item.id][k]))
         for item in present] for k, present in enumerate(truth)]
