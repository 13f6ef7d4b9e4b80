# SPDX-License-Identifier: Apache-2.0
"""A table of truth lists the objects of every frame; a bad line is named."""

from lowsnr_bringup.bags.errors import UnusableFile
from lowsnr_bringup.truth.forms import read_truth
from lowsnr_bringup.truth.frame_index import FrameIndex
import numpy as np
import pytest

TIMES = FrameIndex(np.array([0.0, 10.0, 25.0]))


def table(tmp_path, text):
    """Return the path of a table."""
    path = tmp_path / 'truth.csv'
    path.write_text(text)
    return path


def test_lines_by_frame_number(tmp_path):
    found = read_truth(table(tmp_path, 'frame,x,y\n1,3.5,4\n3,nan,nan\n2,,\n'), TIMES)
    assert [len(frame) for frame in found] == [1, 0, 0]
    assert found[0][0].state[[0, 2]].tolist() == [3.5, 4.0]
    assert np.isnan(found[0][0].state[[1, 3]]).all()


def test_table_that_numpy_wrote(tmp_path):
    path = tmp_path / 'truth.csv'
    np.savetxt(path, [[1, 3, 4], [2, 5, 6]], fmt='%g', header='frame x y')
    found = read_truth(path, TIMES)
    assert [frame[0].state[[0, 2]].tolist() for frame in found[:2]] == [[3, 4], [5, 6]]
    found = read_truth(table(tmp_path, 'frame;x;y;\n1;3;4;\n'), TIMES)
    assert found[0][0].state[[0, 2]].tolist() == [3, 4]


def test_lines_by_time_and_several_objects(tmp_path):
    text = 't_s,x,y,id\n25.4,1,2,a\n25.4,5,6,b\n9,7,7,a\n'
    found = read_truth(table(tmp_path, text), TIMES)
    assert [[item.id for item in frame] for frame in found] == [[], ['a'], ['a', 'b']]


@pytest.mark.parametrize(('text', 'reason', 'line'), [
    ('', 'header', ''),
    ('x,y\n1,2\n', 'header', ''),
    ('frame,u,w,name\n', 'header', ''),
    ('x,y,z\n', 'header', ''),
    ('frame,x,y\n1,1,2\n4,1,2\n', 'no such frame', 'line 3:'),
    ('frame,x,y\n1.5,1,2\n', 'no such frame', 'line 2:'),
    ('frame,x,y\n1,1,2\n1,1,3\n', 'twice', 'line 3:'),
    ('frame,x,y\n1,one,2\n', 'number', 'line 2:'),
    ('frame,x,y\n1,10,5,20,5\n', 'fields', 'line 2:'),  # decimal commas
    ('frame,x,y\n1,10\n', 'fields', 'line 2:'),
    ('t_s,x,y\n19,1,2\n40,1,2\n', 'no such frame', 'line 3:'),
    ('t_s,x,y\nnan,1,2\n', 'no such frame', 'line 2:'),
])
def test_bad_line_is_named(tmp_path, text, reason, line):
    path = table(tmp_path, text)
    with pytest.raises(UnusableFile) as caught:
        read_truth(path, TIMES)
    assert (caught.value.path, caught.value.reason) == (path, reason)
    assert str(caught.value).startswith(f'{path}: {line}')


def test_missing_table_is_named(tmp_path):
    with pytest.raises(UnusableFile) as caught:
        read_truth(tmp_path / 'none.csv', TIMES)
    assert (caught.value.path, caught.value.reason) == (tmp_path / 'none.csv', 'unreadable')
