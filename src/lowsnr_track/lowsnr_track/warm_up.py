"""The tracker's compiled loops, made ready before the first frame."""

from __future__ import annotations

from dataclasses import replace

from lowsnr_common.core.records import Estimate
from lowsnr_track.pda_mmpf import PdaMmpf
import numpy as np

_STEP_S = 1e-3


def warm_up(tracker: PdaMmpf) -> None:
    """Follow a detection with few particles, so that no frame waits for what is compiled."""
    few = replace(
        tracker, particles=10, resample_below=1.0, life=replace(tracker.life, birth_density=1.0))
    found = [Estimate(np.zeros(4), np.eye(4), 0.5)]
    state, rng = few.init(), np.random.default_rng(0)
    for frame in range(3):
        state, _ = few.step(state, found, frame * _STEP_S, rng)
