"""A file that only grows: nothing is lost on a full disk, nor with the folder."""

from contextlib import closing
import shutil

from disk import fill
from lowsnr_eval.scoring.growing_file import GrowingFile
import pytest


def test_pieces_are_on_disk_at_once(tmp_path):
    with closing(GrowingFile(tmp_path / 'file')) as file:
        for piece in (b'one\n', b'two\n'):
            file.append(piece)
        assert (tmp_path / 'file').read_bytes() == b'one\ntwo\n'
        assert file.size == 8
        assert file.settle() == ''


def test_what_is_there_is_not_written_over(tmp_path):
    (tmp_path / 'file').write_bytes(b'mine')
    with pytest.raises(FileExistsError, match='file holds earlier results'):
        GrowingFile(tmp_path / 'file')
    assert (tmp_path / 'file').read_bytes() == b'mine'


def test_a_second_life_goes_on_where_it_is_told(tmp_path):
    (tmp_path / 'file').write_bytes(b'one\ntw')
    with closing(GrowingFile(tmp_path / 'file', 4)) as file:
        file.append(b'two\n')
    assert (tmp_path / 'file').read_bytes() == b'one\ntwo\n'


@pytest.mark.parametrize('removed', ['file', 'folder', 'replaced', 'in the way'])
def test_what_is_removed_comes_back_with_all_it_held(tmp_path, removed):
    folder = tmp_path / 'deep' / 'folder'
    folder.mkdir(parents=True)
    file = GrowingFile(folder / 'file')
    file.append(b'before\n')
    if removed == 'file':
        (folder / 'file').unlink()
    else:
        shutil.rmtree(tmp_path / 'deep')
    if removed == 'replaced':
        folder.mkdir(parents=True)
        (folder / 'file').write_bytes(b'of somebody else')
    if removed == 'in the way':
        (tmp_path / 'deep').write_bytes(b'')
    file.append(b'meanwhile\n')
    trouble = file.settle()
    if removed == 'in the way':
        assert trouble.startswith(f'{folder / "file"}: ')
        (tmp_path / 'deep').unlink()
        assert file.settle() == ''
    file.append(b'after\n')
    file.close()
    assert (folder / 'file').read_bytes() == b'before\nmeanwhile\nafter\n'
    assert [path.name for path in folder.iterdir()] == ['file']


def test_nothing_is_lost_on_a_full_disk(small_disk):
    file = GrowingFile(small_disk / 'file')
    ballast = small_disk / 'ballast'
    fill(ballast)
    pieces = [f'{number}\n'.encode() * 5 for number in range(1000)]
    for piece in pieces:
        file.append(piece)
    assert file.settle() == (
        f'{small_disk / "file"}: No space left on device; '
        f'{file.size - (small_disk / "file").stat().st_size} bytes wait for room')
    ballast.unlink()
    assert file.settle() == ''
    file.close()
    assert (small_disk / 'file').read_bytes() == b''.join(pieces)
