# SPDX-License-Identifier: Apache-2.0
"""Models of noise and blur in the plan of a run."""

from pathlib import Path

from lowsnr_bringup.plan.run_options import RunOptions
from lowsnr_bringup.plan.run_plan import plan_run
import pytest

CONFIG = Path(__file__).resolve().parents[2] / 'config'


def plan(**options):
    return plan_run(RunOptions(**{'detectors': ['sdt'], 'scenario': 'example3'} | options), CONFIG)


def test_noise_is_declared_once_for_sensor_detectors_and_tracker():
    run = plan(detectors=['cdt', 'hmm'], overrides=[
        'all.sensor.noise.model=k', 'all.sensor.noise.shape=2', 'hmm.sensor.noise.shape=3'])
    shapes = {path: values['sensor.noise.shape'] for path, values in run.parameters.items()
              if values.get('sensor.noise.model') == 'k'}
    assert shapes.pop('/hmm/hmm_detector') == 3.0
    assert shapes['/sensor'] == shapes['/cdt/cdt_detector'] == 2.0
    assert set(shapes.values()) == {2.0}
    assert run.detectors['/hmm/hmm_detector'].sensor.noise.shape == 3.0


def test_run_with_blur_states_the_snr_of_the_brightest_cell():
    assert not plan().notes
    run = plan(detectors=['cdt', 'sdt'], overrides=['all.sensor.blur_m=0.7'])
    note, = run.notes
    # 6 dB less 10 log10(pi 0.7^2).
    assert '6 dB' in note
    assert '4.1 dB' in note


@pytest.mark.parametrize(('overrides', 'words'), [
    (['noise.model=cauchy'], ['cauchy', 'student_t']),
    (['noise.degrees_of_freedom=2'], ['degrees_of_freedom = 2', '(2.0']),
    (['noise.background=-1'], ['background = -1']),
    (['noise.model=empirical'], ['quantiles', 'learn_noise.py']),
    (['noise.model=empirical', f'noise.quantiles={[*range(35), 34]}'], ['quantiles', 'ascending']),
    (['fluctuation=swerling5'], ['swerling5', 'swerling4']),
    (['noise.model=k', 'snr_db=35'], ['snr_db = 35', ' 30 ']),
])
def test_noise_with_impossible_parameters_is_refused_by_name(overrides, words):
    with pytest.raises(ValueError) as caught:
        plan(overrides=[f'all.sensor.{each}' for each in overrides])
    (line,) = str(caught.value).splitlines()
    assert not [word for word in words if word not in line], line
