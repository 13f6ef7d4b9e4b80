# SPDX-License-Identifier: Apache-2.0
"""The registered detectors, by name; a detector registers itself where it is defined."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from lowsnr_common.settings.text import did_you_mean
from lowsnr_detect.parts.detector import Detector

D = TypeVar('D', bound=Detector)
DETECTORS: dict[str, type[Detector]] = {}


def register(name: str) -> Callable[[type[D]], type[D]]:
    """
    Register a detector class under a name.

    Raises
    ------
    ValueError
        If another class has the name.

    """
    def keep(cls: type[D]) -> type[D]:
        if name in DETECTORS:
            raise ValueError(f'detector {name!r} is registered twice')
        DETECTORS[name] = cls
        return cls
    return keep


def detector_class(name: str) -> type[Detector]:
    """
    Return the detector class of a name.

    Raises
    ------
    ValueError
        If no detector has the name; the message lists the names that exist.

    """
    import lowsnr_detect.detectors  # noqa: F401  (its files register themselves)
    if name not in DETECTORS:
        raise ValueError(
            f'detector {name!r} is not one of {", ".join(sorted(DETECTORS))}'
            + did_you_mean(name, DETECTORS))
    return DETECTORS[name]
