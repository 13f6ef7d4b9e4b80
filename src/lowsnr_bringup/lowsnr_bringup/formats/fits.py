"""Images of FITS files."""

from __future__ import annotations

from pathlib import Path
import warnings

from lowsnr_bringup.bags.errors import UNREADABLE
from lowsnr_bringup.bags.errors import UnusableFile
from lowsnr_bringup.formats.bounds import check_frame_size
from lowsnr_common.settings.text import one_line
import numpy as np
from numpy.typing import NDArray

_MAGIC = b'SIMPLE'


def read_fits(path: Path) -> NDArray[np.generic]:
    """Return the first image of a FITS file, in its first or second unit."""
    from astropy.io import fits  # slow to import, and rarely needed
    try:
        with path.open('rb') as file:
            if file.read(len(_MAGIC)) != _MAGIC:  # astropy unpacks archives in memory
                raise UnusableFile(path, 'unreadable', f'does not begin with {_MAGIC!r}')
        # A compressed image with a false header can make astropy write beyond its memory.
        with warnings.catch_warnings(action='ignore'), fits.open(
                path, memmap=False, disable_image_compression=True) as units:
            unit = units[0] if units[0].header.get('NAXIS') else units[1]
            if not isinstance(unit, fits.PrimaryHDU | fits.ImageHDU):
                raise UnusableFile(
                    path, 'not frames', 'holds a table or a compressed image; unpack it (funpack)')
            check_frame_size(path, unit.shape)
            return np.asarray(unit.data)
    except UnusableFile:
        raise
    except (*UNREADABLE, fits.VerifyError) as error:
        raise UnusableFile(path, 'unreadable', f'not a FITS image: {one_line(error)}') from None
