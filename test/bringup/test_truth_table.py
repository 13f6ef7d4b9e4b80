"""A table of truth says which objects are in which frame; a bad line is named."""

from lowsnr_bringup.bags.truth_table import read_truth
import numpy as np
import pytest

TIMES = np.array([0.0, 10.0, 25.0])


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


def test_lines_by_time_and_several_objects(tmp_path):
    text = 't_s,x,y,id\n25.4,1,2,a\n25.4,5,6,b\n9,7,7,a\n'
    found = read_truth(table(tmp_path, text), TIMES)
    assert [[item.id for item in frame] for frame in found] == [[], ['a'], ['a', 'b']]


@pytest.mark.parametrize(('text', 'said'), [
    ('', 'the header must be frame,x,y or t_s,x,y'),
    ('x,y\n1,2\n', 'the header must be'),
    ('frame,x,y,name\n', 'the header must be'),
    ('frame,x,y\n0,1,2\n', 'line 2: frame 0 is not one of 1 to 3'),
    ('frame,x,y\n1.5,1,2\n', 'line 2: frame 1.5 is not one of 1 to 3'),
    ('frame,x,y\n1,1,2\n1,1,3\n', 'line 3: object is twice in frame 1'),
    ('frame,x,y\n1,one,2\n', "line 2: 'one' is not a number"),
    ('t_s,x,y\n19,1,2\n40,1,2\n', 'line 3: there is no frame at 40 s'),
    ('t_s,x,y\nnan,1,2\n', 'line 2: there is no frame at nan s'),
])
def test_table_that_does_not_fit_is_named(tmp_path, text, said):
    with pytest.raises(ValueError, match=said):
        read_truth(table(tmp_path, text), TIMES)


def test_table_that_is_not_there_is_named(tmp_path):
    with pytest.raises(ValueError, match='none.csv: cannot be read'):
        read_truth(tmp_path / 'none.csv', TIMES)
