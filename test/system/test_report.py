"""The report of a real run, opened in a real browser."""

from browser import browser

FRAMES = 40
NUMBER = "document.getElementById('number').textContent"
PICTURE = "document.getElementById('view').toDataURL()"


def test_run_leaves_a_report_that_plays_without_a_network(bringup, tmp_path, require_program):
    run = bringup('--detector', 'cdt', 'sdt', '--lockstep', '--snr', '12')
    code, out, err = run.finish()
    assert code == 0, err
    report = run.results / 'report.html'
    assert f'report: {report}' in out
    with browser(require_program('chromium'), tmp_path / 'profile') as page:
        page.load(report)
        said, seen = [page.value(NUMBER)], {page.value(PICTURE)}
        for _ in range(FRAMES - 1):
            page.press('ArrowRight')
            said.append(page.value(NUMBER))
            seen.add(page.value(PICTURE))
        # Every frame came, looks its own way, and shows what was scored of it.
        assert len(seen) == FRAMES
        rows = [row.split(',') for row in run.rows() if ',cdt,' in row]
        found, tracked = rows[::2], rows[1::2]
        assert [text.replace('s,', ',').rstrip('s') for text in said] == [
            f'frame {k}: {a[4]} object, {a[5]} detection, {b[5]} track'
            for k, (a, b) in enumerate(zip(found, tracked), start=1)]
        assert any(row[5] != '0' for row in tracked)
        page.click('#play')
        page.screenshot(tmp_path / 'seen.png')
        asked = [address for address in page.requests if not address.startswith('data:')]
        assert (asked, page.errors) == ([report.as_uri()], [])


def test_interrupted_run_leaves_a_report(bringup):
    run = bringup('--detector', 'cdt', '--rate', '50', '--loop')
    run.wait_for_rows(20)
    run.process.send_signal(2)
    code, out, _ = run.finish()
    assert code == 130
    assert f'report: {run.results}/report.html' in out
    assert '<canvas' in (run.results / 'report.html').read_text()


def test_report_that_cannot_be_written_costs_nothing_else(bringup):
    run = bringup('--detector', 'cdt', '--lockstep')
    run.wait_for_rows(2)
    (run.results / 'report.html').mkdir()
    code, out, err = run.finish()
    assert code == 0, err
    assert f'{FRAMES} frames published, {FRAMES} scored' in out
    assert 'bringup.py: no report: ' in err
    assert 'Traceback' not in err
