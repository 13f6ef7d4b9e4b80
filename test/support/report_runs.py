# SPDX-License-Identifier: Apache-2.0
"""Results folders of made-up runs, for tests of their reports."""

from contextlib import closing

from lowsnr_bringup.run.results_folder import Account
from lowsnr_common.core.records import Estimate
from lowsnr_common.core.records import Truth
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_common.settings.node_settings import RunSettings
from lowsnr_eval.scene.scene_writer import SceneWriter
from lowsnr_eval.scoring.final_summary import summarize
from lowsnr_eval.scoring.final_summary import write_summary
from lowsnr_eval.scoring.frame_scoring import Answer
from lowsnr_eval.scoring.frame_scoring import score_frame
from lowsnr_eval.scoring.score_tables import ScoreTables
import numpy as np

FRAMES, SHAPE = 8, (7, 5)


def tracked(x, y, name=''):
    """Return an estimate at a place with a covariance of one and an existence of 0.9."""
    return Estimate(np.array([x, 0.5, y, 0.0]), np.eye(4), 0.9, name)


def score(folder, frames):
    """Score frames of (truth, answer) as the evaluator does."""
    with closing(ScoreTables(folder, ['sdt'])) as tables:
        for k, (truth, answer) in enumerate(frames, start=1):
            answers = {'sdt': answer}
            tables.add(score_frame(k, float(k), truth, answers, Evaluation()), answers)
    write_summary(folder, summarize(
        folder, RunSettings(scenario='made up'), Evaluation(), 0, Account()))


def write_run(folder, rng):
    """Write the results of a run of one object, seen from frame 3 on."""
    frames = []
    with closing(SceneWriter(folder, 1.0)) as scene:
        for k in range(1, FRAMES + 1):
            truth = [Truth('</script>', np.array([k / 2, 0.5, 3.0, 0.0]))] if k > 2 else []
            found = [tracked(k / 2, 3.2)] if k > 3 else []
            answer = Answer(found, [tracked(k / 2, 3.1, '4')] if k > 5 else [], 1.0)
            frame = rng.standard_normal(SHAPE)
            # The first cell is black in odd frames and white in even ones.
            frame[0, 0] = 9.0 if k % 2 == 0 else -9.0
            scene.add_frame(k, frame)
            scene.add_answers(k, k, truth, {'sdt': answer})
            frames.append((truth, answer))
    score(folder, frames)
    (folder / 'parameters.yaml').write_text('a: <b>\n')
