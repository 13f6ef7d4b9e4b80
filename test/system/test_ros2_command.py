# SPDX-License-Identifier: Apache-2.0
"""The small ros2 on a running graph, and the line that bring-up prints for another terminal."""

import io
import os
import re
import subprocess
import sys

from graph_runs import graph_environment
from graph_runs import own_domain
from graph_runs import ROOT
from graph_runs import start_bringup
from lowsnr_bringup.cli.ros.command import main
import pytest
import yaml

NODES = ['/bringup', '/cdt_detector', '/evaluator', '/sensor', '/tracker']
ARRAY = 'vision_msgs/msg/Detection2DArray'
RATE_HZ = 20.0
WHOLE = ('--spin-time', '2')  # where the list must be whole on a machine that is busy


@pytest.fixture(scope='module')
def line(tmp_path_factory):
    """Return the line to copy of a graph that runs until the end of the module."""
    with start_bringup(
            tmp_path_factory.mktemp('looped') / 'run', '--detector', 'cdt', '--loop', '--snr',
            '20', '--rate', str(RATE_HZ), domain_id=own_domain()) as run:
        run.wait_for_rows(2)
        run.process.stdout.readline()
        yield run.process.stdout.readline().rstrip('\n')


@pytest.fixture
def ros2(line, monkeypatch, capsys):
    """Return a function that runs a command, and returns its exit code, output and errors."""
    for name, value in graph_environment(own_domain()).items():
        monkeypatch.setenv(name, value)

    def run(*arguments):
        code = main(arguments)
        return code, *capsys.readouterr()

    return run


class Interrupting(io.StringIO):
    """A terminal at which Ctrl-C is pressed once a figure has come twice."""

    def write(self, text):
        """Take a text."""
        count = super().write(text)
        if self.getvalue().count('window: ') == 2:
            raise KeyboardInterrupt
        return count


def figures_of(ros2, monkeypatch, *arguments):
    """Return what a command that never ends prints up to its second figure."""
    with monkeypatch.context() as patch:
        patch.setattr(sys, 'stdout', terminal := Interrupting())
        assert ros2(*arguments)[0] == 130
    return terminal.getvalue()


def numbers(text, key):
    """Return the numbers that follow a key."""
    return [float(each) for each in re.findall(rf'{key}: (-?[\d.]+)', text)]


def test_line_of_bringup_shows_the_tracks_in_another_terminal(line):
    assert f'ROS_DOMAIN_ID={own_domain()} ' in line
    assert line.endswith('topic echo /tracks')
    bare = {name: os.environ[name] for name in ('PATH', 'HOME') if name in os.environ}
    # The Python of the tests, because this checkout need not have an environment of its own.
    done = subprocess.run(
        ['sh', '-c', line.replace(' /', f' {sys.executable} /', 1) + ' --once'], env=bare,
        capture_output=True, text=True, timeout=240.0, check=False, cwd=ROOT.parent)
    assert (done.returncode, done.stderr) == (0, '')
    message, end = yaml.safe_load_all(done.stdout)
    assert (message['header']['frame_id'], end) == ('sensor', None)
    assert message['header']['stamp']['sec'] > 0


def test_topics_are_listed_with_types_and_endpoints(ros2):
    code, out, _ = ros2('topic', 'list', '-t', *WHOLE)
    listed = dict(row.split(' ') for row in out.splitlines())
    assert code == 0
    assert (listed['/tracks'], listed['/image_raw']) == (f'[{ARRAY}]', '[sensor_msgs/msg/Image]')
    assert list(listed) == sorted(listed)
    rows = ros2('topic', 'list', '-v', *WHOLE)[1].split('Subscribed topics:')
    for part, kind in zip(rows, ('publisher', 'subscriber')):
        assert f' * /detections [{ARRAY}] ' in part
        assert f' 1 {kind}\n' in part
    _, out, _ = ros2('topic', 'info', '-v', '/tracks')
    assert (numbers(out, 'Publisher count'), numbers(out, 'Subscription count')) == ([1], [1])
    assert re.findall('Node name: (.*)', out) == ['tracker', 'evaluator']
    assert re.findall('Reliability: (.*)', out) == ['RELIABLE', 'RELIABLE']
    code, _, err = ros2('topic', 'info', '/nowhere', '--spin-time', '0.05')
    assert code == 1
    assert f'ROS domain {own_domain()} ' in err


def test_messages_are_echoed_whole_or_by_field(ros2):
    code, out, _ = ros2('topic', 'echo', '--once', '/ground_truth/odometry')
    message, _ = yaml.safe_load_all(out)
    assert (code, message['child_frame_id']) == (0, 'object')
    assert len(message['twist']['covariance']) == 36
    _, out, _ = ros2('topic', 'echo', '--once', 'image_raw', '--field', 'width')
    assert out == '20\n---\n'
    code, out, err = ros2('topic', 'echo', '--once', '/image_raw', '--field', 'size')
    assert (code, out) == (1, '')
    assert 'height, width' in err
    _, out, _ = ros2('topic', 'echo', '/clock', '--timeout', '2', '--csv')
    assert len(out.splitlines()) > RATE_HZ / 2
    code, _, err = ros2('topic', 'echo', '/nowhere', '--spin-time', '0.05')
    assert (code, err.count('\n')) == (1, 1)


def test_rate_is_that_of_the_run(ros2, monkeypatch):
    out = figures_of(ros2, monkeypatch, 'topic', 'hz', '/image_raw')
    assert numbers(out, 'average rate')[-1] == pytest.approx(RATE_HZ, rel=0.2)


def test_delay_in_data_time_is_less_than_a_few_frames(ros2, monkeypatch):
    out = figures_of(ros2, monkeypatch, 'topic', 'delay', '/tracks', '-s', '-w', '10')
    assert abs(numbers(out, 'average delay')[-1]) < 60.0  # frames are a second of data time


def test_nodes_are_listed_and_described(ros2):
    assert ros2('node', 'list', *WHOLE) == (0, '\n'.join(NODES) + '\n', '')
    code, out, _ = ros2('node', 'info', '/tracker')
    titles = re.findall('^  (.+):$', out, re.MULTILINE)
    assert titles == ['Subscribers', 'Publishers', 'Service Servers', 'Service Clients',
                      'Action Servers', 'Action Clients']
    read, published, *_ = re.split('^  .+:$', out, flags=re.MULTILINE)[1:]
    assert f'    /detections: {ARRAY}\n' in read
    assert f'    /tracks: {ARRAY}\n' in published
    code, _, err = ros2('node', 'info', '/nobody', '--spin-time', '0.05')
    assert code == 1
    assert '/nobody' in err


def test_parameters_are_read_described_and_set(ros2):
    names = [row.strip() for row in ros2('param', 'list', '/cdt_detector')[1].splitlines()]
    assert names == sorted(names)
    assert {'false_alarm_prob', 'sensor.snr_db', 'operating_point'} < set(names)
    rows = ros2('param', 'list', '--filter', 'sensor.snr', '--param-type')[1].splitlines()
    assert '  sensor.snr_db (type: double)' in rows
    assert '/cdt_detector:' in rows
    dumped = yaml.safe_load(ros2('param', 'dump', 'cdt_detector')[1])
    assert dumped['/cdt_detector']['ros__parameters']['sensor']['snr_db'] == 20.0
    assert ros2('param', 'get', '/cdt_detector', 'false_alarm_prob') == (
        0, 'Double value is: 0.01\n', '')
    assert ros2('param', 'set', '/cdt_detector', 'false_alarm_prob', '0.02') == (
        0, 'Set parameter successful\n', '')
    assert ros2('param', 'get', '/cdt_detector', 'false_alarm_prob', '--hide-type')[1] == '0.02\n'
    code, out, err = ros2('param', 'set', '/cdt_detector', 'false_alarm_prob', '2.0')
    assert (code, out) == (1, '')
    assert err.startswith('Setting parameter failed: false_alarm_prob')
    _, out, _ = ros2('param', 'describe', '/cdt_detector', 'false_alarm_prob', 'beta')
    assert out.split('Parameter name: ')[1].startswith('false_alarm_prob\n  Type: double\n')
    assert '    Min value: 0.0\n    Max value: 1.0\n' in out
    assert '    Read only: true\n' in out.split('Parameter name: ')[2]


def test_states_of_managed_nodes_are_read_and_changed(ros2):
    managed = NODES[1:]
    assert ros2('lifecycle', 'nodes', *WHOLE) == (0, '\n'.join(managed) + '\n', '')
    states = ros2('lifecycle', 'get', *WHOLE)[1].splitlines()
    assert states == [f'{name}: active [3]' for name in managed]
    code, _, err = ros2('lifecycle', 'set', '/tracker', 'paint')
    assert code == 1
    assert '- deactivate [4]' in err.splitlines()
    assert ros2('lifecycle', 'set', '/tracker', 'deactivate') == (
        0, 'Transitioning successful\n', '')
