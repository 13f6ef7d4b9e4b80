"""Time that jumps, in the data and on the machine: the graph goes on from there."""

from functools import partial
import signal

from builtin_interfaces.msg import Time
from intruder import FUTURE_S
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
# Who counts the stamps.
READERS = (('/cdt_detector', '/image_raw'), ('/tracker', '/detections'),
           *(('/evaluator', topic) for topic in ('/ground_truth', '/detections', '/tracks')))


def went_back(intruder, times):
    """Return whether detector and tracker went on from a clock set back so many times."""
    return all(int(intruder.counts(node).get('set back', 0)) >= times
               for node in ('/cdt_detector', '/tracker'))


def test_one_stamp_of_a_far_future_costs_a_few_frames(bringup, intruder):
    run = bringup(*RUN)
    run.wait_for_rows(20)
    for topic, kind in TOPICS.items():
        intruder.connect(kind, topic)
    for node, topic in READERS:  # a reader may learn of a writer later than the writer of it
        intruder.wait(partial(intruder.told, node, f'{topic}: 2 publishers', '/intruder'))
    jumps = 3
    for n in range(jumps):
        header = Header(stamp=Time(sec=FUTURE_S + n))
        for topic, kind in TOPICS.items():
            future = kind(header=header)
            if kind is Image:
                future = messages.frame_to_image(np.zeros((20, 20)), header)
            intruder.send(topic, future, 'far future')
        intruder.wait(partial(went_back, intruder, n + 1))
        intruder.wait(partial(first_answer_after, run, intruder.newest_s('/image_raw')))
    run.process.send_signal(signal.SIGINT)
    check_end(run, 130)
    stamps = [float(row.split(',')[1]) for row in run.rows()[::2]]
    true = [stamp for stamp in stamps if stamp < FUTURE_S]
    assert true == sorted(set(true))
    # Truth, detector and tracker each take ten messages for theirs.
    assert max(true) - len(true) <= jumps * SET_BACK_AFTER
    silent = [row for row in run.rows() if not row.split(',')[5] and float(
        row.split(',')[1]) < FUTURE_S]
    assert len(silent) <= 2 * jumps * 3 * SET_BACK_AFTER


def test_clock_of_the_machine_may_be_set(bringup, machine):
    run = bringup(*RUN)
    run.wait_for_rows(20)
    for hours in (-1, 24, -1000, 0):
        machine.set_clock(hours)
        run.wait_for_rows(len(run.rows()) + 40, within_s=30.0)
    lines = interrupt(run)
    check_end(run, 130)
    check_frames(run, lines)


def test_nodes_that_die_are_heard_again_after_the_clock_was_set_back(bringup, intruder, machine):
    run = bringup(*RUN)
    run.wait_for_rows(20)
    for hours in (24, 0):
        machine.set_clock(hours)
        run.wait_for_rows(len(run.rows()) + 40)
    for restarts, module in enumerate(('detector_node', 'tracker_node'), start=1):
        run.kill(module)
        run.wait_for_restarts(restarts)
        newest = float(run.rows()[-1].split(',')[1])
        intruder.wait(partial(first_answer_after, run, newest), within_s=20.0)
    run.process.send_signal(signal.SIGINT)
    check_end(run, 130)
