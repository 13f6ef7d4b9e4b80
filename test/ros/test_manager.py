# SPDX-License-Identifier: Apache-2.0
"""Bring-up's manager: what it makes of the records about a run's frames."""

import os

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from lowsnr_bringup.plan.parts import Part
from lowsnr_bringup.ros.manager import Manager
from lowsnr_bringup.run.processes import ProcessGroup
from lowsnr_common.core.line import Line
from lowsnr_common.core.records import AlarmRate
from lowsnr_common.ros.bringup_line import DATA_TIME
from lowsnr_common.ros.run_records import ALARM_RATE
from lowsnr_common.ros.run_records import ChainCounts
from lowsnr_common.ros.run_records import FrameScored
from lowsnr_common.ros.run_records import rate_to_message
from lowsnr_common.ros.run_records import SCORED
import pytest
from rclpy.serialization import serialize_message
from ros_nodes import node_domain
from rosgraph_msgs.msg import Clock


@pytest.fixture
def told(monkeypatch, tmp_path):
    """Return a manager, and a function that tells it of a scored frame as the evaluator does."""
    monkeypatch.setenv('ROS_DOMAIN_ID', str(node_domain()))
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    with ProcessGroup(tmp_path, os.environ) as group:
        manager = Manager(group, Part(()), lambda: None, lambda *_: None)
        _, theirs = group.lines.add()
        with theirs:
            yield manager, lambda message, subject=SCORED: Line(theirs).send(
                subject, serialize_message(message))
        manager.close()


def test_record_that_is_no_scored_frame_is_counted_and_named_once(told, capsys):
    manager, tell = told
    for _ in range(3):
        tell(DiagnosticArray())
    tell(FrameScored(10**9, 1, (ChainCounts('cdt', 2, 1),)).to_message())
    manager.spin(0.1)
    assert manager.frames.scored == 1
    assert manager.rejected == {'number of chains': 3}
    line, = capsys.readouterr().err.splitlines()
    assert 'scored' in line
    # Without a source in the run the frames that the evaluator sees are those published.
    ledger = manager.frames.ledger
    ledger.close(1, 1)
    assert (ledger.published, ledger.unseen, ledger.lost) == (1, 0, 0)


def test_source_continues_after_what_it_told_itself_alone(told):
    manager, tell = told
    tell(FrameScored(9 * 10**9, 1, (ChainCounts('cdt', 0, 0),)).to_message())  # a stranger's
    for seconds in (1, 2):
        tell(Clock(clock=Time(sec=seconds)), DATA_TIME)
    manager.spin(0.1)
    assert manager.newest_ns == 2 * 10**9


def test_newest_false_alarm_rate_of_each_detector_is_kept(told, capsys):
    manager, tell = told
    for rate in (AlarmRate(0.01, 0.5), AlarmRate(0.01, 0.02)):
        tell(rate_to_message('/sdt/sdt_detector', rate), ALARM_RATE)
    tell(rate_to_message('/cdt/cdt_detector', AlarmRate(0.01, float('nan'))), ALARM_RATE)
    manager.spin(0.1)
    assert manager.alarm_rates == {'sdt_detector': AlarmRate(0.01, 0.02)}
    assert manager.rejected == {'not a share': 1}
    assert len(capsys.readouterr().err.splitlines()) == 1
