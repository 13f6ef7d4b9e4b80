# SPDX-License-Identifier: Apache-2.0
"""The tracker of a run has the resolution of its detector."""

from pathlib import Path

from lowsnr_bringup.plan.run_options import RunOptions
from lowsnr_bringup.plan.run_plan import plan_run

CONFIG = Path(__file__).resolve().parents[2] / 'config'


def resolutions(detectors, override):
    """Return detection.resolution of the trackers behind detectors."""
    run = plan_run(
        RunOptions(detectors=detectors, scenario='example3', overrides=[override]), CONFIG)
    return [values['detection.resolution'] for path, values in run.parameters.items()
            if path.endswith('/tracker')]


def test_it_is_the_cells_that_a_declaration_suppresses_and_half_of_one():
    found = resolutions(['cdt', 'sdt', 'hmm', 'auto'], 'auto.thinning_reach=4')
    assert sorted(found) == [0.0, 0.5, 2.5, 4.5]  # hmm states a posterior


def test_it_can_be_set():
    assert resolutions(['sdt'], 'tracker.detection.resolution=1') == [1.0]


def test_it_may_be_that_of_the_farthest_thinning():
    assert resolutions(['cdt'], 'cdt.thinning_reach=50') == [50.5]
