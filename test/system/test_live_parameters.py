"""A running graph whose parameters are set, over DDS, while frames flow."""

import math
import re
import signal
import time

from diagnostic_msgs.msg import DiagnosticArray
from lowsnr_common.ros.messages import stamp_key
from lowsnr_common.ros.qos import reliable
from onlooker import onlooker
import pytest
from rcl_interfaces.srv import GetParameters
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.parameter import parameter_value_to_python
from vision_msgs.msg import Detection2DArray

DETECTOR = '/cdt_detector'
FRAMES = 500
SECOND = 1_000_000_000


class Operator:
    """Another program on the same host: hears detections, and sets parameters."""

    def __init__(self, node, executor):
        self.node, self.executor = node, executor
        self.declared, self.reports = {}, {}
        node.create_subscription(
            Detection2DArray, 'detections', self._hear, reliable(10_000))
        node.create_subscription(
            DiagnosticArray, '/diagnostics', self._hear_report, reliable(1000))

    def _hear(self, message):
        self.declared[stamp_key(message.header.stamp) // SECOND] = bool(message.detections)

    def _hear_report(self, message):
        for status in message.status:
            counts = {item.key: item.value for item in status.values if item.value.isdigit()}
            self.reports[status.name] = status.message, counts

    def wait(self, condition, within_s=120.0):
        """Take messages until a condition holds."""
        assert self.comes(condition, within_s), self.reports

    def comes(self, condition, within_s):
        """Take messages until a condition holds; return whether it does."""
        until = time.monotonic() + within_s
        while not (holds := condition()) and time.monotonic() < until:
            self.executor.spin_once(timeout_sec=0.1)
        return holds

    def call(self, kind, service, request):
        """Return what a service of a node answers."""
        client = self.node.create_client(kind, service)
        self.wait(client.service_is_ready)
        # An answer is lost where the server has not found the client yet.
        asked = (client.call_async(request) for _ in range(12))
        future = next(future for future in asked if self.comes(future.done, 10.0))
        self.node.destroy_client(client)
        return future.result()

    def set(self, path, name, value):  # noqa: A003
        """Set a parameter; return whether it was taken, and why not."""
        parameter = Parameter(name, value=value).to_parameter_msg()
        result, = self.call(SetParameters, f'{path}/set_parameters', SetParameters.Request(
            parameters=[parameter])).results
        return result.successful, result.reason

    def get(self, path, *names):
        """Return values of parameters."""
        answer = self.call(
            GetParameters, f'{path}/get_parameters', GetParameters.Request(names=names))
        return [parameter_value_to_python(value) for value in answer.values]

    def share(self, first):
        """Return the share of frames with a declaration, of so many from one on."""
        self.wait(lambda: sum(number >= first for number in self.declared) >= FRAMES)
        seen = sorted(number for number in self.declared if number >= first)[:FRAMES]
        return sum(self.declared[number] for number in seen) / FRAMES


@pytest.fixture
def operator():
    """Return another program on the domain of this test."""
    with onlooker('operator') as (node, executor):
        yield Operator(node, executor)


def logged(run, pattern, label='cdt_detector'):
    """Return what a pattern finds in the log of a node."""
    path = run.results / 'log' / f'{label}.log'
    return re.findall(pattern, path.read_text() if path.is_file() else '')


def about(prob):
    """Return what a measured share of empty frames comes to: 4 sigma, calibration included."""
    trials = 1.0 / (1.0 / FRAMES + 1.0 / (400.0 / prob))
    return pytest.approx(prob, abs=4.0 * math.sqrt(prob * (1.0 - prob) / trials))


def test_false_alarm_rate_set_on_a_running_detector_is_the_one_of_its_frames(
        bringup, operator):
    run = bringup('--detector', 'cdt', '--scenario', 'empty', '--snr', '6', '--loop',
                  '--lockstep', '--set', 'cdt.false_alarm_prob=0.02')
    assert operator.share(1) == about(0.02)
    for name, value, why in (
            ('false_alarm_prob', 1.5, 'must be a number in (0.0, 1.0)'),
            ('threshold', 9.0, "threshold does nothing while operating_point is 'matched'"),
            ('alpha', 0.1, 'alpha is read-only while cdt_detector runs')):
        taken, reason = operator.set(DETECTOR, name, value)
        assert not taken
        assert why in reason
    assert operator.share(max(operator.declared)) == about(0.02)
    assert operator.set(DETECTOR, 'false_alarm_prob', 0.3) == (True, '')
    operator.wait(lambda: logged(run, 'in force from frame'))
    first, = logged(run, r'in force from frame (\d+) on: matched, threshold')
    assert operator.share(int(first)) == about(0.3)
    assert operator.get(DETECTOR, 'false_alarm_prob', 'threshold', 'alpha') == [0.3, 4.595, 0.01]
    assert operator.set('/tracker', 'detection.probability', 0.7) == (True, '')
    assert operator.set('/evaluator', 'gate_cells', 9.0) == (
        False, 'gate_cells is read-only while evaluator runs; set it at the start: '
        '--set evaluator.gate_cells=VALUE')
    assert logged(run, r'set false_alarm_prob = 0.3 \(was 0.02\)')
    assert len(set(logged(run, 'not set: .*'))) == 3
    operator.wait(lambda: logged(run, r'in force from frame \d+ on; all tracks', 'tracker'))
    run.process.send_signal(signal.SIGINT)
    code, _, err = run.finish(within_s=30.0)
    assert (code, 'Traceback' in err) == (130, False)
    assert run.summary()['frames']['unanswered'] == 0


def test_a_detector_started_again_has_what_was_set_while_it_ran(bringup, operator):
    run = bringup('--detector', 'cdt', '--scenario', 'empty', '--loop', '--lockstep')
    run.wait_for_rows(20)
    assert operator.set(DETECTOR, 'operating_point', 'manual') == (True, '')
    assert operator.set(DETECTOR, 'threshold', -50.0) == (True, '')
    operator.wait(lambda: operator.declared and operator.declared[max(operator.declared)])
    run.kill('detector_node')
    run.wait_for_restarts(1)
    back = max(operator.declared) + 1
    operator.wait(lambda: max(operator.declared) > back + 50)
    # Below all noise: every frame declares.
    assert not [number for number, declares in operator.declared.items()
                if number >= back and not declares]
    run.process.send_signal(signal.SIGINT)
    assert run.finish()[0] == 130
