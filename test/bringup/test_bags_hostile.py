# SPDX-License-Identifier: Apache-2.0
"""Bags made to take all memory, to go on without end, or to carry impossible values."""

from contextlib import closing
import shutil
import sqlite3
import struct
import tempfile
import tracemalloc
from types import SimpleNamespace

from lowsnr_bringup.bags.errors import UnusableFile
from lowsnr_bringup.bags.mcap_storage import MAGIC
from lowsnr_bringup.bags.reader import Bag
from lowsnr_bringup.bags.recorded_run import inspect_bag
from lowsnr_bringup.bags.recording import CUSTOM_PARAMETERS
from lowsnr_bringup.bags.writer import BagWriter
from lowsnr_eval.scoring.recorded_chains import find_chains
import lz4.frame
import pytest
import yaml
import zstandard

PACKERS = {'lz4': lz4.frame.compress, 'zstd': zstandard.compress}


def rejection(path):
    """Return the file that is named, and the reason for which a bag is rejected."""
    with pytest.raises(UnusableFile) as caught:
        inspect_bag(path, '/image_raw', '/ground_truth')
    assert str(caught.value).isprintable()
    return caught.value.path, caught.value.reason


def chunk_of_zeros(kind, packed, size):
    """Return an MCAP file of one chunk that unpacks to zeros and declares their number."""
    head = struct.pack('<I', 4) + b'ros2' + struct.pack('<I', 0)
    chunk = struct.pack('<QQQII', 0, 1, size, 0, len(kind)) + kind.encode() + struct.pack(
        '<Q', len(packed)) + packed
    return MAGIC + b''.join(
        struct.pack('<BQ', code, len(record)) + record
        for code, record in ((1, head), (6, chunk)))


@pytest.mark.parametrize('kind', ['lz4', 'zstd'])
@pytest.mark.parametrize('size', [1000, 2**29, 2**62])
def test_chunk_that_unpacks_to_more_than_it_declares_takes_no_memory(tmp_path, kind, size):
    packed = PACKERS[kind](bytes(2**28))
    path = tmp_path / 'bag.mcap'
    path.write_bytes(chunk_of_zeros(kind, packed, size))
    tracemalloc.start()
    try:
        assert rejection(path) == (path, 'no topic')
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    if size != 2**29:  # which it declares
        assert peak < 2**26


@pytest.mark.parametrize('size', [2**40, 2**62])
def test_record_that_declares_more_bytes_than_the_file_has_takes_no_memory(tmp_path, size):
    path = tmp_path / 'bag.mcap'
    path.write_bytes(MAGIC + b'\x06' + struct.pack('<Q', 2**29) + struct.pack(
        '<QQQIIQ', 0, 1, 1, 0, 0, size))
    tracemalloc.start()
    try:
        assert rejection(path) == (path, 'unreadable')
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 2**26


def test_view_in_place_of_a_table_is_not_read(tmp_path):
    path = tmp_path / 'bag.db3'
    with closing(sqlite3.connect(path)) as database:
        database.execute('CREATE TABLE topics (id, name, type)')
        database.execute(
            'CREATE VIEW messages AS WITH RECURSIVE more(n) AS '
            '(SELECT 1 UNION ALL SELECT n + 1 FROM more) '
            'SELECT n AS id, n AS rowid, 1 AS topic_id, n AS timestamp, 0 AS data FROM more')
        database.commit()
    assert rejection(path) == (path, 'unreadable')


def test_values_that_a_run_cannot_have_are_named(tmp_path):
    text = yaml.safe_dump({'/evaluator': {'ros__parameters': {'seed': {'a': 1}}}})
    with BagWriter(tmp_path / 'bag', custom={CUSTOM_PARAMETERS: text}) as bag:
        bag.add_topic('/detections', 'vision_msgs/msg/Detection2DArray')
    with Bag(tmp_path / 'bag') as bag, pytest.raises(ValueError, match='seed'):
        find_chains(bag, {})


@pytest.fixture
def packed(tmp_path):
    """Return a bag of which each file is compressed."""
    with BagWriter(tmp_path / 'bag') as bag:
        bag.add_topic('/detections', 'vision_msgs/msg/Detection2DArray')
    path = tmp_path / 'bag.mcap.zstd'
    path.write_bytes(zstandard.compress((tmp_path / 'bag' / 'bag.mcap').read_bytes()))
    return path


@pytest.mark.parametrize('size', [0, 2**26 + 10])
def test_bag_that_unpacks_to_more_than_the_disk_has_is_rejected(packed, monkeypatch, size):
    assert rejection(packed)[1] == 'no topic'
    monkeypatch.setattr(shutil, 'disk_usage', lambda _: SimpleNamespace(free=size))
    assert rejection(packed) == (packed, 'no room')


def test_bag_without_a_folder_to_unpack_it_is_rejected(packed, monkeypatch, tmp_path):
    monkeypatch.setattr(tempfile, 'tempdir', str(tmp_path / 'none'))
    assert rejection(packed) == (packed, 'no room')
