# SPDX-License-Identifier: Apache-2.0
"""A file that only grows loses nothing on a full disk, nor with its folder."""

from contextlib import closing
import errno
import shutil

from disk import fill
from lowsnr_bringup.run import growing_file
from lowsnr_bringup.run.growing_file import GrowingFile
import pytest


def test_pieces_are_on_disk_at_once(tmp_path):
    with closing(GrowingFile(tmp_path / 'file')) as file:
        for piece in (b'one\n', b'two\n'):
            file.append(piece)
        assert (tmp_path / 'file').read_bytes() == b'one\ntwo\n'
        assert file.size == 8
        assert file.flush() is None


def test_a_file_that_is_not_empty_is_left_alone(tmp_path):
    (tmp_path / 'file').write_bytes(b'mine')
    with pytest.raises(FileExistsError) as caught:
        GrowingFile(tmp_path / 'file')
    assert caught.value.errno == errno.EEXIST
    assert (tmp_path / 'file').read_bytes() == b'mine'


def test_an_earlier_file_continues_at_its_end(tmp_path):
    (tmp_path / 'file').write_bytes(b'one\ntw')
    with closing(GrowingFile(tmp_path / 'file', 4)) as file:
        file.append(b'two\n')
    assert (tmp_path / 'file').read_bytes() == b'one\ntwo\n'


@pytest.mark.parametrize('removed', ['file', 'folder', 'replaced', 'in the way'])
def test_a_file_that_is_removed_is_recreated_with_all_it_held(tmp_path, removed):
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
    fault = file.flush()
    if removed == 'in the way':
        assert fault.path == folder / 'file'
        assert fault.error.errno in (errno.EEXIST, errno.ENOTDIR)
        (tmp_path / 'deep').unlink()
        fault = file.flush()
    assert fault is None
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
    fault = file.flush()
    assert (fault.path, fault.error.errno, fault.lost) == (small_disk / 'file', errno.ENOSPC, 0)
    assert fault.waiting == file.size - (small_disk / 'file').stat().st_size > 0
    assert str(fault.path) in str(fault)
    ballast.unlink()
    assert file.flush() is None
    file.close()
    assert (small_disk / 'file').read_bytes() == b''.join(pieces)


def test_pieces_beyond_what_may_wait_are_counted_as_lost(small_disk, monkeypatch):
    monkeypatch.setattr(growing_file, '_MOST_WAITING', 5000)
    file = GrowingFile(small_disk / 'file')
    ballast = small_disk / 'ballast'
    fill(ballast)
    piece = b'x' * 999 + b'\n'
    for _ in range(20):
        file.append(piece)
    lost = file.flush().lost
    assert lost >= 10
    ballast.unlink()
    fault = file.flush()
    assert (fault.error, fault.waiting, fault.lost) == (None, 0, lost)
    file.close()
    assert (small_disk / 'file').read_bytes() == piece * (20 - lost)


def test_a_file_gives_its_room_to_another(small_disk):
    with closing(GrowingFile(small_disk / 'less')) as less, closing(
            GrowingFile(small_disk / 'more')) as more:
        less.append(bytes(2**19))
        fill(small_disk / 'ballast')
        more.append(bytes(2**18))
        less.append(b'waits')
        assert more.flush().full
        less.give_way()
        assert more.flush() is None
        assert (less.size, less.flush()) == (0, None)
