# SPDX-License-Identifier: Apache-2.0
"""The tail of a statistic in white noise is simulated once and then kept."""

from dataclasses import replace

from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.settings.flat_values import changed
from lowsnr_common.settings.flat_values import flat_values
from lowsnr_common.settings.frame_period import at_frame_period
from lowsnr_detect.adaptive import known_tails as module
from lowsnr_detect.adaptive.known_tails import white_tail
from lowsnr_detect.detectors.cusum import CUSUM
from lowsnr_detect.detectors.sdt import SDT
import numpy as np
import pytest

# A detector whose statistic is not that of a shipped tail.
OTHER = CUSUM(drift=0.37)


@pytest.fixture
def simulations(tmp_path, monkeypatch):
    """Return the sizes that were simulated, with a cache of the test's own."""
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
    monkeypatch.setattr(module, '_FRAMES', 3)
    found, simulated = [], module.simulated_tail

    def counted(detector, rows, cols, frames):
        found.append((rows, cols))
        return simulated(detector, rows, cols, frames)

    monkeypatch.setattr(module, 'simulated_tail', counted)
    white_tail.cache_clear()
    yield found
    white_tail.cache_clear()


def test_the_next_process_reads_what_was_simulated(simulations):
    first = white_tail(OTHER, 512, 640)
    white_tail.cache_clear()  # as in another process
    assert white_tail(OTHER, 512, 640) == first
    assert simulations == [(64, 64)]


def test_frame_period_and_frames_beyond_the_simulated_size_do_not_matter(simulations):
    first = white_tail(OTHER, 64, 64)
    motion = replace(CUSUM().motion, max_speed_mps=60.0, min_speed_mps=0.0)
    slow = replace(OTHER, motion=motion)
    for period_s in (1.0 / 30.0, 1.00001 / 30.0):
        assert white_tail(at_period(OTHER, period_s), 480, 640) == first
    assert white_tail(slow, 64, 64) != first
    assert len(simulations) == 2


def at_period(detector, period_s):
    """Return a detector for objects that move as much from frame to frame."""
    values = at_frame_period(type(detector), flat_values(detector), period_s)
    return changed(detector, values | {'sensor.frame_period_s': period_s})


def test_damaged_file_is_not_used(simulations, tmp_path):
    first = white_tail(CUSUM(), 30, 20)
    file, = (tmp_path / 'lowsnr').iterdir()
    file.write_text(file.read_text().replace('"level": ', '"level": 1'))
    white_tail.cache_clear()
    assert white_tail(CUSUM(), 30, 20) == first
    assert simulations == [(30, 20)] * 2


def test_statistic_without_a_sample_in_white_noise_has_the_tail_of_wald():
    """At a design SNR of 20 dB no path of noise is decided."""
    found = white_tail(SDT(sensor=SensorModel(snr_db=20.0)), 20, 20)
    cells, prob = 400, 0.01
    # One maximum in a neighbourhood at most, each above x with probability exp(-x).
    reach = SDT(sensor=SensorModel(snr_db=20.0)).peak_reach
    assert found.per_cell == pytest.approx(1.0 / (2 * reach + 1)**2)
    wanted = np.log(cells * found.per_cell / -np.log1p(-prob))
    assert found.threshold(cells, prob) == pytest.approx(wanted, abs=1e-9)
