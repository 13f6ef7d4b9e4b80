"""What a run leaves when its evaluator could not sum up: all that it had scored."""

import json

from lowsnr_bringup.run.results_folder import Account
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_common.settings.node_settings import RunSettings
from lowsnr_eval.scoring.final_summary import sum_up
from lowsnr_eval.scoring.run_scoring import Judge
from lowsnr_eval.scoring.run_scoring import TRUTH
import pytest

SECOND = 1_000_000_000


def scored_run(folder, settled, scored):
    """Score frames, and sum up no more than the first of them."""
    judge = Judge(RunSettings(results=str(folder), scenario='s'), Evaluation(), 4, print)
    for k in range(1, scored + 1):
        for topic in (TRUTH, 'detections', 'tracks'):
            judge.add_array(topic, k * SECOND, [], float(k))
        judge.score()
        if k == settled:
            judge.settle()
    judge.__exit__(None, None, None)


@pytest.mark.parametrize(('summed_up', 'scored'), [(False, 5), (True, 3)])
def test_summary_has_all_that_was_scored(tmp_path, summed_up, scored):
    scored_run(tmp_path, settled=3, scored=5)
    sum_up({'results': str(tmp_path), 'scenario': 's', 'seed': 4},
           Account(8, {'evaluator': 1}, summed_up))
    summary = json.loads((tmp_path / 'summary.json').read_text())
    assert summary['frames'] == {
        'published': 8, 'scored': scored, 'unanswered': 0, 'unseen': 8 - scored}
    assert (summary['scenario'], summary['seed']) == ('s', 4)
    assert summary['restarts'] == {'evaluator': 1}
    assert summary['detectors']['sdt']['operating_point'] == 'matched'


def test_nothing_scored_leaves_nothing(tmp_path):
    (tmp_path / 'frames.csv').touch()
    sum_up({'results': str(tmp_path)}, Account())
    assert [path.name for path in tmp_path.iterdir()] == ['frames.csv']
