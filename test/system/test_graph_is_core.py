# SPDX-License-Identifier: Apache-2.0
"""A run of the node graph, and its replay, give the detections and tracks that the cores give."""

from contextlib import closing
import csv
from dataclasses import replace
import json
from pathlib import Path
import statistics

from graph_runs import own_domain
from graph_runs import start_bringup
from lowsnr_bringup.bags.reader import Bag
from lowsnr_bringup.plan import graph
from lowsnr_bringup.plan.config_files import load_config
from lowsnr_bringup.plan.run_options import RunOptions
from lowsnr_bringup.plan.run_plan import plan_run
from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_eval.ros.recorded_messages import score_bag
from lowsnr_eval.scoring.recorded_chains import find_chains
from lowsnr_eval.scoring.run_scoring import RunScorer
from lowsnr_eval.study.experiment import Block
from lowsnr_eval.study.experiment import run_block
from lowsnr_eval.study.offline_chain import Chain
from lowsnr_sensor.scenario import load_scenario
from lowsnr_track.pda_mmpf import PdaMmpf
import pytest

CONFIG = Path(__file__).resolve().parents[2] / 'config'
SEED, SNR_DB = 5, 9.0
DETECTORS = ('sdt', 'mmtbd2', 'hmm')
LAG = 3
MANUAL = tuple(f'{name}.operating_point=manual' for name in DETECTORS) + (
    'sdt.threshold=12.0', 'mmtbd2.threshold=0.5', 'mmtbd2.particles=800', 'hmm.threshold=1.0',
    f'hmm.lag={LAG}')
SET = [word for text in MANUAL for word in ('--set', text)]


def core_rows():
    """Return the rows of ``frames.csv`` as one experiment of one run gives them."""
    plan = plan_run(RunOptions(
        detectors=DETECTORS, scenario='example3', snr_db=SNR_DB, overrides=MANUAL), CONFIG)
    chains = tuple(
        Chain(name, 'manual', plan.detectors[f'/{name}/{name}_detector'],
              graph.build(PdaMmpf, plan.parameters[f'/{name}/tracker'], name), 1)
        for name in DETECTORS)
    results = run_block(Block(
        load_scenario(CONFIG / 'scenarios' / 'example3.yaml'), SensorModel(snr_db=SNR_DB),
        Evaluation(), chains, SEED, 0, 1, 1))
    rows = []
    for name in DETECTORS:
        result = results[name, 'manual']
        for level, scores in (('detection', result.detection), ('tracking', result.tracking)):
            for k in range(40):
                errors = (scores.position_error_m, scores.velocity_error_mps, scores.gospa_m)
                rows.append([
                    str(k + 1), name, level, str(int(scores.present[0, k])),
                    str(scores.declared[0, k]), str(int(scores.hit[0, k])),
                    str(scores.false_alarms[0, k]), *(value[0, k] for value in errors)])
    return rows


@pytest.fixture(scope='module')
def recorded(tmp_path_factory):
    """Return the results of a run, and its bag."""
    folder = tmp_path_factory.mktemp('recorded')
    with start_bringup(
            folder / 'run', '--detector', *DETECTORS, '--scenario', 'example3', '--snr',
            str(SNR_DB), '--seed', str(SEED), '--lockstep', *SET, '--record', str(folder / 'bag'),
            domain_id=own_domain()) as run:
        code, _, err = run.finish()
        assert code == 0, err
    return folder / 'run', folder / 'bag'


def table(folder):
    """Return the lines of ``frames.csv``."""
    return (folder / 'frames.csv').read_text().splitlines()[1:]


def test_graph_run_and_core_run_of_a_seed_are_the_same(recorded):
    graph_rows = {}
    for line in table(recorded[0]):
        frame, _, *cells = line.split(',')
        graph_rows[(int(frame), *cells[:2])] = cells[2:]
    hits = 0
    for frame, name, level, *expected in core_rows():
        found = graph_rows.pop((int(frame), name, level))
        assert found[:4] == expected[:4], (frame, name, level)
        hits += int(found[2])
        for one, other in zip(found[4:], expected[4:]):
            # frames.csv has nine digits.
            assert float(one or 'nan') == pytest.approx(other, rel=1e-8, nan_ok=True)
    assert not graph_rows
    assert hits > 40


def test_every_frame_is_answered_and_the_summary_states_the_lag(recorded):
    summary = json.loads((recorded[0] / 'summary.json').read_text())
    assert summary['frames'] == {
        'expected': 40, 'published': 40, 'scored': 40, 'unanswered': 0, 'unseen': 0, 'lost': 0}
    assert [each['lag_frames'] for each in summary['detectors'].values()] == [0, 0, LAG]
    late, soon = (summary['detectors'][name]['detection_latency_ms']['median']
                  for name in ('hmm', 'sdt'))
    assert late > soon


def test_replay_of_late_answers_gives_the_same_bytes(recorded, bringup):
    folder, bag = recorded
    run = bringup('--replay', str(bag), '--detector', *DETECTORS, '--seed', str(SEED),
                  '--snr', str(SNR_DB), '--lockstep', *SET)
    code, _, err = run.finish()
    assert code == 0, err
    for name in ('frames.csv', 'detections.csv', 'tracks.csv'):
        assert (run.results / name).read_bytes() == (folder / name).read_bytes()


def test_bag_with_late_answers_is_scored_as_the_run_was(recorded, tmp_path):
    folder, path = recorded
    with Bag(path) as bag:
        chains = find_chains(bag, load_config(CONFIG))
        assert chains.run.lags == (0, 0, LAG)
        with closing(RunScorer(
                replace(chains.run, results=str(tmp_path)), chains.evaluation, print)) as scorer:
            score_bag(bag, chains, scorer)
    assert (tmp_path / 'frames.csv').read_bytes() == (folder / 'frames.csv').read_bytes()


def test_without_truth_latencies_in_a_bag_begin_with_the_frames(recorded, tmp_path):
    with Bag(recorded[1]) as bag:
        chains = find_chains(bag, load_config(CONFIG))
        run = replace(chains.run, results=str(tmp_path), truth=False)
        with closing(RunScorer(run, chains.evaluation, print)) as scorer:
            score_bag(bag, chains, scorer)
    spent = {name: [] for name in DETECTORS}
    with (tmp_path / 'latency.csv').open(newline='') as file:
        for row in csv.DictReader(file):
            spent[row['detector']].append(float(row['detection_ms']))
    assert [len(each) for each in spent.values()] == [40, 40, 40]
    assert all(min(each) > 0.0 for each in spent.values())
    assert statistics.median(spent['hmm']) > statistics.median(spent['sdt'])
