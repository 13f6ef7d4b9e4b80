# SPDX-License-Identifier: Apache-2.0
"""The main job on the real graph: exit codes, scores, and the same results every time."""

import re

from graph_runs import own_domain
from graph_runs import ROOT
from graph_runs import start_bringup
import lowsnr_detect.detectors  # noqa: F401  (its files register themselves)
from lowsnr_detect.parts.registry import DETECTORS
import pytest

FRAMES = 40


@pytest.fixture(scope='module')
def twice(tmp_path_factory):
    """Return the first of two runs of the same command, what each printed, and its summaries."""
    folder = tmp_path_factory.mktemp('twice') / 'run'
    summary, printed, kept = folder / 'summary.json', [], []
    for _ in range(2):
        with start_bringup(
                folder, '--detector', 'sdt', '--lockstep', domain_id=own_domain()) as run:
            code, out, err = run.finish()
            assert code == 0, err
            run.wait_until_none_is_left()
        printed.append((out, err))
        kept.append((summary.read_bytes(), summary.stat().st_mtime_ns))
    return run, printed, kept


def test_one_detector_scores_every_frame(twice):
    run, ((out, err), _), _ = twice
    summary = run.summary()
    assert summary['frames'] == {
        'expected': FRAMES, 'published': FRAMES, 'scored': FRAMES, 'unanswered': 0, 'unseen': 0,
        'lost': 0}
    assert summary['detectors']['sdt']['operating_point'] == 'matched'
    words = out.split()
    assert {'sdt', 'detection', 'tracking', str(FRAMES)} <= set(words)
    assert 'Traceback' not in out + err


@pytest.mark.parametrize('page', ['README.md', 'docs/start.md'])
def test_table_is_the_one_that_is_shown(twice, page):
    _, ((out, _), _), _ = twice
    text = (ROOT / page).read_text(encoding='utf-8')
    shown = re.search(r'^example4, seed 0.*?by the detector -$', text, re.DOTALL | re.MULTILINE)
    assert shown[0] in out, 'python benchmarks/readme.py writes it again'


def test_lockstep_with_a_seed_gives_the_same_bytes_twice(twice):
    run, _, _ = twice
    first, second = ((run.results.parent / name / 'frames.csv').read_bytes()
                     for name in ('run', 'run-2'))
    assert first == second
    assert first.count(b'\n') == 1 + 2 * FRAMES


def test_earlier_results_are_kept(twice):
    run, (_, (out, _)), kept = twice
    assert kept[1] == kept[0]
    assert f'{run.results}-2' in out


def test_detectors_side_by_side_see_the_same_frames(bringup):
    run = bringup(
        '--detector', 'cdt', 'sdt', '--lockstep', '--set', 'sdt.max_iterations=1',
        '--set', 'cdt.operating_point=manual', '--set', 'sdt.operating_point=manual',
        '--set', 'cdt.threshold=1.0', '--set', 'sdt.threshold=1.0',
        '--set', 'cdt.thinning_reach=2', '--set', 'sdt.thinning_reach=2')
    code, _, err = run.finish()
    assert code == 0, err
    # SDT of one iteration is CDT, so on the same frames it declares the same.
    table = [row.split(',') for row in run.rows()]
    cdt, sdt = ([row[4:8] for row in table if row[2:4] == [name, 'detection']]
                for name in ('cdt', 'sdt'))
    assert len(cdt) == FRAMES
    assert sum(int(row[1]) for row in cdt) > FRAMES
    assert cdt == sdt
    assert sorted(run.summary()['detectors']) == ['cdt', 'sdt']


def test_all_detectors_run_side_by_side(bringup):
    names = sorted(DETECTORS)
    # At the nominal thresholds, because calibrating all detectors takes minutes.
    settings = [f'{name}.operating_point=nominal' for name in names]
    run = bringup('--detector', *names, '--lockstep', '--frames', '12', '--snr', '12',
                  *(word for text in settings for word in ('--set', text)))
    code, out, err = run.finish(within_s=600.0)
    assert code == 0, err
    summary = run.summary()
    assert summary['frames'] == {
        'expected': 12, 'published': 12, 'scored': 12, 'unanswered': 0, 'unseen': 0, 'lost': 0}
    for name in names:
        levels = summary['detectors'][name]
        assert levels['detection']['unanswered'] == levels['tracking']['unanswered'] == 0
        assert levels['detection']['hits'] > 0
        # Detectors that estimate a whole state are scored for its velocity too.
        whole = 'tbd' in name or name in ('bernoulli', 'hmm', 'pmf')
        assert (levels['detection']['rmse_velocity_mps'] is not None) == whole
        assert name in out.split()
