"""The registered detectors, by name; a detector registers itself where it is defined."""

from __future__ import annotations

from collections.abc import Callable
import difflib
from typing import TypeVar

C = TypeVar('C', bound=type)
DETECTORS: dict[str, type] = {}


def register(name: str) -> Callable[[C], C]:
    """Register a detector class under a name."""
    def keep(cls: C) -> C:
        if name in DETECTORS:
            raise ValueError(f'detector {name!r} is registered twice')
        DETECTORS[name] = cls
        return cls
    return keep


def detector_class(name: str) -> type:
    """
    Return the detector class of a name.

    Raises
    ------
    ValueError
        If there is none; names those that there are.

    """
    import lowsnr_detect.detectors  # noqa: F401  (its files register themselves)
    if name not in DETECTORS:
        near = difflib.get_close_matches(name, DETECTORS, n=1)
        hint = f'; did you mean {near[0]}?' if near else ''
        raise ValueError(
            f'detector {name!r} is not one of {", ".join(sorted(DETECTORS))}{hint}')
    return DETECTORS[name]
