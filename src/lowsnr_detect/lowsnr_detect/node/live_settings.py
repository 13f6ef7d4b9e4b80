# SPDX-License-Identifier: Apache-2.0
"""Which settings of a detector have an effect while its node runs."""

from __future__ import annotations

from collections.abc import Iterable

from lowsnr_common.settings.node_settings import DetectionSettings
from lowsnr_detect.parts.detector import Detector

# The operating points at which a setting acts, where these are not all.
_ACTS_AT = {
    'threshold': ('manual',), 'upper_threshold': ('manual', 'matched'),
    'false_alarm_prob': ('matched', 'adaptive')}


def acts(name: str, operating: DetectionSettings) -> bool:
    """Return whether a setting acts at an operating point."""
    point = operating.operating_point
    return point in _ACTS_AT.get(name, (point,))


def check_effect(names: Iterable[str], settings: tuple[Detector, DetectionSettings]) -> None:
    """
    Check that a change of settings has an effect, and none beyond its own.

    Parameters
    ----------
    names
        Settings that are to be changed.
    settings
        Detector and operating point with these changes.

    Raises
    ------
    ValueError
        For the first setting without effect at the operating point, and for a design SNR, with
        which the memory starts empty, where frames are counted from the start.

    """
    detector, operating = settings
    for name in names:
        if not acts(name, operating):
            raise ValueError(
                f'{name} does nothing while operating_point is {operating.operating_point!r}; set '
                f'operating_point to {" or ".join(map(repr, _ACTS_AT[name]))} first, or in the '
                'same call')
        bound = next((group for group in ('destination', 'destinations') if getattr(
            getattr(detector, group, None), 'probability', None)), '')
        if name == 'sensor.snr_db' and bound:
            raise ValueError(
                f'sensor.snr_db is read-only where {bound}.probability is set: the frame of the '
                'arrival is counted from the first frame')
