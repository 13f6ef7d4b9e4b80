"""
Settings of motion for another cadence.

The configuration states how objects move for frames one second apart.  Where the frames of a
recording follow each other faster, objects move as much from frame to frame all the same; so
whatever a setting says of a second is taken to be of a frame.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lowsnr_common.settings.config import declared_settings

# The power of the time in the unit of each setting that has one.
POWERS = {
    'turn_rates_deg_s': -1, 'min_speed_mps': -1, 'max_speed_mps': -1,
    'acceleration_density': -3, 'mode_sojourn_s': 1, 'lifetime_s': 1, 'max_gap_s': 1}


def at_cadence(cls: type, values: Mapping[str, Any], period_s: float) -> dict[str, Any]:
    """
    Return the settings of motion for frames that are ``period_s`` apart.

    Parameters
    ----------
    cls
        Settings class.
    values
        Values by full name for frames one second apart; what is missing has its default.
    period_s
        Time from a frame to the next [s].

    Returns
    -------
    dict
        The settings that depend on it, by full name.

    """
    scaled: dict[str, Any] = {}
    for name, item in declared_settings(cls).items():
        power = POWERS.get(name.rpartition('.')[2])
        if power is not None:
            value, factor = values.get(name, item.default), period_s**power
            several = isinstance(value, (list, tuple))
            scaled[name] = tuple(v * factor for v in value) if several else value * factor
    return scaled
