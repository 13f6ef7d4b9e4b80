"""A run of the node graph gives the detections and tracks that the cores give."""

from pathlib import Path

from lowsnr_bringup.plan import graph
from lowsnr_bringup.plan.run_options import RunOptions
from lowsnr_bringup.plan.run_plan import plan_run
from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_eval.study.experiment import Block
from lowsnr_eval.study.experiment import run_block
from lowsnr_eval.study.offline_chain import Chain
from lowsnr_sensor.scenario import load_scenario
from lowsnr_track.pda_mmpf import PdaMmpf
import pytest

CONFIG = Path(__file__).resolve().parents[2] / 'config'
SEED, SNR_DB = 5, 9.0
DETECTORS = ('sdt', 'mmtbd2')
MANUAL = tuple(f'{name}.operating_point=manual' for name in DETECTORS) + (
    'sdt.threshold=12.0', 'mmtbd2.threshold=0.5', 'mmtbd2.particles=800')


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


def test_graph_run_and_core_run_of_a_seed_are_the_same(bringup):
    run = bringup(
        '--detector', *DETECTORS, '--scenario', 'example3', '--snr', str(SNR_DB),
        '--seed', str(SEED), '--lockstep', *(word for text in MANUAL for word in ('--set', text)))
    code, _, err = run.finish()
    assert code == 0, err
    graph_rows = {}
    for line in run.rows():
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
