"""A detector's compiled loops, made ready before the first frame."""

from __future__ import annotations

from typing import Any

import numpy as np

_SHAPE = (8, 8)
_FRAMES = 3


def rehearse(detector: Any) -> None:
    """
    Run a detector on a few small blank frames, so that no real one waits.

    What is compiled, or loaded, at its first use does not depend on the size of a frame or on
    what is in it, only on whether it holds float32 or float64.
    """
    for kind in (np.float64, np.float32):
        state, rng = detector.init(_SHAPE), np.random.default_rng(0)
        for _ in range(_FRAMES):
            state, _ = detector.step(state, np.zeros(_SHAPE, dtype=kind), rng)
