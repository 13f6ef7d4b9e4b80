# SPDX-License-Identifier: Apache-2.0
"""Patches of background in real sequences: smooth, seamless, and nothing else changed."""

from pathlib import Path
import sys

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / 'benchmarks'))
from real_frames_erased import erased  # noqa: E402
from real_frames_erased import membrane  # noqa: E402


def test_membrane_continues_harmonic_functions_exactly():
    row, col = np.mgrid[:14, :11].astype(float)
    known = np.ones((14, 11), bool)
    known[3:11, 2:8] = False
    for exact in (2.0 + 0.5 * row - 3.0 * col, row**2 - col**2, row * col):
        np.testing.assert_allclose(membrane(np.where(known, exact, 99.0), known), exact, atol=1e-9)


@pytest.mark.parametrize('drift', [0.0, 0.4])
def test_patch_has_no_object_and_no_border_whatever_the_level(drift):
    row, col = np.mgrid[:40, :50]
    frames = np.stack([100.0 + 0.2 * row + drift * k + 0.0 * col for k in range(20)])
    background = frames.copy()
    truth = np.stack([10.0 + 1.5 * np.arange(20), np.full(20, 18.0)], -1)
    truth[15:] = np.nan
    for frame, (x, y) in zip(frames, truth[:15].astype(int)):
        frame[y - 1:y + 2, x - 1:x + 2] += 60.0
    found = erased({'frames': np.rint(frames).astype(np.uint8), 'truth': truth})
    assert found.dtype == np.uint8
    # Rounding, and the median of a drift where the object passed.
    assert np.abs(found - background).max() <= 2.0
