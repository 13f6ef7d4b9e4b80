# SPDX-License-Identifier: Apache-2.0
"""Joins the messages of each frame by their stamp, whatever the order they arrive in."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from dataclasses import field
from enum import Enum

from lowsnr_common.core.records import Estimate
from lowsnr_common.core.timeline import StampOrder
from lowsnr_common.core.timeline import Timeline

# Frames that are kept while their key array has not arrived: answers may arrive before it.
_MOST_UNKNOWN = 1000


class Arrival(Enum):
    """Whether a message is used, or why not."""

    USED = 'used'
    LATE = 'late'
    REPEATED = 'repeated'


@dataclass
class Frame:
    """
    What has arrived of one frame.

    ``arrays`` holds the entries of each topic's array, ``states`` the estimates of its odometry
    by id, ``arrived_s`` the wall time of each array [s].
    """

    stamp: int
    arrays: dict[str, list[Estimate]] = field(default_factory=dict)
    states: dict[str, dict[str, Estimate]] = field(default_factory=dict)
    arrived_s: dict[str, float] = field(default_factory=dict)

    def answer(self, topic: str) -> list[Estimate] | None:
        """
        Return a topic's entries with their velocities.

        An entry with an id has an odometry of that id; None while anything is missing.
        """
        if not self.is_answered(topic):
            return None
        states = self.states.get(topic, {})
        return [
            Estimate(states[e.id].state, states[e.id].cov, e.score, e.id) if e.id else e
            for e in self.arrays[topic]
        ]

    def is_answered(self, topic: str) -> bool:
        """Return whether a topic's array has arrived, and the odometry of all its entries."""
        return topic in self.arrays and not self.lacks_states(topic)

    def lacks_states(self, topic: str) -> bool:
        """Return whether an entry of a topic's array has an odometry that has not arrived."""
        states = self.states.get(topic, {})
        return any(e.id and e.id not in states for e in self.arrays.get(topic, ()))


class FrameJoin:
    """
    Frames of which messages are still expected.

    A frame is complete when every topic has answered it that still can.  The join gives a frame
    up when it is too old, and when a later frame is complete: arrays arrive in order among
    themselves, and so do odometries.  Between the two there is no order.  An array therefore
    waits for its odometry, and later frames wait with it, until the odometry of a later frame
    shows that it will not arrive.

    Parameters
    ----------
    topics
        Names of the topics that answer every frame.
    key
        The topic whose array shows that a frame exists.
    done
        Stamp of the last frame that is done already [ns].
    lag
        Frames that must come after a frame before the last answer about it does.

    """

    def __init__(
        self, topics: Iterable[str], key: str, done: int = -1, lag: int = 0,
    ) -> None:
        self._topics = tuple(topics)
        self._key, self._lag = key, lag
        self._frames: dict[int, Frame] = {}
        self._unknown: dict[int, None] = {}  # stamps of those whose key array has not arrived
        self._changed: set[int] = set()  # since frames were last taken
        self._complete = -1  # stamp of the newest frame that was complete
        self._newest_state = dict.fromkeys(self._topics, -1)  # newest stamps of odometry
        self._done = done
        self._timeline = Timeline(done)
        self._unanswered = dict.fromkeys(self._topics, -1)  # no answers to frames up to these
        self._set_aside: list[Frame] = []  # frames from before the clock was set back

    def add_array(self, topic: str, stamp: int, entries: list[Estimate], now_s: float) -> Arrival:
        """Add an array with its stamp [ns] and the wall time of its arrival [s]."""
        if topic == self._key and self._timeline.classify(stamp, now_s) is StampOrder.SET_BACK:
            self._restart_at(stamp)
        frame = self._frame(stamp)
        if frame is None:
            return Arrival.LATE
        if topic in frame.arrays:
            return Arrival.REPEATED
        if topic == self._key:
            self._unknown.pop(stamp)
        frame.arrays[topic] = entries
        frame.arrived_s[topic] = now_s
        return Arrival.USED

    def add_state(self, topic: str, stamp: int, state: Estimate) -> Arrival:
        """Add an odometry with its stamp [ns]."""
        frame = self._frame(stamp)
        if frame is None:
            return Arrival.LATE
        frame.states.setdefault(topic, {})[state.id] = state
        self._newest_state[topic] = max(self._newest_state.get(topic, -1), stamp)
        return Arrival.USED

    def take(self, older_than_s: float = -float('inf')) -> list[Frame]:
        """
        Remove and return, oldest first, the frames of which nothing more is expected.

        These are the frames that the last one they waited for followed before ``older_than_s``
        [s], themselves without a lag; those up to the newest complete one or to the first whose
        odometry is still expected; and those that waited when the clock was set back.
        """
        taken, self._set_aside = self._set_aside, []
        # Only these can have become complete: with many frames waiting, each message checks one.
        changed, self._changed = self._changed, set()
        complete = [stamp for stamp in changed
                    if stamp in self._frames and self._is_complete(self._frames[stamp])]
        self._complete = max([self._complete, *complete])
        old = self._arrived_before(older_than_s) if older_than_s > -float('inf') else []
        too_old = max(sorted(old)[:max(len(old) - self._lag, 0)], default=-1)
        newest = max(self._complete, too_old)
        if newest <= self._done:
            return taken
        for stamp in sorted(s for s in self._frames if s <= newest):
            if stamp > too_old and self._expects_states(self._frames[stamp]):
                break
            self._done = stamp
            self._unknown.pop(stamp, None)
            taken.append(self._frames.pop(stamp))
        return taken

    def end_frames(self) -> None:
        """Expect no more frames: answers wait for none any more."""
        self._lag = 0

    def expect_no_more(
        self, topics: Iterable[str], before_s: float, source: str | None = None,
    ) -> None:
        """
        Expect no answer of topics to frames of which an array arrived before a time [s].

        It is the array of ``source``, which the topics answer; the key array if None.
        """
        known = self._arrived_before(before_s, source)
        for topic in topics:
            self._unanswered[topic] = max([self._unanswered[topic], *known])
        self._changed.update(known)

    def _restart_at(self, stamp: int) -> None:
        """Continue from a stamp that is earlier than those of frames that are done."""
        self._set_aside += [
            self._frames[late] for late in sorted(self._frames)
            if self._key in self._frames[late].arrays]
        self._frames.clear()
        self._unknown.clear()
        self._unanswered = dict.fromkeys(self._topics, -1)
        self._newest_state = dict.fromkeys(self._topics, -1)
        self._complete = -1
        self._done = stamp - 1

    def _frame(self, stamp: int) -> Frame | None:
        """Return the frame of a stamp, a new one where there is none; None if it is done."""
        if stamp <= self._done:
            return None
        if stamp not in self._frames:
            self._frames[stamp] = Frame(stamp)
            self._unknown[stamp] = None
            if len(self._unknown) > _MOST_UNKNOWN:
                oldest = next(iter(self._unknown))
                del self._unknown[oldest], self._frames[oldest]
        self._changed.add(stamp)
        return self._frames[stamp]

    def _arrived_before(self, time_s: float, topic: str | None = None) -> list[int]:
        """Return the stamps of the frames whose key or other array arrived before a time [s]."""
        return [stamp for stamp, frame in self._frames.items()
                if frame.arrived_s.get(topic or self._key, time_s) < time_s]

    def _expects_states(self, frame: Frame) -> bool:
        """Return whether odometry that the arrays of a frame name can still arrive."""
        return any(
            frame.stamp > self._unanswered[topic] and frame.stamp >= self._newest_state[topic]
            and frame.lacks_states(topic) for topic in self._topics)

    def _is_complete(self, frame: Frame) -> bool:
        return all(
            frame.stamp <= self._unanswered[topic] or frame.is_answered(topic)
            for topic in self._topics)
