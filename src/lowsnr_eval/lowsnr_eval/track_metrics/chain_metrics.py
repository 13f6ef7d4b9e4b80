# SPDX-License-Identifier: Apache-2.0
"""The metrics of the tracks of one chain over a run, frame by frame in bounded memory."""

from __future__ import annotations

from typing import Any

from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_eval.scoring import metrics
from lowsnr_eval.track_metrics.existence_calibration import ExistenceCalibration
from lowsnr_eval.track_metrics.false_tracks import FalseTracks
from lowsnr_eval.track_metrics.identity import Identities
from lowsnr_eval.track_metrics.ospa2 import WINDOW_FRAMES
from lowsnr_eval.track_metrics.ospa2 import WindowedOspa2
from lowsnr_eval.track_metrics.siap import Siap
from lowsnr_eval.track_metrics.track_frame import TrackFrame
import numpy as np


class ChainMetrics:
    """The metrics of the tracks of a chain; ``frames`` counts those added."""

    def __init__(self, evaluation: Evaluation) -> None:
        gate_m, self._cutoff_m = evaluation.gate_m, evaluation.gospa_cutoff_m
        self._ospa2, self._siap = WindowedOspa2(self._cutoff_m), Siap(gate_m)
        self._identities, self._existence = Identities(gate_m), ExistenceCalibration(gate_m)
        self._false = FalseTracks()
        self._gospa_m2 = np.zeros(3)
        self.frames = 0

    def add(self, frame: TrackFrame) -> None:
        """Add a frame; frames come in order."""
        for each in (self._ospa2, self._siap, self._identities, self._existence, self._false):
            each.add(frame)
        self._gospa_m2 += metrics.gospa_parts(frame.distance, self._cutoff_m)
        self.frames += 1

    def figures(self) -> dict[str, Any] | None:
        """Return the metrics as in ``summary.json``; None of no frame."""
        if not self.frames:
            return None
        parts = (self._gospa_m2 / self.frames).tolist()
        return {
            'frames': self.frames,
            'ospa2_m': self._ospa2.value, 'ospa2_window_frames': WINDOW_FRAMES,
            'gospa_parts_m2': dict(zip(('localisation', 'missed', 'false'), parts, strict=True)),
            'siap': self._siap.figures(),
            **self._identities.figures(),
            'false_tracks': self._false.figures(),
            'existence_calibration': self._existence.figures(),
        }
