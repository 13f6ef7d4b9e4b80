"""Put the messages of one frame together again, whatever the order they come in."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from dataclasses import field

from lowsnr_common.core.records import Estimate
from lowsnr_common.core.timeline import StampOrder
from lowsnr_common.core.timeline import Timeline

# Answers to frames that are not known to exist, kept because they may come first.
_MOST_UNKNOWN = 1000


@dataclass
class Frame:
    """
    What has come of one frame.

    ``arrays`` holds the entries of each topic's array, ``states`` the whole states of its
    odometry by id, ``arrived`` the wall time of each array [s].
    """

    stamp: int
    arrays: dict[str, list[Estimate]] = field(default_factory=dict)
    states: dict[str, dict[str, Estimate]] = field(default_factory=dict)
    arrived: dict[str, float] = field(default_factory=dict)

    def answer(self, topic: str) -> list[Estimate] | None:
        """
        Return a topic's entries with their velocities.

        An entry with an id has an odometry of that id; None while anything is missing.
        """
        states = self.states.get(topic, {})
        if not self.is_answered(topic):
            return None
        return [
            Estimate(states[e.id].state, states[e.id].cov, e.score, e.id) if e.id else e
            for e in self.arrays[topic]
        ]

    def is_answered(self, topic: str) -> bool:
        """Return whether a topic's array has come, and the odometry of all its entries."""
        return topic in self.arrays and not self.lacks_states(topic)

    def lacks_states(self, topic: str) -> bool:
        """Return whether an entry of a topic's array has an odometry that has not come."""
        states = self.states.get(topic, {})
        return any(e.id and e.id not in states for e in self.arrays.get(topic, ()))


class Assembly:
    """
    Frames in the making.

    A frame is whole when every topic has answered it that still can.  It is given up when it is
    too old, or when a later frame is whole, since arrays come in order among themselves, as
    odometry does.  Between the two there is no order: an array waits for its odometry, and later
    frames with it, until that of a later frame shows that it will not come.

    Parameters
    ----------
    topics
        Names of the topics that answer every frame.
    key
        The topic whose array says that a frame exists.
    done
        Stamp of the last frame that is done already [ns].

    """

    def __init__(self, topics: Iterable[str], key: str, done: int = -1) -> None:
        self._topics = tuple(topics)
        self._key = key
        self._frames: dict[int, Frame] = {}
        self._unknown: dict[int, None] = {}  # stamps of those whose key array has not come
        self._changed: set[int] = set()  # since frames were last taken
        self._ready = -1  # stamp of the newest frame that was whole
        self._stated = dict.fromkeys(self._topics, -1)  # newest stamps of odometry
        self._done = done
        self._timeline = Timeline(done)
        self._mute = dict.fromkeys(self._topics, -1)  # stamps up to which nothing will come
        self._left: list[Frame] = []  # of before the clock was set back

    def add_array(self, topic: str, stamp: int, entries: list[Estimate], now_s: float) -> bool:
        """Take an array; False if its frame is done already or the array is a second one."""
        if topic == self._key and self._timeline.classify(stamp) is StampOrder.SET_BACK:
            self._set_back(stamp)
        frame = self._frame(stamp)
        if frame is None or topic in frame.arrays:
            return False
        if topic == self._key:
            self._unknown.pop(stamp)
        frame.arrays[topic] = entries
        frame.arrived[topic] = now_s
        return True

    def add_state(self, topic: str, stamp: int, state: Estimate) -> bool:
        """Take an odometry; False if its frame is done already."""
        frame = self._frame(stamp)
        if frame is None:
            return False
        frame.states.setdefault(topic, {})[state.id] = state
        self._stated[topic] = max(self._stated.get(topic, -1), stamp)
        return True

    def take(self, older_than_s: float = -float('inf')) -> list[Frame]:
        """
        Return, oldest first, the frames to be scored now.

        These are the frames whose key array came before ``older_than_s`` [s], those up to the
        newest that is whole or the first whose odometry is on its way, and those that were
        waiting when the clock was set back.
        """
        left, self._left = self._left, []
        # Only these can have become whole: of many that wait, each message looks at one.
        changed, self._changed = self._changed, set()
        whole = [stamp for stamp in changed
                 if stamp in self._frames and self._is_whole(self._frames[stamp])]
        self._ready = max([self._ready, *whole])
        old = self._before(older_than_s) if older_than_s > -float('inf') else []
        too_old = max(old, default=-1)
        newest = max(self._ready, too_old)
        if newest <= self._done:
            return left
        for stamp in sorted(s for s in self._frames if s <= newest):
            if stamp > too_old and self._is_expected(self._frames[stamp]):
                break
            self._done = stamp
            self._unknown.pop(stamp, None)
            left.append(self._frames.pop(stamp))
        return left

    def expect_no_more(self, topics: Iterable[str], before_s: float) -> None:
        """Expect no answer of topics to frames whose key array came before a time [s]."""
        known = self._before(before_s)
        for topic in topics:
            self._mute[topic] = max([self._mute[topic], *known])
        self._changed.update(known)

    def _set_back(self, stamp: int) -> None:
        """Go on from a stamp that lies before those of frames that are done."""
        self._left += [
            self._frames[late] for late in sorted(self._frames)
            if self._key in self._frames[late].arrived]
        self._frames.clear()
        self._unknown.clear()
        self._mute = dict.fromkeys(self._topics, -1)
        self._stated = dict.fromkeys(self._topics, -1)
        self._ready = -1
        self._done = stamp - 1

    def _frame(self, stamp: int) -> Frame | None:
        if stamp <= self._done:
            return None
        if stamp not in self._frames:
            self._frames[stamp] = Frame(stamp)
            self._unknown[stamp] = None
            if len(self._unknown) > _MOST_UNKNOWN:  # forget the oldest
                oldest = next(iter(self._unknown))
                del self._unknown[oldest], self._frames[oldest]
        self._changed.add(stamp)
        return self._frames[stamp]

    def _before(self, time_s: float) -> list[int]:
        """Return the stamps of frames whose key array came before a time [s]."""
        return [stamp for stamp, frame in self._frames.items()
                if frame.arrived.get(self._key, time_s) < time_s]

    def _is_expected(self, frame: Frame) -> bool:
        """Return whether odometry of what its arrays name can still come."""
        return any(
            frame.stamp > self._mute[topic] and frame.stamp >= self._stated[topic]
            and frame.lacks_states(topic) for topic in self._topics)

    def _is_whole(self, frame: Frame) -> bool:
        return all(
            frame.stamp <= self._mute[topic] or frame.is_answered(topic)
            for topic in self._topics)
