# SPDX-License-Identifier: Apache-2.0
"""Damaged frames, tables of truth and results are used, or rejected in one line."""

from contextlib import closing
import io
import json
import shutil
import zipfile

from astropy.io import fits
import cv2
from fuzz.counting import fuzz
from fuzz.counting import tried
from fuzz.strategies import damaged
from fuzz.strategies import names
from fuzz.strategies import numbers
from fuzz.strategies import whole
from hypothesis import strategies as st
from lowsnr_bringup.formats.image_files import open_frames
from lowsnr_bringup.ros.film_bag import write_film
from lowsnr_bringup.run.results_folder import Account
from lowsnr_bringup.truth.forms import read_truth
from lowsnr_bringup.truth.frame_index import FrameIndex
from lowsnr_common.core.records import Estimate
from lowsnr_common.core.records import Truth
from lowsnr_common.settings.node_settings import Evaluation
from lowsnr_common.settings.node_settings import RunSettings
from lowsnr_eval.report import figures
from lowsnr_eval.report import html_page as pages
from lowsnr_eval.report import run_report
from lowsnr_eval.report.figure_style import render
from lowsnr_eval.report.run_report import write_run_report
from lowsnr_eval.scene.scene_writer import SceneWriter
from lowsnr_eval.scoring.entry_tables import EntryTables
from lowsnr_eval.scoring.final_summary import summarize
from lowsnr_eval.scoring.final_summary import write_summary
from lowsnr_eval.scoring.frame_scoring import Answer
from lowsnr_eval.scoring.frame_scoring import score_frame
from lowsnr_eval.scoring.score_tables import ScoreTables
import numpy as np
import pytest

pytestmark = pytest.mark.filterwarnings('ignore::RuntimeWarning', 'ignore::UserWarning')
SHAPE = (4, 5)


def npz(**arrays):
    """Return the bytes of an archive."""
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def npy(header, data=b''):
    """Return an archive of frames with any header."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, 'w') as archive:
        text = header.encode('latin1', 'replace') + b'\n'
        archive.writestr('frames.npy', b'\x93NUMPY\x01\x00' + len(text).to_bytes(
            2, 'little') + text + data)
    return file.getvalue()


def image(ending, pixels):
    """Return the bytes of an image."""
    if ending == '.fits':
        file = io.BytesIO()
        fits.PrimaryHDU(pixels).writeto(file)
        return file.getvalue()
    return cv2.imencode(ending, pixels)[1].tobytes()


FRAMES = np.arange(60, dtype=np.uint16).reshape(3, *SHAPE)
ARCHIVE = npz(frames=FRAMES, t_s=np.arange(3.0), truth=np.zeros((3, 2)))
IMAGES = {ending: image(ending, FRAMES[0]) for ending in ('.png', '.tif', '.fits')}
dtypes = st.sampled_from(
    ['<f4', '>u2', '|u1', '<f8', '<c8', '|O', '|S5', '<U3', '|b1', '<M8[s]', 'x'])
headers = st.builds(
    "{{'descr': {!r}, 'fortran_order': {}, 'shape': {}, }}".format, dtypes, st.booleans(),
    st.lists(whole.filter(lambda n: n < 10**30), max_size=4).map(tuple)) | names
arrays = st.builds(
    lambda shape, kind: np.zeros(shape, kind),
    st.lists(st.integers(0, 4), max_size=4).map(tuple),
    st.sampled_from(['<f4', '>u2', 'i8', 'f8', 'c8', 'b1', 'U3', 'S2']))
times = st.lists(numbers, max_size=4).map(np.array)
archives = st.builds(damaged, st.just(ARCHIVE)).flatmap(lambda each: each) | st.builds(
    npy, headers, st.binary(max_size=8)) | st.builds(
        lambda frames, t_s, truth: npz(frames=frames, t_s=t_s, truth=truth),
        st.just(FRAMES) | arrays, times, arrays | times)


def converted(place, source, truth=None, **options):
    """Make a bag from frames as convert.py does."""
    shutil.rmtree(place / 'bag', ignore_errors=True)
    return write_film(open_frames(source), place / 'bag', truth_file=truth, **options)


@fuzz('npz archives', 420, data=archives, period=st.none() | numbers.filter(lambda n: n > 0.0))
def test_archive_is_converted_or_rejected(place, data, period):
    path = place / 'frames.npz'
    path.write_bytes(data)
    tried('', converted, place, path, None)


@fuzz('images of a folder', 120, ending=st.sampled_from(sorted(IMAGES)), data=st.data())
def test_image_is_converted_or_rejected(place, ending, data):
    spoilt = data.draw(damaged(IMAGES[ending]))
    (place / 'frames').mkdir(exist_ok=True)
    for path in (place / 'frames').iterdir():
        path.unlink()
    (place / 'frames' / f'a{ending}').write_bytes(spoilt)
    tried(place, converted, place, place / 'frames')


TABLE = b'frame,x,y,id\n1,2.5,3,a\n2,2,3,a\n2,4,,b\n'
cells = names | numbers.map(str) | st.sampled_from(['1', '2', '0', '4', ''])
tables = st.lists(st.lists(cells, min_size=1, max_size=5), max_size=4).map(
    lambda rows: '\n'.join(','.join(row) for row in rows))


@fuzz('tables of truth', 600, data=damaged(TABLE) | tables.map(
    lambda text: (TABLE.decode().split('\n')[0] + '\n' + text).encode('utf-8', 'replace')))
def test_table_of_truth_is_read_or_rejected(place, data):
    path = place / 'truth.csv'
    path.write_bytes(data)
    tried(path, read_truth, path, FrameIndex(np.arange(1.0, 4.0)))


def write_results(folder, name='object'):
    """Write the results of a run of a few frames."""
    with closing(ScoreTables(folder, ['sdt'])) as tables, closing(
            EntryTables(folder, 1.0)) as entries, closing(SceneWriter(folder, 1.0)) as scene:
        for k in range(1, 5):
            state = np.array([k, 0.5, 2.0, 0.0])
            found = [Estimate(state, np.eye(4), 0.9, name)]
            truth, answers = [Truth(name, state)], {'sdt': Answer(found, found, 1.0, 1.0)}
            scene.add_frame(k, np.full(SHAPE, float(k)))
            scene.add_answers(k, k, truth, answers)
            entries.add(k, k, answers, truth)
            tables.add(score_frame(k, float(k), truth, answers, Evaluation()), answers)
    write_summary(folder, summarize(
        folder, RunSettings(scenario=name), Evaluation(), 0, Account()))


@pytest.fixture(scope='module')
def results(tmp_path_factory):
    """Return the files of a results folder by name."""
    folder = tmp_path_factory.mktemp('results')
    write_results(folder)
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture
def undrawn(monkeypatch):
    """Draw no figures, which take a second each."""
    monkeypatch.setattr(figures, 'single_run', lambda *_: None)
    monkeypatch.setattr(run_report, 'render', lambda figure: ('<svg/>', b''))
    monkeypatch.setattr(pages, 'versions', lambda: pages.Markup('versions'))


@fuzz('results folders', 360, name=st.sampled_from(
    ['summary.json', 'frames.csv', 'scene.jsonl', 'frames.f32']), data=st.data())
def test_report_of_damaged_results_is_written_or_rejected(place, results, undrawn, name, data):
    for other, whole_file in results.items():
        (place / other).write_bytes(whole_file)
    (place / name).write_bytes(data.draw(damaged(results[name])))
    if data.draw(st.integers(0, 9)) == 0:
        (place / name).unlink()
    tried(place, write_run_report, place, 'again')


@fuzz('names in a report', 180, name=names.filter(lambda name: len(name) < 255))
def test_names_stay_inert_in_a_report(place, undrawn, name):
    for path in place.iterdir():
        path.unlink()
    write_results(place, name)
    page = write_run_report(place, f'again {name}').read_text(encoding='utf-8')
    assert page.count('<script') == page.count('</script') == 2
    scene = page.split('id="scene">')[1].split('</script>')[0]
    assert json.loads(scene)['lines'][0]['truth'] == [[1.0, 2.0, name]]


@pytest.mark.parametrize('name', ['$x^{$', '_hidden', '<b>', 'a\nb', '\\frac', '物体'])
def test_any_name_can_be_drawn(name):
    curves = {(name, 'detection', 'hits'): np.ones(3)}
    svg, _ = render(figures.single_run([name], ['hits'], curves, [1]))
    assert svg.rstrip().endswith('</svg>')
