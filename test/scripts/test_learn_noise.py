# SPDX-License-Identifier: Apache-2.0
"""The command that learns noise prints settings that a run takes, and names unfit frames."""

from pathlib import Path
import subprocess
import sys

from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.noise.settings import Noise
from lowsnr_common.settings.flat_values import build_settings
from lowsnr_common.settings.flat_values import flatten
import numpy as np
import pytest
import yaml

COMMAND = Path(__file__).resolve().parents[2] / 'scripts' / 'learn_noise.py'


def learn(*arguments):
    """Return the finished command."""
    return subprocess.run(
        [sys.executable, COMMAND, *map(str, arguments)], capture_output=True, text=True,
        timeout=120, check=False)


def test_what_is_learned_is_the_noise_of_the_frames(tmp_path, rng):
    source = SensorModel(noise=Noise(model='student_t'), noise_std=3.0)
    frames = source.draw_noise((300, 20, 24), rng).astype(np.float32)
    frames[:10] = 0.0  # as of a conditioner that has no background yet
    np.savez(tmp_path / 'empty.npz', frames=frames)
    done = learn(tmp_path / 'empty.npz')
    assert done.returncode == 0, done.stderr
    values = flatten(yaml.safe_load(done.stdout)['/**']['ros__parameters']['sensor'])
    found = build_settings(SensorModel, values)
    assert found.noise_std == pytest.approx(frames[10:].std(), rel=1e-4)
    z = np.linspace(-9.0, 15.0, 49).reshape(7, 7)
    assert np.abs(found.log_likelihood_ratio(z) - source.log_likelihood_ratio(z)).mean() < 0.15


@pytest.mark.parametrize(('frames', 'word'), [
    (np.ones((3, 8, 8)), 'distinct'), (np.full((300, 20, 20), 7.0), 'distinct'), (None, 'no')])
def test_unfit_frames_are_named(tmp_path, frames, word):
    path = tmp_path / 'frames.npz'
    if frames is not None:
        np.savez(path, frames=frames)
    done = learn(path)
    assert done.returncode == 2
    assert str(path) in done.stderr
    assert word in done.stderr
    assert len(done.stderr.splitlines()) == 1
