# SPDX-License-Identifier: Apache-2.0
"""The recorder counts lost messages; its bags hold the counts."""

from pathlib import Path

from lowsnr_bringup.bags.errors import UnusableFile
from lowsnr_bringup.bags.recording import bags_of_run
from lowsnr_bringup.bags.recording import CUSTOM_LOSSES
from lowsnr_bringup.bags.recording import RecordingSummary
from lowsnr_bringup.bags.recording import restarted_bag
from lowsnr_bringup.bags.recording import summarize_recording
from lowsnr_bringup.bags.recording import Tally
from lowsnr_bringup.bags.writer import check_new
from lowsnr_bringup.ros.frame_bag import FrameBag
import numpy as np
import pytest


def test_gaps_in_a_publishers_numbers_are_losses():
    tally = Tally()
    for number in (4, 5, 9, 10, 1, 2, 4):
        tally.add(number)
    assert (tally.received, tally.lost) == (7, 3 + 1)
    tally = Tally(last=0)
    tally.add(3)
    assert tally.lost == 2


def test_losses_of_several_publishers_are_those_that_the_middleware_reports():
    tally = Tally(shared=True, reported=2)
    for number in (1, 7, 2, 8):
        tally.add(number)
    assert (tally.received, tally.lost) == (4, 2)


def test_recording_is_summarized(tmp_path):
    assert summarize_recording(tmp_path / 'no') == RecordingSummary(tmp_path / 'no', exists=False)
    with FrameBag(tmp_path / 'early') as bag:
        bag.add(np.zeros((2, 2)), 1, None)
    for spoil in (Path.exists, lambda path: path.write_text(''), Path.unlink):  # a full disk
        spoil(tmp_path / 'early' / 'metadata.yaml')
        assert summarize_recording(tmp_path / 'early') == RecordingSummary(tmp_path / 'early')
    with FrameBag(tmp_path / 'bag', custom={CUSTOM_LOSSES: '{"/image_raw": 3}'}) as bag:
        bag.add(np.zeros((2, 2)), 1, None)
    summary = summarize_recording(tmp_path / 'bag')
    assert summary == RecordingSummary(
        tmp_path / 'bag', finished=True, messages=2, topics=2, losses={'/image_raw': 3})
    assert '3 on /image_raw' in str(summary)


def test_each_start_of_a_recorder_has_a_bag_of_its_own(tmp_path):
    names = ['bag', 'bag-2', 'bag-3']
    assert [restarted_bag(tmp_path / 'bag', n).name for n in range(3)] == names
    for name in ('bag-2', 'bag-3', 'bag-5'):
        (tmp_path / name).mkdir()
    assert [path.name for path in bags_of_run(tmp_path / 'bag')] == names


@pytest.mark.parametrize('text', [
    '', '[]', '{', 'rosbag2_bagfile_information: 3', 'rosbag2_bagfile_information: {}', '\x00',
    'rosbag2_bagfile_information: {custom_data: {lowsnr_losses: "["}}',
    'rosbag2_bagfile_information: {custom_data: {lowsnr_losses: "{}"}, message_count: 1}'])
def test_recording_whose_metadata_are_damaged_is_not_finished(tmp_path, text):
    (tmp_path / 'metadata.yaml').write_text(text)
    assert summarize_recording(tmp_path) == RecordingSummary(tmp_path)


def test_bag_that_cannot_be_made_is_rejected_before_a_run(tmp_path):
    with pytest.raises(UnusableFile) as caught:
        check_new(Path('/proc/lowsnr/bag'))
    assert caught.value.reason == 'not writable'
    with pytest.raises(UnusableFile) as caught:
        check_new(Path('/proc/bag'))  # the folder above it exists
    assert caught.value.reason == 'not writable'
    check_new(tmp_path / 'new' / 'bag')
    assert list((tmp_path / 'new').iterdir()) == []
