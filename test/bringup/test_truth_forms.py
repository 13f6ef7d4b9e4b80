# SPDX-License-Identifier: Apache-2.0
"""Truth in the usual forms: tables under other names, MOT, COCO, objects outside the picture."""

import json
from pathlib import Path

from lowsnr_bringup.bags.errors import UnusableFile
from lowsnr_bringup.truth.forms import read_truth
from lowsnr_bringup.truth.forms import within
from lowsnr_bringup.truth.frame_index import FrameIndex
from lowsnr_bringup.truth.frame_index import Reading
from lowsnr_bringup.truth.frame_index import truth_at
import numpy as np
import pytest

START_S = 1_767_225_600.0  # 2026-01-01T00:00:00
FRAMES = FrameIndex(START_S + np.array([0.0, 10.0, 25.0]), ('a_1.fits', 'a_2.fits', 'a_3.fits'))
EXPECTED = [[('object', 1.5, 2.0)], [], [('object', 3.0, 4.25)]]


def objects(path, **reading):
    """Return name, x and y of the objects of every frame, and the notes."""
    notes = []
    found = read_truth(path, FRAMES, Reading(**reading), notes)
    return [[(item.id, *item.state[[0, 2]].tolist()) for item in frame] for frame in found], notes


def write(tmp_path, text):
    (tmp_path / 'truth').write_text(text)
    return tmp_path / 'truth'


def reason(path, **reading):
    with pytest.raises(UnusableFile) as caught:
        objects(path, **reading)
    assert str(caught.value).isprintable()
    return caught.value.reason


@pytest.mark.parametrize('text', [
    'frame,x,y\n1,1.5,2\n3,3,4.25\n', 'Frame;X;Y\n1;1,5;2\n3;3;4,25\n',
    'frame_id\tcol\trow\tscore\n1\t1.5\t2\t.9\n3\t3\t4.25\t.8\n',
    'TRACK_QUALITY,POSITION_X,POSITION_Y,FRAME\n1,1.5,2,1\n1,3,4.25,3\n',
    'x [px] , y [px] , frame no\n1.5, 2, 1\n3, 4.25, 3\n', '\ufeffframe,u,v\n1,1.5,2\n3,3,4.25\n',
    'frame x y\n1 1.5 2\n3 3 4.25\n', 'frame,x,y\n1,1.5,2\n2,,\n\n3,3,4.25\n',
    't_s,x,y\n0,1.5,2\n25,3,4.25\n', 'time;x;y\n0,0;1,5;2\n24,9;3;4,25\n',
    f'timestamp,x,y\n{START_S},1.5,2\n{START_S + 25},3,4.25\n',
    'date,x,y\n2026-01-01T00:00:00,1.5,2\n2026-01-01 00:00:25.1Z,3,4.25\n',
    '1,-1,1,1.5,2,2,1\n3,-1,3,4.25,1,1,1\n'])
def test_tables_under_other_names(tmp_path, text):
    found, _ = objects(write(tmp_path, text), **({'origin': 0} if text[0] == '1' else {}))
    assert [[each[1:] for each in frame] for frame in found] == [
        [each[1:] for each in frame] for frame in EXPECTED]


def test_columns_are_named_by_option(tmp_path):
    path = write(tmp_path, 'nr,a,b,x,y\n1,1.5,2,0,0\n3,3,4.25,0,0\n')
    assert reason(path) == 'header'
    columns = (('frame', 'nr'), ('x', 'a'), ('y', 'b'))
    assert objects(path, columns=columns)[0] == EXPECTED
    assert reason(path, columns=(('frame', 'none'),)) == 'header'


def test_frames_and_pixels_count_from_0_or_1(tmp_path):
    path = write(tmp_path, 'frame,x,y\n0,1.5,2\n2,3,4.25\n')
    found, notes = objects(path)
    assert (found, len(notes)) == (EXPECTED, 1)
    assert reason(path, first=1) == 'no such frame'
    path = write(tmp_path, 'frame,x,y\n2,3,4.25\n')
    assert objects(path, first=0)[0] == [[], [], EXPECTED[2]]
    assert objects(path)[0] == [[], EXPECTED[2], []]
    assert objects(path, origin=1)[0] == [[], [('object', 2.0, 3.25)], []]


def test_several_objects(tmp_path):
    path = write(tmp_path, 'frame,track_id,x,y\n1,7,1,2\n1,8,3,4\n')
    assert objects(path)[0] == [[('7', 1.0, 2.0), ('8', 3.0, 4.0)], [], []]
    assert reason(write(tmp_path, 'frame,track_id,x,y\n1,7,1,2\n1,7,3,4\n')) == 'twice'


def test_mot_counts_from_one_and_leaves_out_what_is_to_be_ignored(tmp_path):
    # The box of 5 x 3 pixels whose first one is (10, 20), from 1, has its middle at (12, 21).
    path = write(tmp_path, '1,4,10,20,5,3,1,-1,-1,-1\n1,5,1,1,1,1,0,-1,-1,-1\n'
                           '3,4,10.5,20,5,3,1,-1,-1,-1\n')
    assert objects(path)[0] == [[('4', 11.0, 20.0)], [], [('4', 11.5, 20.0)]]
    assert objects(path, origin=0)[0][0] == [('4', 12.0, 21.0)]
    assert reason(write(tmp_path, '1,4,10,20,5,3\n1,4,10\n')) == 'number'
    assert reason(write(tmp_path, '9,4,10,20,5,3\n')) == 'no such frame'


def coco(tmp_path, images, annotations):
    return write(tmp_path, json.dumps({
        'images': images, 'annotations': annotations,
        'categories': [{'id': 1, 'name': 'drone'}, {'id': 2, 'name': 'bird'}]}))


def box(image, category=1, **more):
    return {'image_id': image, 'category_id': category, 'bbox': [10, 20, 5, 3]} | more


def test_coco_knows_frames_by_file_or_order_and_objects_by_track_or_category(tmp_path):
    files = [{'id': 30 - k, 'file_name': f'day/a_{k}.png'} for k in (1, 2, 3)]
    path = coco(tmp_path, files, [box(29), box(29, 2), box(27, track_id=4)])
    assert objects(path)[0] == [
        [('drone', 12.0, 21.0), ('bird', 12.0, 21.0)], [], [('4', 12.0, 21.0)]]
    ordered = [{'id': k, 'file_name': f'{k}.jpg'} for k in (3, 1, 2)]
    path = coco(tmp_path, ordered, [box(1), box(3, attributes={'track_id': 9})])
    assert objects(path)[0] == [[('drone', 12.0, 21.0)], [], [('9', 12.0, 21.0)]]


@pytest.mark.parametrize(('images', 'annotations', 'why'), [
    ([{'id': 1}], [], 'no such frame'),
    ([{'id': k} for k in (1, 2, 3)], [box(1), box(1)], 'twice'),
    ([{'id': k} for k in (1, 2, 3)], [box(9)], 'unreadable'),
    ([{'id': k} for k in (1, 2, 3)], [{'image_id': 1, 'bbox': 'x'}], 'unreadable'),
    ([{'id': 1, 'file_name': 'a_1.png'}, {'id': 2, 'file_name': 'b.png'}], [], 'no such frame')])
def test_coco_that_does_not_fit_is_refused(tmp_path, images, annotations, why):
    assert reason(coco(tmp_path, images, annotations)) == why


@pytest.mark.parametrize('text', ['{', '{"images": 1}', '{"a": ' * 5000])
def test_json_that_is_no_coco_is_refused(tmp_path, text):
    assert reason(write(tmp_path, text)) == 'unreadable'


def test_objects_outside_the_picture_are_said_and_absent():
    notes = []
    inside, outside = truth_at(-0.5, 3.4, 'a'), truth_at(5.0, 3.5, 'b')
    kept = list(within([[inside, outside], [outside]], (4, 6), Path('truth.csv'), notes))
    assert [[item.id for item in frame] for frame in kept] == [['a'], []]
    assert '2 of 3 positions' in notes[0]
    with pytest.raises(UnusableFile) as caught:
        list(within([[outside]], (4, 6), Path('truth.csv'), notes))
    assert caught.value.reason == 'outside'
