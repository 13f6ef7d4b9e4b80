# SPDX-License-Identifier: Apache-2.0
"""Times of the tracker: of many objects, and of a particle and frame against a reference."""

import os
from typing import Any

import kernels
from lowsnr_track.pda_mmpf import PdaMmpf
import many_scene
import numpy as np

OBJECTS, SIDE, FALSE, FRAMES, SETTLED = 200, 1024, 50.0, 40, 20
PARTICLES = 10_000
REPEATS = 5


def measure(seed: int) -> dict[str, Any]:
    """
    Time both, in this process.

    Returns
    -------
    dict
        Frames a second of many objects: the median of some repeats, the least and the largest;
        nanoseconds a particle and frame, and their ratio to the reference of ``kernels``, without
        and with births; the load of the host.

    """
    tracker = many_scene.sized(PdaMmpf(), SIDE, PdaMmpf().particles, OBJECTS)
    rates = sorted(
        1.0 / float(np.median(many_scene.measure(
            tracker, OBJECTS, FALSE, FRAMES, SETTLED, seed).seconds)) for _ in range(REPEATS))
    found: dict[str, Any] = {
        'particles': tracker.particles,
        'frames_per_s': [rates[REPEATS // 2], rates[0], rates[-1]]}
    for case in kernels.cases():
        if case.what.startswith('PDA-MMPF') and case.size == str(PARTICLES):
            timing = kernels.timed(case, 2.0, 7)
            found[case.what] = {
                'ns': 1e9 * timing.subject / case.count, 'goal_ns': case.goal_ns,
                'reference': case.reference, 'ratio': timing.subject / timing.reference}
    return found | {'load': os.getloadavg()[0]}
