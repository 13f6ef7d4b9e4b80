"""Bags made to take all memory, to go on for ever, or to say what no run can."""

from contextlib import closing
import sqlite3
import struct
import tracemalloc

from lowsnr_bringup.bags.reader import Bag
from lowsnr_bringup.bags.recorded_run import inspect_bag
from lowsnr_bringup.bags.recording import CUSTOM_PARAMETERS
from lowsnr_bringup.bags.salvage import MCAP_MAGIC
from lowsnr_bringup.bags.writer import BagWriter
from lowsnr_eval.scoring.recorded_chains import find_chains
import lz4.frame
import pytest
from rosbags.rosbag2.reader import zstd
import yaml

PACKERS = {'lz4': lz4.frame.compress, 'zstd': zstd.compress}


def refusal(path):
    """Return the line with which a bag is refused."""
    with pytest.raises(ValueError, match=r'^\S') as caught:
        inspect_bag(path, '/image_raw', '/ground_truth')
    line = str(caught.value)
    assert line.isprintable()
    return line


def chunk_of_zeros(kind, packed, size):
    """Return an MCAP file of one chunk that unpacks to zeros and says how many there are."""
    head = struct.pack('<I', 4) + b'ros2' + struct.pack('<I', 0)
    chunk = struct.pack('<QQQII', 0, 1, size, 0, len(kind)) + kind.encode() + struct.pack(
        '<Q', len(packed)) + packed
    return MCAP_MAGIC + b''.join(
        struct.pack('<BQ', code, len(record)) + record
        for code, record in ((1, head), (6, chunk)))


@pytest.mark.parametrize('kind', ['lz4', 'zstd'])
@pytest.mark.parametrize('size', [1000, 2**29, 2**62])
def test_what_unpacks_to_far_more_than_it_says_takes_no_memory(tmp_path, kind, size):
    packed = PACKERS[kind](bytes(2**28))
    path = tmp_path / 'bag.mcap'
    path.write_bytes(chunk_of_zeros(kind, packed, size))
    tracemalloc.start()
    try:
        assert refusal(path).startswith(str(path))
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    if size != 2**29:  # all of which it says
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
    assert 'cannot be read' in refusal(path)


def test_values_that_a_run_cannot_have_are_named(tmp_path):
    told = yaml.safe_dump({'/evaluator': {'ros__parameters': {'seed': {'a': 1}}}})
    with BagWriter(tmp_path / 'bag', custom={CUSTOM_PARAMETERS: told}) as bag:
        bag.add_topic('/detections', 'vision_msgs/msg/Detection2DArray')
    with Bag(tmp_path / 'bag') as bag, pytest.raises(ValueError, match='evaluator: seed = '):
        find_chains(bag, {})
