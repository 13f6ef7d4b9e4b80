# SPDX-License-Identifier: Apache-2.0
"""A camera's frames: a sky with a slope and stars, noise, and an object that crosses it."""

from lowsnr_sensor.conditioning.conditioner import ConditioningSettings
import numpy as np

NOISE, PSF = 20.0, 0.9
DEFAULT = ConditioningSettings()


def conditioned(frames, settings=DEFAULT):
    """Return the outputs of a sequence of frames."""
    state, outputs = settings.init(np.shape(frames[0])), []
    for frame in frames:
        state, output = settings.step(state, frame)
        outputs.append(output)
    return outputs


def cells_of(frames, settings=DEFAULT):
    """Return the cells of a sequence of frames."""
    return np.array([output.cells for output in conditioned(frames, settings)])


def camera_scene(amplitude=4.0, shifts=None, frames=60, rows=64, cols=80, seed=1):
    """
    Return frames (T, rows, cols) and the places x, y of the object in them.

    ``shifts`` (T, 2) are the x, y by which the content of each frame is moved; ``amplitude`` is
    the peak of the object in standard deviations of the noise.
    """
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:rows, :cols].astype(float)
    stars = rng.uniform((-40, -40, 5), (cols + 40, rows + 40, 60), (30, 3))
    shifts = np.zeros((frames, 2)) if shifts is None else shifts
    out, truth = np.empty((frames, rows, cols)), np.empty((frames, 2))
    for k, (right, down) in enumerate(shifts):
        out[k] = 1000.0 + 0.5 * (x - right) + 0.3 * (y - down)
        truth[k] = 6.0 + k + right, 10.0 + 0.6 * k + down
        for place_x, place_y, peak in [*stars, (6.0 + k, 10.0 + 0.6 * k, amplitude)]:
            out[k] += peak * NOISE * np.exp(
                -((x - place_x - right)**2 + (y - place_y - down)**2) / (2.0 * PSF**2))
        out[k] += NOISE * rng.standard_normal((rows, cols))
    return out, truth


def at_object(outputs, truth):
    """Return the largest cell within one of the object's, for each frame; in binned cells."""
    seen = []
    for output, place in zip(outputs, truth):
        col, row = np.rint(
            (place - output.to_image - 0.5) / 2.0 - output.origin[::-1]).astype(int)
        part = output.cells[max(row - 1, 0):row + 2, max(col - 1, 0):col + 2]
        seen.append(part.max(initial=0.0))
    return np.array(seen)
