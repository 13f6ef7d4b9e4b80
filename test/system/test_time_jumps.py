# SPDX-License-Identifier: Apache-2.0
"""Time that jumps, in the data and on the host: the graph goes on from there."""

from functools import partial
import signal

from builtin_interfaces.msg import Time
from graph_client import FUTURE_S
from lowsnr_common.core.timeline import SET_BACK_AFTER
from lowsnr_common.ros import messages
import numpy as np
from run_checks import check_end
from run_checks import check_frames
from run_checks import first_answer_after
from run_checks import interrupt
from sensor_msgs.msg import Image
from std_msgs.msg import Header
from vision_msgs.msg import Detection2DArray

RUN = ('--detector', 'cdt', '--scenario', 'three_objects', '--loop', '--rate', '20')
TOPICS = {
    '/image_raw': Image, '/ground_truth': Detection2DArray, '/detections': Detection2DArray,
    '/tracks': Detection2DArray}
# The nodes that count the stamps of a topic.
READERS = (('/cdt_detector', '/image_raw'), ('/tracker', '/detections'),
           *(('/evaluator', topic) for topic in ('/ground_truth', '/detections', '/tracks')))


def went_back(client, times):
    """Return whether detector and tracker went on from a clock set back so many times."""
    return all(int(client.counts(node).get('set back', 0)) >= times
               for node in ('/cdt_detector', '/tracker'))


def test_one_stamp_of_a_far_future_costs_a_few_frames(bringup, client):
    run = bringup(*RUN)
    run.wait_for_rows(20)
    for topic, kind in TOPICS.items():
        client.connect(kind, topic)
    for node, topic in READERS:  # a reader may discover a writer later than the writer it
        client.wait(partial(client.statuses, node, topic, '/graph_client'))
    jumps = 3
    for n in range(jumps):
        header = Header(stamp=Time(sec=FUTURE_S + n))
        for topic, kind in TOPICS.items():
            future = kind(header=header)
            if kind is Image:
                future = messages.frame_to_image(np.zeros((20, 20)), header)
            client.send(topic, future, 'far future')
        client.wait(partial(went_back, client, n + 1))
        client.wait(partial(first_answer_after, run, client.newest_s('/image_raw')))
    run.process.send_signal(signal.SIGINT)
    check_end(run, 130)
    stamps = [float(row.split(',')[1]) for row in run.rows()[::2]]
    true = [stamp for stamp in stamps if stamp < FUTURE_S]
    assert true == sorted(set(true))
    # Truth, detector and tracker each need ten messages to accept the clock.
    assert max(true) - len(true) <= jumps * SET_BACK_AFTER
    silent = [row for row in run.rows() if not row.split(',')[5] and float(
        row.split(',')[1]) < FUTURE_S]
    assert len(silent) <= 2 * jumps * 3 * SET_BACK_AFTER


def test_clock_of_the_host_may_be_set(bringup, host_faults):
    run = bringup(*RUN)
    run.wait_for_rows(20)
    for hours in (-1, 24, -1000, 0):
        host_faults.set_clock(hours)
        run.wait_for_rows(len(run.rows()) + 40)
    lines = interrupt(run)
    check_end(run, 130)
    check_frames(run, lines)


def test_restarted_nodes_answer_after_the_clock_was_set_back(bringup, client, host_faults):
    run = bringup(*RUN)
    run.wait_for_rows(20)
    for hours in (24, 0):
        host_faults.set_clock(hours)
        run.wait_for_rows(len(run.rows()) + 40)
    for restarts, module in enumerate(('detector_node', 'tracker_node'), start=1):
        run.kill(module)
        run.wait_for_restarts(restarts)
        newest = float(run.rows()[-1].split(',')[1])
        client.wait(partial(first_answer_after, run, newest))
    run.process.send_signal(signal.SIGINT)
    check_end(run, 130)
