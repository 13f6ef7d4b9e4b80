# SPDX-License-Identifier: Apache-2.0
"""
Settings of motion and the frame period.

Speeds and times in seconds scale with the period where objects move as much from frame to frame.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any
from typing import TypeVar

from lowsnr_common.settings.declare import declared_settings
from lowsnr_common.settings.flat_values import changed
from lowsnr_common.settings.flat_values import flat_values

T = TypeVar('T')
# The power of the second in the unit of every setting of motion that has one.
TIME_POWERS = {
    'turn_rates_deg_s': -1, 'min_speed_mps': -1, 'max_speed_mps': -1,
    'acceleration_density': -3, 'mode_sojourn_s': 1, 'lifetime_s': 1, 'max_gap_s': 1}
_PERIOD = 'sensor.frame_period_s'


def at_frame_period(cls: type, values: Mapping[str, Any], period_s: float) -> dict[str, Any]:
    """
    Return the settings of motion for frames of another period.

    The configuration states how objects move for frames one second apart.  Recorded objects
    move about as much from frame to frame whatever the period is, so that what a setting states
    for a second is taken for a frame.

    Parameters
    ----------
    cls
        Settings class.
    values
        Values by full name for frames one second apart; a missing one has its default.
    period_s
        Time from a frame to the next [s].

    Returns
    -------
    dict
        The settings that depend on the period, by full name.

    """
    scaled: dict[str, Any] = {}
    for name, item in declared_settings(cls).items():
        power = TIME_POWERS.get(name.rpartition('.')[2])
        if power is not None:
            value, factor = values.get(name, item.default), period_s**power
            several = isinstance(value, (list, tuple))
            scaled[name] = tuple(v * factor for v in value) if several else value * factor
    return scaled


def at_unit_period(settings: T) -> T:
    """
    Return settings for frames one second apart with which objects move as much in a frame.

    Whatever rests on a frame alone, such as a threshold, is the same for both.  Values are rounded
    to nine digits, so that settings that differ by rounding alone become equal.
    """
    values = flat_values(settings)
    period_s = values[_PERIOD]
    if period_s == 1.0:
        return settings
    scaled = at_frame_period(type(settings), values, 1.0 / period_s)
    return changed(settings, {_PERIOD: 1.0} | {
        name: tuple(map(_rounded, value)) if isinstance(value, tuple) else _rounded(value)
        for name, value in scaled.items()})


def _rounded(value: float) -> float:
    return float(f'{value:.9g}')
