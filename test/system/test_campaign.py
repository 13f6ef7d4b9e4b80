# SPDX-License-Identifier: Apache-2.0
"""A short campaign of faults against one run: every frame is accounted for."""

import signal

from campaign import Campaign
from campaign import KINDS
from graph_client import GraphClient
from graph_runs import own_domain
import numpy as np
from run_checks import check_end

# Those have tests of their own: test_hangs, test_hostile_input, test_time_jumps.
ELSEWHERE = {'hung', 'garbage', 'forged', 'clock'}
# After this time the evaluator gives a frame up.
WITHIN_S = 1.0


def test_every_frame_of_a_campaign_is_accounted_for(bringup):
    rng = np.random.default_rng(8)
    run = bringup('--detector', 'cdt', '--scenario', 'example3', '--loop', '--lockstep',
                  '--set', f'evaluator.answer_within_s={WITHIN_S}')
    run.wait_for_rows(100)
    with GraphClient(own_domain()) as client:
        campaign = Campaign(run, client, 'cdt', rng, most_stopped_s=1.0)
        for kind in rng.permutation([kind for kind in KINDS if kind not in ELSEWHERE]):
            campaign.inject(str(kind))
    assert not campaign.late
    run.process.send_signal(signal.SIGINT)
    check_end(run, 130)
    assert campaign.recovered_s.keys() == set(KINDS) - ELSEWHERE
    frames = run.summary()['frames']
    lost = frames.get('lost', 0)
    assert frames['published'] == (
        frames['scored'] + frames['unanswered'] + frames['unseen'] + lost)
    assert len(run.rows()) == 2 * (frames['scored'] + frames['unanswered'])
    assert lost == 0
    # In lockstep a fault costs the frames in hand, a flood those that it pushes out, and what
    # keeps nodes away, longer on a busy machine, one frame each `WITHIN_S`.
    away_s = sum(map(sum, campaign.recovered_s.values())) + sum(
        float(row['down_s']) for row in run.restarts())
    assert frames['unanswered'] + frames['unseen'] <= (
        2 * len(campaign.recovered_s) + 1 + away_s / WITHIN_S)
    assert frames['scored'] > 100
