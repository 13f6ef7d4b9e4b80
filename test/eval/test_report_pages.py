# SPDX-License-Identifier: Apache-2.0
"""The pictures of a report in a real browser: steps, zoom, places and colours."""

from contextlib import closing

from browser import browser
from lowsnr_common.core.frame_map import FrameMap
from lowsnr_common.core.records import Truth
from lowsnr_eval.report.palette import IDENTITIES
from lowsnr_eval.report.palette import rgb
from lowsnr_eval.report.run_report import write_run_report
from lowsnr_eval.scene.scene_writer import SceneWriter
from lowsnr_eval.scoring.frame_scoring import Answer
import numpy as np
import pytest
from report_runs import score
from report_runs import SHAPE
from report_runs import tracked
from report_runs import write_run

NUMBER = "document.getElementById('number').textContent"
# The grey of a view at a place in the frame.
GREY = """(() => {{ const {{pen, X, Y, ratio}} = plots.{}, [x, y] = [{}, {}];
    return pen.getImageData(X(x) * ratio, Y(y) * ratio, 1, 1).data[0]; }})()"""
COLOUR = """(() => {{ const {{pen, X, Y, ratio}} = plots.statistic, [x, y] = [{}, {}];
    return [...pen.getImageData(X(x) * ratio, Y(y) * ratio, 1, 1).data.slice(0, 3)]; }})()"""
FIRST_CELL = GREY.format('view', 0, 0)


def pinch(page, selector, before, after):
    """Move two fingers on an element, from one distance between them to another [CSS pixels]."""
    x, y = page.value(f"""(() => {{
        const element = document.querySelector('{selector}');
        element.scrollIntoView();
        const box = element.getBoundingClientRect();
        return [box.x + box.width / 2, box.y + box.height / 2]; }})()""")
    moves = np.linspace(before, after, 5)
    for kind, distances in (('touchStart', moves[:1]), ('touchMove', moves)):
        for distance in distances:
            page.call('Input.dispatchTouchEvent', type=kind, touchPoints=[
                {'x': x + side * distance / 2, 'y': y, 'id': n}
                for n, side in enumerate((-1, 1))])
    page.call('Input.dispatchTouchEvent', type='touchEnd', touchPoints=[])


@pytest.fixture
def folder(tmp_path, rng):
    """Return the results of a run of one object, seen from frame 3 on."""
    write_run(tmp_path, rng)
    return tmp_path


def test_animation_steps_in_a_browser_and_asks_for_nothing(folder, tmp_path, chromium):
    report = write_run_report(folder, 'again')
    with browser(chromium, tmp_path / 'profile') as page:
        page.load(report)
        # It opens on the first frame whose object is tracked.
        assert page.value(NUMBER) == 'frame 6: 1 object, 1 detection, 1 track'
        assert page.value("lines[3].chains.sdt.tracks = [[0, 6, 'false', .9]], opening()") == 5
        page.value('lines[3].chains.sdt.tracks = [], redraw(), document.activeElement.blur()')
        page.press('Home')
        assert page.value(NUMBER) == 'frame 1: 0 objects, 0 detections, 0 tracks'
        assert page.value(FIRST_CELL) == 0
        page.click('#forward')
        assert page.value(NUMBER) == 'frame 2: 0 objects, 0 detections, 0 tracks'
        assert page.value(FIRST_CELL) == 255
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


def test_animation_of_frames_that_are_missing_or_change_their_size(tmp_path, chromium):
    with closing(SceneWriter(tmp_path, 1.0)) as scene:
        for k, shape in enumerate((None, SHAPE, None, (14, 10)), start=1):
            if shape:
                scene.add_frame(k, np.zeros(shape))
            scene.add_answers(k, k, [], {'b': Answer([tracked(1.0, 2.0)], []), 'a': Answer()})
    score(tmp_path, [([], Answer([], []))] * 4)
    report = write_run_report(tmp_path, 'again')
    with browser(chromium, tmp_path / 'profile') as page:
        page.load(report)
        size = '[whole.x, whole.y]'
        assert page.value(NUMBER) == 'frame 1 (missing): 0 objects, 1 detection, 0 tracks'
        assert page.value(size) == [[-0.5, 4.5], [6.5, -0.5]]
        page.value("get('chain').value = 'a', get('chain').dispatchEvent(new Event('change'))")
        assert page.value(NUMBER) == 'frame 1 (missing): 0 objects, 0 detections, 0 tracks'
        for expected in ('frame 2:', 'frame 3 (missing):', 'frame 4:'):
            page.click('#forward')
            assert page.value(NUMBER).startswith(expected)
        assert page.value(size) == [[-0.5, 9.5], [13.5, -0.5]]
        assert page.errors == []


def test_conditioned_picture_is_beside_the_raw_one_at_the_same_place(tmp_path, chromium):
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
    with browser(chromium, tmp_path / 'profile') as page:
        page.load(report)
        for view, bright in (('view', {(4, 2)}), ('cells', {(4, 2), (5, 2), (4, 3), (5, 3)})):
            assert {(x, y) for x in range(8) for y in range(8)
                    if page.value(GREY.format(view, x, y)) == 255} == bright
        assert page.value(GREY.format('cells', 9, 0)) == 255  # no cell covers it: white
        assert page.errors == []


def test_statistic_is_beside_the_frame_in_colours_of_both_sides_of_the_threshold(
        tmp_path, chromium):
    """One cell (4, 2) is above the threshold, and one (1, 5) has no statistic."""
    excess = np.full((8, 10), -3.0)
    excess[2, 4], excess[5, 1] = 6.0, np.nan
    with closing(SceneWriter(tmp_path, 1.0, statistics=['sdt'])) as scene:
        scene.add_frame(1, np.zeros((8, 10)))
        scene.add_statistic('sdt', 1, excess)
        scene.add_answers(1, 1, [], {'sdt': Answer([], []), 'cdt': Answer([], [])})
    score(tmp_path, [([], Answer([], []))])
    report = write_run_report(tmp_path, 'again')
    with browser(chromium, tmp_path / 'profile') as page:
        page.load(report)
        below, above, none = (page.value(COLOUR.format(*at)) for at in ((0, 0), (4, 2), (1, 5)))
        assert (above, none) == ([190, 10, 20], [0, 0, 0])
        assert below[2] > below[0]
        assert page.value("getComputedStyle(get('tested')).display") != 'none'
        page.value("get('chain').value = 'cdt', get('chain').dispatchEvent(new Event('change'))")
        assert page.value("getComputedStyle(get('tested')).display") == 'none'
        assert page.errors == []


@pytest.fixture
def crossing(tmp_path):
    """Return the report of two objects that pass each other, whose tracks swap in frame 5 of 8."""
    with closing(SceneWriter(tmp_path, 1.0)) as scene:
        for k in range(1, 9):
            places = {'a': (k, 2.0), 'b': (9.0 - k, 6.0)}
            truth = [Truth(name, np.array([x, 1.0, y, 0.0])) for name, (x, y) in places.items()]
            on = dict(zip(places, ('1', '2') if k < 5 else ('2', '1')))
            tracks = [tracked(*places[name], on[name]) for name in places]
            scene.add_frame(k, np.zeros((10, 10)))
            scene.add_answers(k, k, truth, {'sdt': Answer([], tracks)})
    score(tmp_path, [([], Answer([], []))])
    return write_run_report(tmp_path, 'again')


@pytest.fixture
def phone(crossing, tmp_path, chromium):
    """Return a browser of 400 pixels and two fingers that shows the crossing."""
    with browser(chromium, tmp_path / 'profile') as page:
        page.call('Emulation.setDeviceMetricsOverride', width=400, height=800,
                  deviceScaleFactor=1, mobile=True)
        page.call('Emulation.setTouchEmulationEnabled', enabled=True, maxTouchPoints=2)
        page.load(crossing)
        yield page
        assert page.errors == []


def test_identities_of_a_crossing_and_the_zoom_at_400_pixels(phone):
    ink = """(() => {{ const {{pen, X, Y, ratio}} = plots.identities;
        return Array.from(pen.getImageData(
            X({}) * ratio, Y({}) * ratio, 1, 1).data.slice(0, 3)); }})()"""
    first, second = [list(rgb(colour)) for colour in IDENTITIES[:2]]
    for row, (before, after) in enumerate([(first, second), (second, first)]):
        for k in range(1, 9):
            assert phone.value(ink.format(k, row + 0.5)) == (before if k < 5 else after)
        # A line begins an identity, whose colour may be that of the one before.
        for k in (1, 5):
            assert phone.value(ink.format(k - 0.5, row + 0.2)) == [0x1b, 0x1b, 0x1b]
        assert phone.value(ink.format(2, row + 0.3)) == before
    assert phone.value('document.documentElement.scrollWidth') == 400
    phone.press('+')
    assert phone.value('plots.view.x') == pytest.approx([4.5 - 5 / 1.5, 4.5 + 5 / 1.5])
    phone.press('0')
    assert phone.value('plots.view.x') == [-0.5, 9.5]
    phone.press('End')
    assert phone.value(NUMBER).startswith('frame 8:')


def test_zoom_by_two_fingers_and_its_end(phone):
    pinch(phone, '#view', 40, 80)
    left, right = phone.value('plots.view.x')
    assert right - left == pytest.approx(10 / 2, rel=0.01)
    pinch(phone, '#view', 80, 40)
    assert phone.value('plots.view.x') == [-0.5, 9.5]
    phone.value('for (let n = 0; n < 100; n++) zoom(1.5)')
    left, right = phone.value('plots.view.x')
    assert 0.25 <= right - left < 0.25 * 1.5
    assert phone.value('ticks([2 ** 53, 2 ** 53 + 8], 900, 55).length') <= 100
    assert phone.value('ticks([-0.5, 9.5], 275, 55)') == [0, 2, 4, 6, 8]
