"""A stranger on the domain publishes what it likes: the graph goes on and says what it refuses."""

from functools import partial

from diagnostic_msgs.msg import DiagnosticStatus
from garbage import BY_TYPE
from garbage import raw
from garbage import stamps
from graph_runs import own_domain
from intruder import INJECTED
from intruder import Intruder
from lowsnr_common.ros.qos import reliable
from nav_msgs.msg import Odometry
import numpy as np
from rclpy.qos import DurabilityPolicy
from rclpy.qos import qos_profile_sensor_data
from rclpy.qos import QoSProfile
from run_checks import check_end
from run_checks import check_frames
from run_checks import interrupt
from run_checks import wait_for_all_scored
from sensor_msgs.msg import Image
from std_msgs.msg import Header
from vision_msgs.msg import Detection2DArray

INPUTS = {
    '/image_raw': Image, '/ground_truth': Detection2DArray, '/ground_truth/odometry': Odometry,
    '/detections': Detection2DArray, '/detections/odometry': Odometry,
    '/tracks': Detection2DArray, '/tracks/odometry': Odometry}
ROUNDS, LARGE = 4, ('many', 'megabyte', 'thousands')


def garbage(rng):
    """Return topic, message or bytes, and fault of everything that can be said, shuffled."""
    said = []
    for topic, kind in INPUTS.items():
        broken = BY_TYPE[kind](rng)
        said += [(topic, message, f'{kind.__name__}: {what}') for what, message in broken.items()]
        said += [(topic, kind(header=Header(stamp=stamp)), f'{kind.__name__}: no time to come')
                 for stamp in stamps(rng)]
        whole = broken.get('id of nobody') or next(iter(broken.values()))
        said += [(topic, data, f'{kind.__name__}: bytes, {what}')
                 for what, data in raw(rng, whole).items()]
    return [said[n] for n in rng.permutation(len(said))]


def test_garbage_on_every_topic_ends_nothing(bringup, intruder, tmp_path):
    run = bringup('--detector', 'cdt', '--scenario', 'three_objects', '--rate', '10', '--loop',
                  '--view', '--record', str(tmp_path / 'bag'))
    run.wait_for_rows(10)
    intruder.node.create_subscription(Image, '/overlay', lambda image: None, reliable(10))
    said = garbage(np.random.default_rng(11))
    for _ in range(ROUNDS):
        enter(intruder)
        say(intruder, said)
        if not (missing := not_refused(intruder)):
            break
        # Some were too late for their stamps; those of megabytes would bring that about.
        crowded = any(reason == 'too many entries' for _, _, reason in missing)
        said = [item for item in said if item[2].split()[-1] not in LARGE
                or (crowded and item[2].endswith('too many'))]
        leave(intruder)  # broken bytes may have made readers deaf to this writer
    leave(intruder)
    enter(intruder)
    for topic in INPUTS:  # last: whatever its writer sends after it, readers never see
        intruder.send(topic, b'', 'no bytes')
    for topic, node in (('/image_raw', '/sensor'), ('/detections', '/cdt_detector')):
        intruder.wait(partial(intruder.told, '/evaluator', topic, node, '/intruder'))
    leave(intruder)
    wait_for_all_scored(run, intruder)
    lines = interrupt(run)
    check_end(run, 130)
    assert not missing
    check_frames(run, lines)


def say(intruder, said):
    """Send all of it, and hear what comes of it."""
    for topic, message, fault in said:
        if not isinstance(message, bytes) and 'no time' not in fault:
            message.header.stamp = intruder.next_stamp(topic)
        intruder.send(topic, message, fault)
        intruder.spin(0.02)
    intruder.spin(2.0)


def enter(intruder):
    """Publish all topics."""
    for topic, kind in INPUTS.items():
        intruder.connect(kind, topic)


def leave(intruder):
    """Publish none of them any more."""
    for topic in INPUTS:
        intruder.leave(topic)


def not_refused(intruder):
    """Return the kinds of garbage that were not refused, by their reason, where it matters."""
    refused = {
        ('/cdt_detector', 'image_raw'): (
            'wrong encoding', 'wrong step', 'empty frame', 'wrong size', 'change of size',
            'cell not a finite number', 'cell beyond 1e9'),
        ('/tracker', 'detections'): (
            'position or score is not finite', 'score is not in [0, 1]', 'outside the frame')}
    for topic in ('ground_truth', 'detections', 'tracks'):
        refused['/evaluator', topic] = (
            'no place', 'id of two entries', 'id too long', 'too many entries')
        refused['/evaluator', f'{topic}/odometry'] = ('no place', 'no velocity', 'id too long')
    return [(node, topic, reason)
            for (node, topic), reasons in refused.items() for reason in reasons
            if not int(intruder.counts(node).get(f'{topic} {reason}', 0))]


def test_strangers_that_do_not_fit_are_named_and_may_come_and_go(bringup, intruder):
    run = bringup('--detector', 'cdt', '--loop', '--rate', '20')
    run.wait_for_rows(20)
    intruder.node.create_publisher(Detection2DArray, '/detections', qos_profile_sensor_data)
    intruder.node.create_subscription(Image, '/image_raw', print, QoSProfile(
        depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
    with Intruder(own_domain(), 'stranger') as other:
        other.node.create_publisher(Image, '/tracks/odometry', reliable(1))
        for node, *words in (
                ('/tracker', '/detections: not heard is /intruder', 'Best effort publisher'),
                ('/evaluator', '/detections: not heard is /intruder', 'Best effort publisher'),
                ('/sensor', '/image_raw: not reached is /intruder', 'transient local'),
                ('/evaluator', '/tracks/odometry: not heard is /stranger, which publishes '
                 'sensor_msgs/msg/Image, not nav_msgs/msg/Odometry')):
            said = intruder.wait(partial(intruder.told, node, *words))
            assert said[-1].level == DiagnosticStatus.ERROR
    INJECTED['endpoint that does not fit'] += 3
    for _ in range(20):
        for topic, kind in INPUTS.items():
            intruder.connect(kind, topic)
            intruder.leave(topic)
            INJECTED['publisher that comes and goes'] += 1
    run.wait_for_rows(len(run.rows()) + 40)
    intruder.wait(lambda: intruder.level('/cdt_detector') == DiagnosticStatus.OK)
    lines = interrupt(run)
    check_end(run, 130)
    check_frames(run, lines)
