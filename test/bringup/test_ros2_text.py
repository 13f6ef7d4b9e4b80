# SPDX-License-Identifier: Apache-2.0
"""What the small ros2 prints of messages, rates and bags, without a graph."""

import argparse
import math
import re

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseWithCovariance
from lowsnr_bringup.bags.writer import BagWriter
from lowsnr_bringup.cli.arrivals import Delay
from lowsnr_bringup.cli.arrivals import Rate
from lowsnr_bringup.cli.bag_info import bag_info
from lowsnr_bringup.cli.message_text import csv_text
from lowsnr_bringup.cli.message_text import field_text
from lowsnr_bringup.cli.message_text import selected
from lowsnr_bringup.cli.message_text import TextForm
from lowsnr_bringup.cli.message_text import yaml_text
from lowsnr_bringup.cli.ros import param
from lowsnr_bringup.cli.ros.command import main
import numpy as np
import pytest
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Image
from std_msgs.msg import Header
from vision_msgs.msg import Detection2D
from vision_msgs.msg import Detection2DArray
import yaml

SECOND = 1_000_000_000


def array(*ids):
    """Return an array of detections with these ids."""
    header = Header(frame_id='sensor')
    header.stamp.sec, header.stamp.nanosec = 13, 5
    return Detection2DArray(header=header, detections=[Detection2D(id=name) for name in ids])


def test_fields_come_in_the_order_of_the_definition():
    text = yaml_text(array(), TextForm())
    assert text == ('header:\n  stamp:\n    sec: 13\n    nanosec: 5\n  frame_id: sensor\n'
                    'detections: []\n')
    assert field_text(array(), TextForm()) == f'{text}---\n'
    assert yaml_text(array(), TextForm(flow=True)) == (
        '{header: {stamp: {sec: 13, nanosec: 5}, frame_id: sensor}, detections: []}\n')
    assert csv_text(array('a'), TextForm()).startswith('13,5,sensor,0,0,,')


def test_numbers_are_printed_in_full():
    covariance = np.arange(36) / 7.0
    text = yaml_text(PoseWithCovariance(covariance=covariance), TextForm())
    assert yaml.safe_load(text)['covariance'] == covariance.tolist()


@pytest.mark.parametrize(('form', 'data', 'name'), [
    (TextForm(longest=3), [0, 1, 2, '...'], 'abc...'),
    (TextForm(longest=None), [0, 1, 2, 3], 'abcd'),
    (TextForm(arrays=False), '<sequence type: uint8, length: 4>', 'abcd'),
    (TextForm(texts=False), [0, 1, 2, 3], '<string length: <4>>')])
def test_long_arrays_and_texts_are_cut_or_counted(form, data, name):
    image = Image(header=Header(frame_id='abcd'), data=bytes(range(4)))
    found = yaml.safe_load(yaml_text(image, form))
    assert (found['data'], found['header']['frame_id']) == (data, name)


def test_arrays_are_counted_by_their_full_type():
    form = TextForm(arrays=False)
    assert yaml.safe_load(yaml_text(array('a', 'b'), form))['detections'] == (
        '<sequence type: vision_msgs/msg/Detection2D, length: 2>')
    assert yaml.safe_load(yaml_text(PoseWithCovariance(), form))['covariance'] == (
        '<array type: double[36]>')


def test_a_byte_is_a_letter():
    status = DiagnosticStatus(level=DiagnosticStatus.ERROR)
    assert yaml.safe_load(yaml_text(status, TextForm()))['level'] == '\x02'


def test_selected_field_is_named_from_the_outside_in():
    assert selected(array(), []) == array()
    assert field_text(selected(array(), ['header', 'stamp', 'sec']), TextForm()) == '13\n---\n'
    assert field_text(selected(array(), ['header', 'stamp']), TextForm()) == (
        'sec: 13\nnanosec: 5\n---\n')
    with pytest.raises(ValueError, match=r'header\.stmp.*frame_id'):
        selected(array(), ['header', 'stmp'])
    with pytest.raises(ValueError, match=r'sec\.x'):
        selected(array(), ['header', 'stamp', 'sec', 'x'])


def figures(text):
    """Return the numbers of a text, in order."""
    return [float(each) for each in re.findall(r'-?[\d.]+\d|\d', text)]


def test_rate_and_spread_are_those_of_the_intervals_in_the_window():
    rate = Rate(3)
    assert rate.text() is None
    for time_s in (100.0, 0.0, 1.0, 1.1, 1.3, 1.6):  # the clock is set back once
        rate.add(round(time_s * SECOND))
    spread = math.sqrt(((0.1 - 0.2) ** 2 + (0.3 - 0.2) ** 2) / 3)
    assert figures(rate.text()) == pytest.approx([5.0, 0.1, 0.3, spread, 3], abs=6e-6)


def test_delay_is_from_stamp_to_arrival():
    delay = Delay(10)
    assert delay.text() is None
    for late_ms in (20, 40):
        delay.add(SECOND + late_ms * 1_000_000, SECOND)
    assert figures(delay.text()) == pytest.approx([0.03, 0.02, 0.04, 0.01, 2])


def test_bag_is_described_with_and_without_metadata(tmp_path, capsys):
    with BagWriter(tmp_path / 'bag') as bag:
        topic = bag.add_topic('/seen', 'std_msgs/msg/Header')
        for k in range(3):
            bag.write(topic, serialize_message(Header()), 1_700_000_000 * SECOND + 5 + k, 0)
    assert main(['bag', 'info', str(tmp_path / 'bag')]) == 0
    lines = capsys.readouterr().out.splitlines()
    found = {line[:18].strip(): line[19:] for line in lines}
    file, = (tmp_path / 'bag').glob('*.mcap')
    assert found['Files:'] == file.name
    assert found['Storage id:'] == 'mcap'
    assert found['Duration:'] == '0.000000002s'
    assert found['Start:'].endswith(' (1700000000.000000005)')
    assert found['End:'].endswith(' (1700000000.000000007)')
    assert found['Messages:'] == '3'
    assert ('Topic information: Topic: /seen | Type: std_msgs/msg/Header | Count: 3 | '
            'Serialization Format: cdr') in lines
    whole = bag_info(tmp_path / 'bag')
    counted = bag_info(file)
    assert counted.topics == whole.topics
    assert (counted.start_ns, counted.duration_ns) == (whole.start_ns, whole.duration_ns)


@pytest.mark.parametrize(('text', 'culprit'), [
    ('rosbag2_bagfile_information: {relative_file_paths: []}', 'metadata.yaml'),
    ('rosbag2_bagfile_information: 3', 'metadata.yaml')])
def test_damaged_metadata_is_named(tmp_path, capsys, text, culprit):
    (tmp_path / 'metadata.yaml').write_text(text)
    assert main(['bag', 'info', str(tmp_path)]) == 1
    assert culprit in capsys.readouterr().err


@pytest.mark.parametrize(('arguments', 'code', 'culprit'), [
    (['topic', 'pub'], 2, "'pub'"), (['topic'], 2, 'VERB'), (['paint'], 2, "'paint'"),
    (['topic', 'echo', '/x', '--truncate-length', '-3'], 2, '--truncate-length'),
    (['topic', 'hz', '/x', '-w', '0'], 2, '--window'),
    (['bag', 'info', '/no/such/bag'], 1, '/no/such/bag'),
    (['run', 'lowsnr_detct', 'sdt_node'], 1, 'lowsnr_detect'),
    (['run', 'lowsnr_detect', 'sdt_nod'], 1, 'sdt_node'),
    (['topic', 'echo', '/x', '--field', '.'], 1, "'.'")])
def test_what_cannot_be_done_is_named_in_one_line(capsys, arguments, code, culprit):
    try:
        found = main(arguments)
    except SystemExit as end:
        found = end.code
    out, err = capsys.readouterr()
    assert (found, out, err.count('\n')) == (code, '', 1)
    assert culprit in err


def test_help_names_where_the_whole_tool_is(capsys):
    with pytest.raises(SystemExit) as end:
        main(['--help'])
    assert end.value.code == 0
    assert 'installed ROS 2' in ' '.join(capsys.readouterr().out.split())


@pytest.mark.parametrize(('run', 'options'), [
    (param.list_parameters, {'filter': '['}),
    (param.set_value, {'parameter_name': 'p', 'value': '@x'})])
def test_filter_or_value_that_is_none_is_named_before_the_graph_is_asked(run, options):
    with pytest.raises(ValueError, match=r'\[|@x') as caught:
        run(argparse.Namespace(**options))
    assert '\n' not in str(caught.value)
