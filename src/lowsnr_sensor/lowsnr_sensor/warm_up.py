"""The compiled loops over particles, made ready before the first frame."""

from __future__ import annotations

from lowsnr_sensor.motion import MotionModes
from lowsnr_sensor.particles import systematic_resample
import numpy as np


def warm_up(motion: MotionModes) -> None:
    """Move and resample a particle, so that no frame waits for what is compiled or loaded."""
    rng = np.random.default_rng(0)
    modes = motion.switch(np.zeros((1, 1), dtype=np.intp), 1.0, rng)
    motion.move(np.zeros((1, 1, 4)), modes, 1.0, rng)
    systematic_resample(np.zeros((1, 1)), 1, rng)
