# SPDX-License-Identifier: Apache-2.0
"""The report of a run: what it holds, and what it leaves out."""

from contextlib import closing
import json
import os
import re
import subprocess

from lowsnr_common.core.records import Truth
from lowsnr_eval.report import animation as animation_module
from lowsnr_eval.report import software as software_module
from lowsnr_eval.report.run_report import write_run_report
from lowsnr_eval.report.software import software
from lowsnr_eval.scene import scene_files
from lowsnr_eval.scene.scene_files import read_scene
from lowsnr_eval.scene.scene_writer import SceneWriter
from lowsnr_eval.scoring.frame_scoring import Answer
import numpy as np
import pytest
from report_runs import FRAMES
from report_runs import score
from report_runs import SHAPE
from report_runs import tracked
from report_runs import write_run


@pytest.fixture
def folder(tmp_path, rng):
    """Return the results of a run of one object, seen from frame 3 on."""
    write_run(tmp_path, rng)
    return tmp_path


def test_scene_is_read_back(folder):
    lines, frames, *_ = read_scene(folder)
    assert [line['frame'] for line in lines] == list(range(1, FRAMES + 1))
    assert lines[4]['truth'] == [[2.5, 3.0, '</script>']]
    assert lines[5]['chains']['sdt']['tracks'] == [[3.0, 3.1, '4', 0.9, 1.0, 0.0, 1.0]]
    assert all(frame.shape == SHAPE for frame in frames)
    assert frames[1][0, 0] == 9.0


def test_line_cut_off_by_a_crash_is_left_out(folder):
    whole = (folder / 'scene.jsonl').read_text()
    (folder / 'scene.jsonl').write_text(whole[:-20])
    assert len(read_scene(folder)[0]) == FRAMES - 1
    assert '<canvas' in write_run_report(folder, 'again').read_text()


def test_report_holds_command_parameters_and_figures(folder):
    report = write_run_report(folder, 'python scripts/bringup.py --seed 3').read_text()
    assert 'bringup.py --seed 3' in report
    assert 'a: &lt;b&gt;' in report
    assert 'GOSPA' in report
    assert 'http' not in report.replace('http-equiv', '')
    # Nothing of the run ends the element that holds its data.
    data = re.search(r'id="scene">(.*?)</script>', report, re.DOTALL)[1]
    assert json.loads(data)['lines'][4]['truth'][0][2] == '</script>'


def test_report_states_what_it_leaves_out(tmp_path, monkeypatch):
    monkeypatch.setattr(scene_files, '_MOST_CELLS', 20)
    with closing(SceneWriter(tmp_path, 1.0)) as scene:
        scene.add_frame(1, np.zeros(SHAPE))
        scene.add_answers(1, 1, [], {})
    score(tmp_path, [([], Answer([], []))] * 3)
    report = write_run_report(tmp_path, 'again').read_text()
    assert ' 1 of 3 frames' in report
    assert ' 2 x 2 cells' in report


def test_report_without_a_scene_has_no_animation(folder):
    (folder / 'scene.jsonl').unlink()
    report = write_run_report(folder, 'again').read_text()
    assert '<canvas' not in report
    assert '<figure' in report


def test_report_of_a_run_that_scored_nothing(tmp_path):
    score(tmp_path, [])
    report = write_run_report(tmp_path, 'again').read_text()
    assert 'GOSPA' in report
    assert '<figure' not in report


def test_report_of_a_long_run_is_small(tmp_path):
    truth = [Truth('1', np.array([1.0, 0.0, 2.0, 0.0]))]
    answer = Answer([tracked(1.0, 2.2)], [])
    score(tmp_path, [(truth, answer), ([], answer), ([], Answer())] * 1000)
    report = write_run_report(tmp_path, 'again')
    assert ' 12 frames' in report.read_text()
    assert report.stat().st_size < 2e6


def test_report_that_cannot_hold_all_frames_begins_before_the_first_object(
    tmp_path, monkeypatch,
):
    monkeypatch.setattr(animation_module, '_MOST_CELLS', 60 * SHAPE[0] * SHAPE[1])
    frames = []
    with closing(SceneWriter(tmp_path, 1.0)) as scene:
        for k in range(1, 201):
            truth = [Truth('1', np.array([1.0, 0.0, 2.0, 0.0]))] if k > 100 else []
            scene.add_frame(k, np.zeros(SHAPE))
            scene.add_answers(k, k, truth, {'sdt': Answer([], [])})
            frames.append((truth, Answer([], [])))
    score(tmp_path, frames)
    report = write_run_report(tmp_path, 'again').read_text()
    data = json.loads(re.search(r'id="scene">(.*?)</script>', report, re.DOTALL)[1])
    assert [line['frame'] for line in data['lines']] == list(range(81, 141))
    assert data['lines'][-1]['place'] == 59 * SHAPE[0] * SHAPE[1]
    assert ' 60 of 200 frames, 81 to 140' in report


def test_report_of_ten_thousand_frames_holds_them_all_in_15_mb(tmp_path, rng):
    truth = [Truth('1', np.array([1.0, 0.0, 2.0, 0.0]))]
    answer = Answer([tracked(1.0, 2.2)], [tracked(1.1, 2.1, '1')])
    with closing(SceneWriter(tmp_path, 1.0)) as scene:
        for k in range(1, 10_001):
            scene.add_frame(k, rng.standard_normal((20, 20)))
            scene.add_answers(k, k, truth, {'sdt': answer})
    score(tmp_path, [(truth, answer)] * 10)
    report = write_run_report(tmp_path, 'again')
    assert report.stat().st_size < 15e6
    assert '"frame": 10000' in report.read_text()


def test_title_says_what_was_looked_at_and_with_what(folder):
    (folder / 'parameters.yaml').write_text('/sensor:\n  ros__parameters: {}\n')
    assert '<h1>made up, SNR 6 dB: sdt</h1>' in write_run_report(folder, 'again').read_text()
    (folder / 'parameters.yaml').unlink()
    page = write_run_report(folder, 'again').read_text()
    assert '<h1>made up, expected SNR 6 dB: sdt</h1>' in page


def test_software_names_the_checkout_ros_and_the_middleware(monkeypatch):
    monkeypatch.delenv('RMW_IMPLEMENTATION', raising=False)
    found = dict(software())
    assert re.fullmatch(r'\d+\.\d+\.\d+ commit [0-9a-f]{12}(, changed)?', found['lowsnr'])
    assert re.fullmatch(r'\d+\.\d+\.\d+', found['middleware rmw_fastrtps_cpp'])
    assert any(name.startswith('ROS 2 jazzy') for name in found)


def test_commit_is_read_without_writing_into_the_checkout(tmp_path, monkeypatch):
    def git(*arguments):
        subprocess.run(
            ['git', '-C', str(tmp_path), '-c', 'user.name=a', '-c', 'user.email=a@example.org',
             *arguments], check=True, capture_output=True)

    source, index = tmp_path / 'software.py', tmp_path / '.git' / 'index'
    source.write_text('1\n')
    git('init')
    git('add', '.')
    git('commit', '-m', 'a')
    os.utime(source, (1.0, 1.0))  # a status that may lock the index writes this time into it
    before = index.read_bytes()
    monkeypatch.setattr(software_module, '__file__', str(source))
    assert re.fullmatch(r'\d+\.\d+\.\d+ commit [0-9a-f]{12}', dict(software())['lowsnr'])
    assert index.read_bytes() == before
