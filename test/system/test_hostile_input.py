# SPDX-License-Identifier: Apache-2.0
"""A client publishes malformed messages on every topic: the graph rejects them and runs on."""

from functools import partial

from diagnostic_msgs.msg import DiagnosticStatus
from graph_client import GraphClient
from graph_runs import own_domain
from lowsnr_common.ros.qos import reliable
from malformed_messages import BY_TYPE
from malformed_messages import raw
from malformed_messages import stamps
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
from tally import FAULTS
from vision_msgs.msg import Detection2DArray

INPUTS = {
    '/image_raw': Image, '/ground_truth': Detection2DArray, '/ground_truth/odometry': Odometry,
    '/detections': Detection2DArray, '/detections/odometry': Odometry,
    '/tracks': Detection2DArray, '/tracks/odometry': Odometry}
ROUNDS, LARGE = 4, ('many', 'megabyte', 'thousands')


def malformed(rng):
    """Return topic, message or bytes, and fault of everything that is wrong, shuffled."""
    found = []
    for topic, kind in INPUTS.items():
        broken = BY_TYPE[kind](rng)
        found += [(topic, message, f'{kind.__name__}: {what}')
                  for what, message in broken.items()]
        found += [(topic, kind(header=Header(stamp=stamp)), f'{kind.__name__}: no time to come')
                  for stamp in stamps(rng)]
        whole = broken.get('id of nobody') or next(iter(broken.values()))
        found += [(topic, data, f'{kind.__name__}: bytes, {what}')
                  for what, data in raw(rng, whole).items()]
    return [found[n] for n in rng.permutation(len(found))]


def test_malformed_messages_on_every_topic_end_nothing(bringup, client, tmp_path):
    run = bringup('--detector', 'cdt', '--scenario', 'three_objects', '--rate', '10', '--loop',
                  '--view', '--record', str(tmp_path / 'bag'))
    run.wait_for_rows(10)
    client.node.create_subscription(Image, '/overlay', lambda image: None, reliable(10))
    sent = malformed(np.random.default_rng(11))
    for _ in range(ROUNDS):
        enter(client)
        send(client, sent)
        if not (missing := not_rejected(client)):
            break
        # Some came too late for their stamps, which messages of megabytes cause.
        crowded = any(reason == 'too many entries' for _, _, reason in missing)
        sent = [item for item in sent if item[2].split()[-1] not in LARGE
                or (crowded and item[2].endswith('too many'))]
        leave(client)  # after broken bytes, readers may not receive from this writer any more
    leave(client)
    enter(client)
    for topic in INPUTS:  # last: readers receive nothing that its writer sends after it
        client.send(topic, b'', 'no bytes')
    for topic, node in (('/image_raw', '/sensor'), ('/detections', '/cdt_detector')):
        client.wait(partial(client.statuses, '/evaluator', topic, node, '/graph_client'))
    leave(client)
    wait_for_all_scored(run, client)
    lines = interrupt(run)
    check_end(run, 130)
    assert not missing
    check_frames(run, lines)


def send(client, sent):
    """Send all of it, and take the answers."""
    for topic, message, fault in sent:
        if not isinstance(message, bytes) and 'no time' not in fault:
            message.header.stamp = client.next_stamp(topic)
        client.send(topic, message, fault)
        client.spin(0.02)
    client.spin(2.0)


def enter(client):
    """Start to publish all topics."""
    for topic, kind in INPUTS.items():
        client.connect(kind, topic)


def leave(client):
    """Stop publishing them."""
    for topic in INPUTS:
        client.disconnect(topic)


def not_rejected(client):
    """Return node, topic and reason of what should be rejected, and was not yet."""
    rejected = {
        ('/cdt_detector', 'image_raw'): (
            'wrong encoding', 'wrong step', 'empty frame', 'wrong size', 'change of size',
            'cell not a finite number', 'cell beyond 1e9'),
        ('/tracker', 'detections'): (
            'position or score is not finite', 'score is not in [0, 1]', 'outside the frame')}
    for topic in ('ground_truth', 'detections', 'tracks'):
        rejected['/evaluator', topic] = (
            'no place', 'id of two entries', 'id too long', 'too many entries')
        rejected['/evaluator', f'{topic}/odometry'] = ('no place', 'no velocity', 'id too long')
    return [(node, topic, reason)
            for (node, topic), reasons in rejected.items() for reason in reasons
            if not int(client.counts(node).get(f'{topic} {reason}', 0))]


def test_endpoints_that_do_not_match_are_named_and_may_come_and_go(bringup, client):
    run = bringup('--detector', 'cdt', '--loop', '--rate', '20')
    run.wait_for_rows(20)
    other_qos = client.node.create_publisher(
        Detection2DArray, '/detections', qos_profile_sensor_data)
    client.node.create_subscription(Image, '/image_raw', print, QoSProfile(
        depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
    with GraphClient(own_domain(), 'stranger') as other:
        other.node.create_publisher(Image, '/tracks/odometry', reliable(1))
        for node, *words in (
                ('/tracker', '/detections', '/graph_client', 'Best effort'),
                ('/evaluator', '/detections', '/graph_client', 'Best effort'),
                ('/sensor', '/image_raw', '/graph_client', 'transient local'),
                ('/evaluator', '/tracks/odometry', '/stranger', 'sensor_msgs/msg/Image',
                 'nav_msgs/msg/Odometry')):
            statuses = client.wait(partial(client.statuses, node, *words))
            assert statuses[-1].level == DiagnosticStatus.ERROR
    FAULTS['endpoint that does not match'] += 3
    for _ in range(20):
        for topic, kind in INPUTS.items():
            client.connect(kind, topic)
            client.disconnect(topic)
            FAULTS['publisher that comes and goes'] += 1
    run.wait_for_rows(len(run.rows()) + 40)
    client.wait(partial(
        client.statuses, '/cdt_detector', '/detections', '2 publishers', '/graph_client'))
    client.node.destroy_publisher(other_qos)
    client.wait(lambda: client.level('/cdt_detector') == DiagnosticStatus.OK)
    lines = interrupt(run)
    check_end(run, 130)
    check_frames(run, lines)
