# SPDX-License-Identifier: Apache-2.0
"""A scenario whose objects are faster than the models of motion allow is noted before it runs."""

from pathlib import Path

from lowsnr_bringup.plan.run_options import RunOptions
from lowsnr_bringup.plan.run_plan import plan_run
import pytest

CONFIG = Path(__file__).resolve().parents[2] / 'config'


@pytest.mark.parametrize(('scenario', 'overrides', 'named'), [
    ('example4', (), []), ('crossing', (), []), ('random', (), []),
    ('example5', (), ['cdt.tracker 1', 'hmm.tracker 1', 'hmm 1']),
    ('example5', ('tracker.motion.max_speed_mps=1.5',), ['hmm 1']),
    ('example5', ('tracker.motion.max_speed_mps=1.5', 'hmm.motion.max_speed_mps=1.5'), [])])
def test_scenario_that_is_faster_than_the_models_of_motion_is_noted(scenario, overrides, named):
    run = plan_run(RunOptions(
        detectors=['cdt', 'hmm'], scenario=scenario, overrides=overrides), CONFIG)
    speeds = [note for note in run.notes if 'motion.max_speed_mps' in note]
    assert len(speeds) == bool(named)
    if named:
        assert f'({", ".join(named)})' in speeds[0]
        assert '1.4 m/s' in speeds[0]
        assert speeds[0].startswith('example5: ')
