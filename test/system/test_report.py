# SPDX-License-Identifier: Apache-2.0
"""The report of a real run, opened in a real browser."""

import time

from browser import browser

FRAMES = 40
NUMBER = "document.getElementById('number').textContent"
PICTURE = "document.getElementById('view').toDataURL()"


def test_run_leaves_a_report_that_plays_without_a_network(bringup, tmp_path, require_program):
    run = bringup('--detector', 'cdt', 'sdt', '--lockstep', '--snr', '12')
    code, out, err = run.finish()
    assert code == 0, err
    report = run.results / 'report.html'
    assert str(report) in out
    with browser(require_program('chromium'), tmp_path / 'profile') as page:
        page.load(report)
        page.press('Home')  # it opens on an object
        texts, seen = [page.value(NUMBER)], {page.value(PICTURE)}
        for _ in range(FRAMES - 1):
            page.press('ArrowRight')
            texts.append(page.value(NUMBER))
            seen.add(page.value(PICTURE))
        # Every frame is there, looks different, and shows what was scored of it.
        assert len(seen) == FRAMES
        rows = [row.split(',') for row in run.rows() if ',cdt,' in row]
        found, tracked = rows[::2], rows[1::2]
        assert [text.replace('s,', ',').rstrip('s') for text in texts] == [
            f'frame {k}: {a[4]} object, {a[5]} detection, {b[5]} track'
            for k, (a, b) in enumerate(zip(found, tracked), start=1)]
        assert any(row[5] != '0' for row in tracked)
        page.click('#play')
        page.screenshot(tmp_path / 'seen.png')
        asked = [address for address in page.requests if not address.startswith('data:')]
        assert (asked, page.errors) == ([report.as_uri()], [])


def test_report_that_cannot_be_written_costs_nothing_else(bringup):
    run = bringup('--detector', 'cdt', '--lockstep')
    until = time.monotonic() + 120.0
    while not (run.results / 'parameters.yaml').exists():  # the folder is the run's
        assert time.monotonic() < until
        time.sleep(0.01)
    (run.results / 'report.html').mkdir()
    code, out, err = run.finish()
    assert code == 0, err
    assert run.summary()['frames'] == {
        'expected': FRAMES, 'published': FRAMES, 'scored': FRAMES, 'unanswered': 0, 'unseen': 0,
        'lost': 0}
    assert str(run.results / 'report.html') in err
    assert 'Traceback' not in err
