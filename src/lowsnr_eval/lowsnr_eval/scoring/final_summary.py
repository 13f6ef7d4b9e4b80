"""The summary of a run, made whole when all nodes have ended."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lowsnr_bringup.plan.graph import build
from lowsnr_bringup.run.results_folder import Account
from lowsnr_bringup.run.results_folder import FRAMES_FILE
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_common.settings.node_settings import RunSettings
from lowsnr_eval.scoring.results import note_losses
from lowsnr_eval.scoring.run_scoring import Judge


def sum_up(evaluator: Mapping[str, Any], account: Account) -> None:
    """
    Leave a summary of all that was scored, also where the evaluator did not come to it.

    Parameters
    ----------
    evaluator
        Parameters of the evaluator.
    account
        What its starter knows.

    Raises
    ------
    OSError, ValueError
        If the results cannot be read or written.

    """
    run = build(RunSettings, evaluator, 'evaluator')
    folder = Path(run.results)
    table = folder / FRAMES_FILE
    if not account.summed_up and table.is_file() and table.stat().st_size:
        with Judge(
                run, build(Evaluation, evaluator, 'evaluator'), evaluator.get('seed', 0),
                refuse=print, resumed=True) as judge:
            judge.write_summary()
    note_losses(folder, account.published, account.restarts)
