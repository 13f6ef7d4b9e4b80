# SPDX-License-Identifier: Apache-2.0
"""A host finds the thresholds of the detectors that it runs, whole or a tile of them."""

import bringup
from lowsnr_bringup.plan.parts import part_of
from lowsnr_bringup.plan.run_options import RunOptions
from lowsnr_bringup.plan.run_plan import plan_run
import pytest


@pytest.mark.parametrize(('tiles', 'own', 'found'), [
    ((1, 1), ['sdt_detector'], ['/sdt_detector']), ((1, 1), ['evaluator', 'tracker'], []),
    ((1, 2), ['sdt_2'], ['/sdt_detector']), ((1, 2), ['sdt_detector', 'tracker'], []),
    ((1, 2), ['sdt_detector', 'sdt_1'], ['/sdt_detector'])])
def test_host_calibrates_what_it_runs_and_no_merger(monkeypatch, tiles, own, found):
    calibrated = []
    monkeypatch.setattr(bringup, 'calibrate_detector', lambda path, *_: calibrated.append(path))
    plan = plan_run(
        RunOptions(detectors=['sdt'], scenario='example3', tiles=tiles), bringup.CONFIG)
    expected = [node.label for node in plan.nodes if node.label not in own]
    bringup.calibrate(plan, part_of(plan.nodes, plan.parameters, own, expected))
    assert calibrated == found
