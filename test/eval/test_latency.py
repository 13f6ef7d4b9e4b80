# SPDX-License-Identifier: Apache-2.0
"""Latencies where no truth tells when a frame was sent, of detectors with and without a lag."""

from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_common.settings.node_settings import RunSettings
from lowsnr_eval.scoring.run_scoring import RunScorer
import numpy as np
import pytest

SECOND = 1_000_000_000


def test_latency_without_truth_is_from_the_arrival_of_the_frame(tmp_path):
    one = RunScorer(RunSettings(
        results=str(tmp_path), truth=False, detectors=('hmm', 'cusum'), namespaces=True,
        lags=(5, 0), operating_points=('matched', 'matched')), Evaluation(), print)
    scored = []
    for k in range(1, 9):  # the frames arrive at these seconds, but for one that does not
        if k != 2:
            one.add_frame(k * SECOND, np.zeros((2, 3)), float(k))
        for chain, about, after_s in (('cusum', k, 0.01), ('hmm', k - 5, 0.03)):
            for topic, more_s in (('detections', 0.0), ('tracks', 0.001)) * (about > 0):
                one.add_array(f'{chain}/{topic}', about * SECOND, [], k + after_s + more_s)
        scored += one.score()
    one.close()
    assert [each.number for each in scored] == [1, 2, 3]
    for each in scored:
        for chain, expected in (('cusum', 10.0), ('hmm', 5030.0)):
            found = each.answers[chain]
            if each.number == 2:
                assert found.detection_ms is found.latency_ms is None
            else:
                assert found.detection_ms == pytest.approx(expected)
                assert found.latency_ms == pytest.approx(expected + 1.0)
