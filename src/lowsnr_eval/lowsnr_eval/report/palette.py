"""Colours of marks and greys of frames, in reports and in viewers."""

from __future__ import annotations

import numpy as np

# Colours of Okabe and Ito: colour-blind readers can tell them apart, and they show on grey.
TRUTH, DETECTION, TRACK = '#009E73', '#56B4E9', '#E69F00'
# The 256 greys lie between these quantiles of the cells.
_DARKEST, _BRIGHTEST = 0.01, 0.999
_SAMPLE = 2**16


def rgb(colour: str) -> tuple[int, int, int]:
    """Return a colour ``#RRGGBB`` as three numbers in [0, 255]."""
    red, green, blue = bytes.fromhex(colour[1:])
    return red, green, blue


def stretch(cells: np.ndarray) -> np.ndarray:
    """
    Return intensities as greys.

    A few very bright cells do not make the others black; cells that are all equal are black, and
    so are those without a value.

    Parameters
    ----------
    cells
        Intensities of any shape, NaN where there is none.

    Returns
    -------
    ndarray of uint8
        Greys of the same shape.

    """
    flat = cells.ravel()
    sample = flat[::1 + flat.size // _SAMPLE]
    known = sample[np.isfinite(sample)]
    low, high = np.quantile(known, (_DARKEST, _BRIGHTEST)) if known.size else (0.0, 0.0)
    scale = 255.0 / (high - low) if high > low else 0.0
    greys = np.clip((cells - low) * scale, 0.0, 255.0)
    return np.nan_to_num(greys, copy=False).astype(np.uint8)
