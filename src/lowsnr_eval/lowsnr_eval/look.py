"""How frames, and what is said of them, look in reports and in viewers."""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field

from lowsnr_sensor.config import check_settings
from lowsnr_sensor.config import setting
from lowsnr_sensor.measurement import SensorModel
import numpy as np

# Colours of Okabe and Ito, told apart by colour-blind readers too, and legible on grey.
TRUTH, DETECTION, TRACK = '#009E73', '#56B4E9', '#E69F00'
# Frames are shown in 256 greys between these quantiles of their cells.
_DARKEST, _BRIGHTEST = 0.01, 0.999
_SAMPLE = 2**16


@dataclass(frozen=True, kw_only=True)
class ViewSettings:
    """What viewers are shown."""

    sensor: SensorModel = field(default_factory=SensorModel)
    side: int = setting(
        480, 'least length of the longer side of an overlay [pixels]', ge=1, le=4096)
    trail_frames: int = setting(
        40, 'frames over which the past of a track is shown', ge=1, le=1000)
    ellipse_sigmas: float = setting(
        2.0, 'half axes of the ellipse of a track, in standard deviations', gt=0.0, le=10.0)

    def __post_init__(self) -> None:
        check_settings(self)


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
