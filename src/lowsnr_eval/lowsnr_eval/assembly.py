"""Put the messages of one frame together again, whatever the order they come in."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from dataclasses import field

from lowsnr_sensor.records import Estimate
from lowsnr_sensor.timeline import Timeline
from lowsnr_sensor.timeline import Verdict

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
        entries, states = self.arrays.get(topic), self.states.get(topic, {})
        if entries is None or any(e.id and e.id not in states for e in entries):
            return None
        return [
            Estimate(states[e.id].state, states[e.id].cov, e.score, e.id) if e.id else e
            for e in entries
        ]


class Assembly:
    """
    Frames in the making.

    A frame is whole when every topic has answered it that still can.  It is given up when a
    later frame is whole, since each topic answers in order, or when it is too old.

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
        self._changed: set[int] = set()  # since frames were last taken
        self._done = done
        self._timeline = Timeline(done)
        self._mute = dict.fromkeys(self._topics, -1)  # stamps up to which nothing will come
        self._left: list[Frame] = []  # of before the clock was set back

    def add_array(self, topic: str, stamp: int, entries: list[Estimate], now_s: float) -> bool:
        """Take an array; False if its frame is done already or the array is a second one."""
        if topic == self._key and self._timeline.judge(stamp) is Verdict.SET_BACK:
            self._set_back(stamp)
        frame = self._frame(stamp)
        if frame is None or topic in frame.arrays:
            return False
        frame.arrays[topic] = entries
        frame.arrived[topic] = now_s
        return True

    def add_state(self, topic: str, stamp: int, state: Estimate) -> bool:
        """Take an odometry; False if its frame is done already."""
        frame = self._frame(stamp)
        if frame is None:
            return False
        frame.states.setdefault(topic, {})[state.id] = state
        return True

    def take(self, older_than_s: float = -float('inf')) -> list[Frame]:
        """
        Return, oldest first, the frames to be scored now.

        These are the frames up to the newest that is whole or whose key array came before
        ``older_than_s`` [s], and those that were waiting when the clock was set back.
        """
        left, self._left = self._left, []
        # Only these can have become whole: of many that wait, each message looks at one.
        changed, self._changed = self._changed & self._frames.keys(), set()
        ready = [stamp for stamp in changed if self._is_whole(self._frames[stamp])]
        if older_than_s > -float('inf'):
            ready += [stamp for stamp, frame in self._frames.items()
                      if frame.arrived.get(self._key, older_than_s) < older_than_s]
        if not ready:
            return left
        self._done = max(ready)
        taken = sorted(stamp for stamp in self._frames if stamp <= self._done)
        return left + [self._frames.pop(stamp) for stamp in taken]

    def expect_no_more(self, topics: Iterable[str], before_s: float) -> None:
        """Expect no answer of topics to frames whose key array came before a time [s]."""
        known = [
            stamp for stamp, frame in self._frames.items()
            if frame.arrived.get(self._key, before_s) < before_s]
        for topic in topics:
            self._mute[topic] = max([self._mute[topic], *known])
        self._changed.update(known)

    def _set_back(self, stamp: int) -> None:
        """Go on from a stamp that lies before those of frames that are done."""
        self._left += [
            self._frames[late] for late in sorted(self._frames)
            if self._key in self._frames[late].arrived]
        self._frames.clear()
        self._mute = dict.fromkeys(self._topics, -1)
        self._done = stamp - 1

    def _frame(self, stamp: int) -> Frame | None:
        if stamp <= self._done:
            return None
        if stamp not in self._frames:
            self._frames[stamp] = Frame(stamp)
            self._forget_unknown()
        self._changed.add(stamp)
        return self._frames[stamp]

    def _forget_unknown(self) -> None:
        """Forget the oldest answers to frames that nobody published, where there are many."""
        if len(self._frames) > _MOST_UNKNOWN:
            unknown = [s for s, frame in self._frames.items() if self._key not in frame.arrived]
            for stamp in unknown[:-_MOST_UNKNOWN]:
                del self._frames[stamp]

    def _is_whole(self, frame: Frame) -> bool:
        return all(
            frame.stamp <= self._mute[topic] or frame.answer(topic) is not None
            for topic in self._topics)
