# SPDX-License-Identifier: Apache-2.0
"""Get the compiled loops of a detector ready, so that no frame waits for a compiler."""

from __future__ import annotations

from lowsnr_common.settings.node_settings import DetectionSettings
from lowsnr_detect.adaptive.adaptive_detector import AdaptiveDetector
from lowsnr_detect.adaptive.adaptive_threshold import LEARNING_FRAMES
from lowsnr_detect.adaptive.known_tails import SIDE
from lowsnr_detect.parts.cell_detector import CellDetector
from lowsnr_detect.parts.detector import Detector
from lowsnr_detect.parts.registry import detector_class
import numpy as np

# What is compiled, or loaded, at its first use depends on the type of a frame, not on its size.
_SHAPE, _FRAMES, _TYPES = (8, 8), 3, (np.float64, np.float32)
# An adaptive detector uses the last of its loops once it has learned for a few frames.  Its tail
# in white noise at this size is part of the package: that of a smaller one would be simulated.
_ADAPTIVE_SHAPE, _ADAPTIVE_FRAMES = (SIDE, SIDE), 4 * LEARNING_FRAMES


def warm_up(detector: Detector, operating: DetectionSettings) -> None:
    """Run a detector at its operating point on small frames with an object and with noise."""
    _run(detector, _SHAPE, _FRAMES)
    if operating.operating_point == 'adaptive':
        adaptive = AdaptiveDetector(detector, operating.false_alarm_prob, _ADAPTIVE_SHAPE)
        _run(adaptive, _ADAPTIVE_SHAPE, _ADAPTIVE_FRAMES)


def preload(name: str, operating_point: str) -> None:
    """Load the compiled loops of a detector, by name, with its default settings."""
    detector = detector_class(name)()
    if not isinstance(detector, CellDetector):  # no other can be adaptive
        operating_point = 'matched'
    warm_up(detector, DetectionSettings(operating_point=operating_point))


def _run(
    detector: Detector | AdaptiveDetector, shape: tuple[int, int], frames: int,
) -> None:
    for kind in _TYPES:
        state, rng = detector.init(shape), np.random.default_rng(0)
        for _ in range(frames):
            frame = rng.standard_normal(shape)
            frame[3, 4] += 5.0 * detector.sensor.noise_std
            state, _ = detector.step(state, frame.astype(kind), rng)
