# SPDX-License-Identifier: Apache-2.0
"""Run studies on workers: calibrate, run the missing blocks, and keep each finished block."""

from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Mapping
from typing import Any

from lowsnr_bringup.run.progress import progress
from lowsnr_detect.calibration.operating_point import calibrated
from lowsnr_eval.study.experiment import Block
from lowsnr_eval.study.experiment import BlockResults
from lowsnr_eval.study.experiment import run_block
from lowsnr_eval.study.study import Calibrated
from lowsnr_eval.study.study import Study
from lowsnr_eval.study.study import Thresholds
from lowsnr_eval.study.study_folder import StudyFolder
from lowsnr_eval.study.study_results import join_blocks
from lowsnr_eval.study.study_results import StudyResults
from lowsnr_eval.study.workers import Workers


def calibrate_all(workers: Workers, studies: Iterable[Study]) -> Thresholds:
    """Return the matched thresholds of some studies [nat]; show the progress."""
    wanted = set().union(*(study.calibrations() for study in studies))
    tasks = {str(item): (item,) for item in sorted(wanted, key=_calibration_cost, reverse=True)}
    found = {}
    with progress('calibrating', len(tasks), 'thresholds') as advance:
        def keep(name: str, threshold: float) -> None:
            found[tasks[name][0]] = threshold
            advance(1)

        workers.run(_calibrate, tasks, keep)
    return found


def run_study(
    workers: Workers, study: Study, thresholds: Thresholds, folder: StudyFolder,
) -> None:
    """Run the blocks that the folder does not hold yet; show the progress."""
    blocks = study.blocks(thresholds)
    missing = {name: block for name, block in blocks.items() if folder.load(name) is None}
    total, left = (sum(block.count for block in some.values()) for some in (blocks, missing))
    with progress(study.example.scenario, total, 'runs', done=total - left) as advance:
        def keep(name: str, results: BlockResults) -> None:
            folder.save(name, results)
            advance(blocks[name].count)

        workers.run(run_block, _costliest_first(missing), keep)


def collect(study: Study, thresholds: Thresholds, folder: StudyFolder) -> StudyResults:
    """Return the results of the finished blocks of a study."""
    return join_blocks(study, ((name, folder.load(name)) for name in study.blocks(thresholds)))


def thresholds_by_name(study: Study, thresholds: Thresholds) -> dict[str, dict[str, float]]:
    """Return the matched thresholds of a study, by case and method [nat]."""
    return {
        case.name: {m.label: thresholds[case.calibration(m)] for m in case.methods}
        for case in study.cases}


def _calibrate(item: Calibrated) -> float:
    detector, prob, shape, runs = item
    # Without the default in it, the key in the cache is that of the node graph.
    options: dict[str, Any] = {} if runs is None else {'runs': runs}
    return calibrated(detector, prob, shape, **options).threshold


def _calibration_cost(item: Calibrated) -> tuple[bool, int, str]:
    """Return a sort key: the number of runs, then that of particles, then anything fixed."""
    detector, _, _, runs = item
    return runs is None, getattr(detector, 'particles', 0), str(detector)


def _costliest_first(blocks: Mapping[str, Block]) -> dict[str, tuple[Block]]:
    """Sort the blocks so that no worker ends much later than the others."""
    def cost(item: tuple[str, Block]) -> tuple[bool, int]:
        block = item[1]
        return block.first >= block.crowded_runs, -len(block.chains)
    return {name: (block,) for name, block in sorted(blocks.items(), key=cost)}
