"""The simulated sensor: frames of objects and noise, eqs. (2) and (3)."""

from __future__ import annotations

from collections.abc import Sequence

from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.records import Truth
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
    frame = sensor.noise_std * rng.standard_normal(shape)
    for item in objects:
        scale = 10.0 ** (item.snr_offset_db / 20.0)
        frame += scale * sensor.signal(item.state, shape)
    return frame.astype(np.float32)


def simulate_frames(
    truth: Sequence[Sequence[Truth]], sensor: SensorModel, shape: tuple[int, int],
    rng: np.random.Generator,
) -> np.ndarray:
    """Return the (K, rows, cols) float32 frames of a run, equal to those made one by one."""
    return np.stack([simulate_frame(objects, sensor, shape, rng) for objects in truth])
