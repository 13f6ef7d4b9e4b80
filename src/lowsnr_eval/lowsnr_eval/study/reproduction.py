"""Run a study on workers: calibrate, run what is not finished, keep every finished block."""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterable
from collections.abc import Mapping

from distributed import Client
from lowsnr_detect.calibration.operating_point import calibrated
from lowsnr_eval.report.study_figures import draw
from lowsnr_eval.report.study_figures import Plan
from lowsnr_eval.study.experiment import Block
from lowsnr_eval.study.experiment import run_block
from lowsnr_eval.study.study import Calibrated
from lowsnr_eval.study.study import Study
from lowsnr_eval.study.study import Thresholds
from lowsnr_eval.study.study_folder import StudyFolder
from lowsnr_eval.study.study_results import gather
from lowsnr_eval.study.study_results import Outcome
from lowsnr_eval.study.workers import run_tasks

# Told what is done, how much of it there is, and how much more has just been finished.
Progress = Callable[[str, int, int], None]


def calibrate_all(
    client: Client, studies: Iterable[Study], progress: Progress,
) -> Thresholds:
    """Return the matched thresholds of some studies [nat], maybe cached."""
    wanted = set().union(*(study.calibrations() for study in studies))
    tasks = {str(item): (item,) for item in sorted(wanted, key=_calibration_cost, reverse=True)}
    found = {}
    progress('calibrating', len(tasks), 0)
    for name, threshold in run_tasks(client, _calibrate, tasks):
        found[tasks[name][0]] = threshold
        progress('calibrating', len(tasks), 1)
    return found


def run_study(
    client: Client, study: Study, thresholds: Thresholds, folder: StudyFolder,
    progress: Progress,
) -> None:
    """Run the blocks that the folder does not hold yet; each is kept as soon as it is done."""
    blocks = study.blocks(thresholds)
    missing = {name: block for name, block in blocks.items() if folder.load(name) is None}
    title, total = study.example.scenario, sum(block.count for block in blocks.values())
    progress(title, total, total - sum(block.count for block in missing.values()))
    for name, results in run_tasks(client, run_block, _dearest_first(missing)):
        folder.save(name, results)
        progress(title, total, blocks[name].count)


def collect(study: Study, thresholds: Thresholds, folder: StudyFolder) -> Outcome:
    """Return what has come out of a study so far."""
    return gather(study, ((name, folder.load(name)) for name in study.blocks(thresholds)))


def draw_all(client: Client, plan: Plan) -> dict[str, tuple[str, bytes]]:
    """Draw the figures of a plan on the workers; return SVG and PNG by name."""
    return dict(run_tasks(client, draw, {name: (make,) for name, (_, make) in plan.items()}))


def thresholds_by_name(study: Study, thresholds: Thresholds) -> dict[str, dict[str, float]]:
    """Return the matched thresholds of a study, by case and method [nat]."""
    return {
        case.name: {m.label: thresholds[case.calibration(m)] for m in case.methods}
        for case in study.cases}


def _calibrate(item: Calibrated) -> float:
    detector, prob, shape, runs = item
    # The default is left to the default, so that the node graph finds the same in the cache.
    if runs is None:
        return calibrated(detector, prob, shape).threshold
    return calibrated(detector, prob, shape, runs=runs).threshold


def _calibration_cost(item: Calibrated) -> tuple[bool, int, str]:
    """Sort by what calibrations take: many runs, of many particles, of whatever else."""
    detector, _, _, runs = item
    return runs is None, getattr(detector, 'particles', 0), str(detector)


def _dearest_first(blocks: Mapping[str, Block]) -> dict[str, tuple[Block]]:
    """Put the blocks that take longest first, so that no worker ends much after the others."""
    def cost(item: tuple[str, Block]) -> tuple[bool, int]:
        block = item[1]
        return block.first >= block.crowded_runs, -len(block.chains)
    return {name: (block,) for name, block in sorted(blocks.items(), key=cost)}
