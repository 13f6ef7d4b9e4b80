# SPDX-License-Identifier: Apache-2.0
"""Which nodes of a run publish and show the statistic of a detector."""

from pathlib import Path

from lowsnr_bringup.plan.config_files import to_yaml
from lowsnr_bringup.plan.run_options import RunOptions
from lowsnr_bringup.plan.run_plan import plan_run
import pytest

CONFIG = Path(__file__).resolve().parents[2] / 'config'


def plan(**options):
    return plan_run(RunOptions(**{'detectors': ['sdt'], 'scenario': 'example3'} | options), CONFIG)


@pytest.mark.parametrize('options', [
    {'statistic_map': True, 'detectors': ['sdt']}, {'overrides': ['sdt.statistic_map=true']}])
def test_statistic_is_drawn_of_the_detectors_that_publish_it(options):
    values = plan(view=True, **{'detectors': ['cdt', 'sdt']} | options).parameters
    assert values['/evaluator']['statistic_maps'] == ('sdt',)
    one = len(values) == 5
    assert values['/viewer' if one else '/sdt/viewer']['statistic_map']
    assert one or not values['/cdt/viewer']['statistic_map']


def test_parameter_file_of_a_run_without_has_no_empty_list_that_ros_cannot_read():
    assert 'statistic_maps' not in to_yaml(plan().parameters)


def test_statistic_without_the_threshold_that_decides_is_refused():
    with pytest.raises(ValueError, match="hmm_detector: statistic_map .* 'hit' .*decision.rule"):
        plan(detectors=['hmm'], statistic_map=True, overrides=['hmm.decision.rule=hit'])
