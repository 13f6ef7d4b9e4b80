# SPDX-License-Identifier: Apache-2.0
"""What the functions of lowsnr refuse, in one line that names the argument and the remedy."""

import math

import lowsnr
from lowsnr_detect.parts.registry import DETECTORS
import numpy as np
import pytest

FAST = {'cdt.operating_point': 'manual', 'cdt.threshold': 6.0}
SHAPE = (12, 17)


def test_every_detector_is_known_by_its_name():
    lowsnr.calibrate  # noqa: B018  (importing lowsnr registers all)
    for name in DETECTORS:
        with pytest.raises(ValueError, match='^frames: '):
            lowsnr.track(np.full((6, *SHAPE), np.nan), name)


WHITE = np.random.default_rng(0).standard_normal((8, *SHAPE))
BAD = [
    ({'frames': WHITE[0]}, 'frames', 'frame[None]'),
    ({'frames': np.zeros((8, 9, 9, 3))}, 'frames', 'frames[..., 0]'),
    ({'frames': WHITE[:0]}, 'frames', '(frames, rows, cols)'),
    ({'frames': [WHITE[0], WHITE[0, :3]]}, 'frames', 'one size'),
    ({'frames': WHITE > 0}, 'frames', 'integers or floating point'),
    ({'frames': WHITE + 0j}, 'frames', 'integers or floating point'),
    ({'frames': np.where(np.arange(17) == 3, np.nan, WHITE)}, 'frames', "condition='on'"),
    ({'frames': np.where(np.arange(17) == 3, np.inf, WHITE)}, 'frames', "condition='on'"),
    ({'frames': np.where(np.arange(17) == 3, np.inf, WHITE).astype('f2')}, 'frames', 'is inf'),
    ({'frames': np.where(np.arange(17) == 3, np.nan, WHITE).astype('f2')}, 'frames', 'is nan'),
    ({'frames': 100.0 + WHITE}, 'frames', "condition='on'"),
    ({'frames': 12.0 * WHITE}, 'frames', 'all.sensor.noise_std'),
    ({'frames': np.ones((5, 9, 9), np.uint8)}, 'frames', 'more frames'),
    ({'frames': np.ones((9, 9, 1), np.uint8)}, 'frames', '2 x 2'),
    ({'detector': 'std'}, 'detector', 'did you mean sdt?'),
    ({'detector': 'cdt', 'settings': {'cdt.treshold': 3.0}}, 'settings', "'cdt.threshold'"),
    ({'detector': 'cdt', 'settings': {'sdt.threshold': 3.0}}, 'settings', "'cdt.threshold'"),
    ({'detector': 'cdt', 'settings': {'tracker.rows': 3}}, 'settings', 'tracker.rows'),
    ({'detector': 'cdt', 'settings': {'conditioner.binning': 1}}, 'settings', 'binning'),
    ({'detector': 'cdt', 'settings': {'tracker.particles': 1}}, 'settings', '[10, 1000000]'),
    ({'detector': 'cdt', 'settings': {'tracker.particles': 'x'}}, 'settings', 'whole number'),
    ({'detector': 5}, 'detector', 'a name'),
    ({'detector': ['sdt']}, 'detector', 'a name'),
    ({'detector': ''}, 'detector', 'sdt'),
    ({'settings': ['cdt.threshold']}, 'settings', 'a mapping'),
    ({'settings': {3: 1}}, 'settings', 'no setting'),
    ({'settings': {'sensor.noise_std': 2.0}}, 'settings', "did you mean 'all.sensor.noise_std'?"),
    ({'settings': {'all.sensor.frame_period_s': 0.1}}, 'settings', 'period_s'),
    ({'settings': {'sdt.sensor.frame_period_s': 0.1}}, 'settings', 'period_s'),
    ({'snr_db': 'loud'}, 'snr_db', 'a number'),
    ({'snr_db': math.nan}, 'snr_db', 'a number'),
    ({'snr_db': 900.0}, 'snr_db', '[-30.0, 80.0]'),
    ({'period_s': 0.0}, 'period_s', '(0.0, inf)'),
    ({'seed': 1.5}, 'seed', 'whole number'),
    ({'seed': -1}, 'seed', '[0, inf)'),
    ({'false_alarm_prob': 1.0}, 'false_alarm_prob', '(0.0, 1.0)'),
    ({'condition': 'offf'}, 'condition', 'did you mean off?'),
    ({'detector': 'hmm', 'settings': {'hmm.operating_point': 'adaptive'}}, 'HMM', 'matched'),
    ({'settings': {'all.statistic_map': True}}, 'settings', 'leave it out')]


@pytest.mark.parametrize(('arguments', 'culprit', 'remedy'), BAD)
def test_error_is_one_line_that_names_argument_and_remedy(arguments, culprit, remedy):
    with pytest.raises(ValueError, match=f'^{culprit}') as caught:
        lowsnr.track(**{'frames': WHITE} | arguments)
    line = str(caught.value)
    assert remedy in line
    assert '\n' not in line


@pytest.mark.parametrize(('call', 'arguments', 'culprit'), [
    (lowsnr.simulate, {'seed': 1.5}, 'seed'), (lowsnr.simulate, {'seed': -1}, 'seed'),
    (lowsnr.simulate, {'seed': None}, 'seed'), (lowsnr.simulate, {'snr_db': 'x'}, 'snr_db'),
    (lowsnr.simulate, {'settings': {3: 1}}, 'settings'),
    (lowsnr.simulate, {'settings': [1]}, 'settings'),
    (lowsnr.simulate, {'settings': {'sensor.noise_stdd': 1.0}}, 'settings'),
    (lowsnr.simulate, {'settings': {'sensor.noise_std': 'x'}}, 'settings'),
    (lowsnr.calibrate, {'shape': 8}, 'shape'), (lowsnr.calibrate, {'shape': (8,)}, 'shape'),
    (lowsnr.calibrate, {'shape': (5, 8, 8)}, 'shape'),
    (lowsnr.calibrate, {'shape': (-2, 8)}, 'shape'),
    (lowsnr.calibrate, {'shape': (8.0, 8)}, 'shape'),
    (lowsnr.condition, {'frames': np.ones((9, 8, 8), 'u1'), 'settings': 3}, 'settings')])
def test_error_of_any_function_is_one_line_that_names_the_argument(call, arguments, culprit):
    with pytest.raises(ValueError, match=f'^{culprit}') as caught:
        call(**arguments)
    assert '\n' not in str(caught.value)


def test_numbers_of_numpy_are_numbers():
    plain = lowsnr.simulate(snr_db=9.5, seed=3, settings={'sensor.noise_std': 2.0})
    numpy = lowsnr.simulate(snr_db=np.float32(9.5), seed=np.int64(3), settings={
        'sensor.noise_std': np.float32(2.0)})
    assert plain.frames.tobytes() == numpy.frames.tobytes()


def test_deviation_is_stated_as_the_message_says():
    noise = 20.0 * WHITE
    with pytest.raises(ValueError, match='all.sensor.noise_std'):
        lowsnr.track(noise, 'cdt')
    found = lowsnr.track(noise, 'cdt', settings={
        **FAST, 'all.sensor.noise_std': 20.0})
    for part in ('cdt', 'tracker'):
        assert found.settings[f'{part}.sensor.noise_std'] == 20.0


def test_unknown_scenario_is_refused_by_name():
    with pytest.raises(ValueError, match='did you mean example4'):
        lowsnr.simulate('exmple4')
