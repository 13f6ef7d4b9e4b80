# SPDX-License-Identifier: Apache-2.0
"""Colours of marks and greys of frames, in reports and in viewers."""

from __future__ import annotations

import numpy as np

# Colours of Okabe and Ito: colour-blind readers can tell them apart, and they show on grey.
TRUTH, DETECTION, TRACK = '#009E73', '#56B4E9', '#E69F00'
# Colours of identities, apart from those of truth and detections; grey is no identity.
IDENTITIES = (
    '#E69F00', '#CC79A7', '#F0E442', '#D55E00', '#0072B2', '#B07AFF', '#FF7F7F', '#8A8A00',
    '#00C2C2', '#FF4FD8', '#A0522D')
# The 256 greys lie between these quantiles of the cells.
_DARKEST, _BRIGHTEST = 0.01, 0.999
_SAMPLE = 2**16


def rgb(colour: str) -> tuple[int, int, int]:
    """Return a colour ``#RRGGBB`` as three numbers in [0, 255]."""
    red, green, blue = bytes.fromhex(colour[1:])
    return red, green, blue


def grey_range(cells: np.ndarray) -> tuple[float, float]:
    """
    Return the intensities that become black and white.

    A few very bright cells do not make the others black.

    Parameters
    ----------
    cells
        Intensities of any shape, NaN where there is none.

    Returns
    -------
    tuple of float
        The same value twice where all are equal or there is none.

    """
    flat = cells.ravel()
    sample = flat[::1 + flat.size // _SAMPLE]
    known = sample[np.isfinite(sample)]
    if not known.size:
        return 0.0, 0.0
    low, high = np.quantile(known, (_DARKEST, _BRIGHTEST)).tolist()
    return low, high


def to_greys(cells: np.ndarray, limits: tuple[float, float]) -> np.ndarray:
    """
    Return intensities of any shape as greys, uint8, between these limits.

    All cells are black where the limits are equal, and so are those without a value.
    """
    low, high = limits
    scale = 255.0 / (high - low) if high > low else 0.0
    greys = np.clip((cells - low) * scale, 0.0, 255.0)
    return np.nan_to_num(greys, copy=False).astype(np.uint8)


def excess_range(planes: np.ndarray) -> tuple[float, float]:
    """Return the lowest and the highest statistic that are told apart, 0 between them [nat]."""
    known = planes[np.isfinite(planes)]
    if not known.size:
        return -1.0, 1.0
    low, high = np.quantile(known, _DARKEST), known.max()
    return min(float(low), -1.0), max(float(high), 1.0)


def to_levels(excess: np.ndarray, limits: tuple[float, float]) -> np.ndarray:
    """
    Return by how much a statistic exceeds its threshold as levels, uint8.

    1 to 127 are below the threshold, 128 to 255 above it, each half in steps of its own, and 0
    is no statistic.
    """
    low, high = limits
    below = np.clip(127.0 - 126.0 * (excess / low), 1.0, 127.0)
    above = np.clip(128.0 + 127.0 * (excess / high), 128.0, 255.0)
    levels = np.where(excess > 0.0, above, below)
    return np.nan_to_num(levels, copy=False).astype(np.uint8)


def stretch(cells: np.ndarray) -> np.ndarray:
    """Return intensities as greys over their own range, see :func:`grey_range`."""
    return to_greys(cells, grey_range(cells))
