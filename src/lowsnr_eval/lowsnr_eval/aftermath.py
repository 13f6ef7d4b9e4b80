"""The summary of a run, made whole when all nodes have ended."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from dataclasses import field
from pathlib import Path
from typing import Any

from lowsnr_eval.graph import build
from lowsnr_eval.judge import Judge
from lowsnr_eval.results import FRAMES_FILE
from lowsnr_eval.results import note_losses
from lowsnr_eval.run_settings import RunSettings
from lowsnr_eval.scoring import Evaluation


@dataclass
class Account:
    """
    What only the starter of the nodes knows of a run.

    ``published`` counts the frames that the source sent, ``restarts`` how often each node was
    started again, by its label; ``summed_up`` says whether the evaluator came to its end.
    """

    published: int = 0
    restarts: Mapping[str, int] = field(default_factory=dict)
    summed_up: bool = False


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
