"""How frames, and what is said of them, look in reports and in viewers."""

from __future__ import annotations

import numpy as np

# Colours of Okabe and Ito, told apart by colour-blind readers too, and legible on grey.
TRUTH, DETECTION, TRACK = '#009E73', '#56B4E9', '#E69F00'
# Frames are shown in 256 greys between these quantiles of their cells.
_DARKEST, _BRIGHTEST = 0.01, 0.999
_SAMPLE = 2**16


def rgb(colour: str) -> tuple[int, int, int]:
    """Return a colour ``#RRGGBB`` as three numbers in [0, 255]."""
    red, green, blue = bytes.fromhex(colour[1:])
    return red, green, blue


def stretch(cells: np.ndarray) -> np.ndarray:
    """
    Return intensities as greys.

    A few cells, however bright, do not make the others black; cells that are all equal are.

    Parameters
    ----------
    cells
        Finite intensities, of any shape.

    Returns
    -------
    ndarray of uint8
        Greys of the same shape.

    """
    flat = cells.ravel()
    low, high = np.quantile(flat[::1 + flat.size // _SAMPLE], (_DARKEST, _BRIGHTEST))
    scale = 255.0 / (high - low) if high > low else 0.0
    return np.clip((cells - low) * scale, 0.0, 255.0).astype(np.uint8)
