"""The report of a run, and the animation in it, in a real browser."""

from contextlib import closing
import json
import re

from browser import browser
from lowsnr_bringup.run.results_folder import Account
from lowsnr_common.core.frame_map import FrameMap
from lowsnr_common.core.records import Estimate
from lowsnr_common.core.records import Truth
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_common.settings.node_settings import RunSettings
from lowsnr_eval.report.run_report import write_run_report
from lowsnr_eval.scoring import scene as scene_module
from lowsnr_eval.scoring.final_summary import summarize
from lowsnr_eval.scoring.final_summary import write_summary
from lowsnr_eval.scoring.frame_scoring import Answer
from lowsnr_eval.scoring.frame_scoring import score_frame
from lowsnr_eval.scoring.scene import read_scene
from lowsnr_eval.scoring.scene import SceneWriter
from lowsnr_eval.scoring.score_tables import ScoreTables
import numpy as np
import pytest

FRAMES, SHAPE = 8, (7, 5)
NUMBER = "document.getElementById('number').textContent"
# The colour of the middle of the first cell.
FIRST_CELL = """Array.from(document.getElementById('view').getContext('2d')
    .getImageData(5, 5, 1, 1).data).join()"""


def tracked(x, y, name=''):
    return Estimate(np.array([x, 0.5, y, 0.0]), np.eye(4), 0.9, name)


def score(folder, frames):
    """Score frames of (truth, answer) as the evaluator does."""
    with closing(ScoreTables(folder, ['sdt'])) as tables:
        for k, (truth, answer) in enumerate(frames, start=1):
            answers = {'sdt': answer}
            tables.add(score_frame(k, float(k), truth, answers, Evaluation()), answers)
    write_summary(folder, summarize(
        folder, RunSettings(scenario='made up'), Evaluation(), 0, Account()))


@pytest.fixture
def folder(tmp_path, rng):
    """Return the results of a run of one object, seen from frame 3 on."""
    frames = []
    with closing(SceneWriter(tmp_path, 1.0)) as scene:
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
    score(tmp_path, frames)
    (tmp_path / 'parameters.yaml').write_text('a: <b>\n')
    return tmp_path


def test_scene_is_read_back(folder):
    lines, frames, _ = read_scene(folder)
    assert [line['frame'] for line in lines] == list(range(1, FRAMES + 1))
    assert lines[4]['truth'] == [[2.5, 3.0, '</script>']]
    assert lines[5]['chains']['sdt']['tracks'] == [[3.0, 3.1, '4']]
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
    monkeypatch.setattr(scene_module, '_MOST_CELLS', 20)
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


def test_animation_steps_in_a_browser_and_asks_for_nothing(folder, tmp_path, require_program):
    report = write_run_report(folder, 'again')
    with browser(require_program('chromium'), tmp_path / 'profile') as page:
        page.load(report)
        assert page.value(NUMBER) == 'frame 1: 0 objects, 0 detections, 0 tracks'
        assert page.value(FIRST_CELL) == '0,0,0,255'
        page.click('#forward')
        assert page.value(NUMBER) == 'frame 2: 0 objects, 0 detections, 0 tracks'
        assert page.value(FIRST_CELL) == '255,255,255,255'
        page.press('ArrowRight')
        assert page.value(NUMBER) == 'frame 3: 1 object, 0 detections, 0 tracks'
        page.click('#back')
        assert page.value(NUMBER).startswith('frame 2:')
        page.click('#slider')
        assert page.value(NUMBER).startswith(('frame 4:', 'frame 5:'))
        page.value("document.getElementById('slider').value = 7, "
                   "document.getElementById('slider').dispatchEvent(new Event('input'))")
        page.value('document.activeElement.blur()')
        page.press('ArrowRight')  # there is nothing after the last
        assert page.value(NUMBER) == 'frame 8: 1 object, 1 detection, 1 track'
        page.screenshot(tmp_path / 'seen.png')
        assert page.value('Array.from(document.images).map(i => i.naturalWidth > 0)') == [True]
        asked = [address for address in page.requests if not address.startswith('data:')]
        assert (asked, page.errors) == ([report.as_uri()], [])


def test_animation_of_frames_that_are_missing_or_change_their_size(tmp_path, require_program):
    with closing(SceneWriter(tmp_path, 1.0)) as scene:
        for k, shape in enumerate((None, SHAPE, None, (14, 10)), start=1):
            if shape:
                scene.add_frame(k, np.zeros(shape))
            scene.add_answers(k, k, [], {'b': Answer([tracked(1.0, 2.0)], []), 'a': Answer()})
    score(tmp_path, [([], Answer([], []))] * 4)
    report = write_run_report(tmp_path, 'again')
    with browser(require_program('chromium'), tmp_path / 'profile') as page:
        page.load(report)
        nothing, size = 'objects, 0 detections, 0 tracks', '[view.width, view.height]'
        assert page.value(NUMBER) == f'frame 1 (missing): 0 {nothing}'
        assert page.value(size) == [500, 700]
        page.value("get('chain').value = 'b', get('chain').dispatchEvent(new Event('change'))")
        assert page.value(NUMBER) == 'frame 1 (missing): 0 objects, 1 detection, 0 tracks'
        for expected in ('frame 2:', 'frame 3 (missing):', 'frame 4:'):
            page.click('#forward')
            assert page.value(NUMBER).startswith(expected)
        assert page.value(size) == [500, 700]
        assert page.errors == []


def test_conditioned_picture_is_beside_the_raw_one_at_the_same_place(tmp_path, require_program):
    """One bright pixel (4, 2) of a frame whose cells of 2 x 2 pixels moved by two pixels."""
    frame, cells = np.zeros((8, 10)), np.zeros((4, 5))
    frame[2, 4], cells[1, 3] = 1.0, 1.0  # the cell covers x from 4 to 6, y from 2 to 4
    where = FrameMap('camera', (10, 8), 2, (0, 0), (-2.0, 0.0))
    with closing(SceneWriter(tmp_path, 1.0, conditioned=True)) as scene:
        scene.add_frame(1, frame)
        scene.add_cells(1, cells, where)
        scene.add_answers(1, 1, [], {'sdt': Answer([], [])})
    score(tmp_path, [([], Answer([], []))])
    report = write_run_report(tmp_path, 'again')
    grey = """Array.from(document.getElementById('{}').getContext('2d')
        .getImageData({} * 70 + 35, {} * 70 + 35, 1, 1).data)[0]"""
    with browser(require_program('chromium'), tmp_path / 'profile') as page:
        page.load(report)
        assert page.value("[get('cells').width, get('cells').height]") == [700, 560]
        for view, bright in (('view', {(4, 2)}), ('cells', {(4, 2), (5, 2), (4, 3), (5, 3)})):
            assert {(x, y) for x in range(8) for y in range(8)
                    if page.value(grey.format(view, x, y)) == 255} == bright
        assert page.value(grey.format('cells', 9, 0)) == 255  # no cell covers it: white
        assert page.errors == []
