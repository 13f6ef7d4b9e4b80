# SPDX-License-Identifier: Apache-2.0
"""The messages of a bag, given to a scorer as the evaluator gives it those of a live run."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from lowsnr_bringup.bags.reader import Bag
from lowsnr_common.core.frame_map import FrameMap
from lowsnr_common.core.records import Malformed
from lowsnr_common.images.compressed import decode_compressed
from lowsnr_common.ros import messages
from lowsnr_common.ros.frame_maps import info_to_map
from lowsnr_common.ros.images import image_to_array
from lowsnr_eval.scoring.recorded_chains import RecordedChains
from lowsnr_eval.scoring.run_scoring import RunScorer
import numpy as np


def score_bag(bag: Bag, chains: RecordedChains, scorer: RunScorer) -> None:
    """
    Score what an open bag holds of these chains with their scorer.

    Raises
    ------
    ValueError
        One line, if a message is not of the type that the bag declares.

    """
    pictures = _Pictures(chains, scorer)
    states = {f'{own}/odometry': topic for own, topic in chains.names.items()}
    cell_size_m = chains.evaluation.sensor.cell_size_m
    for message in bag.messages({*pictures.topics, *chains.names, *states}):
        if message.topic in pictures.images and scorer.scene.full:
            continue
        read = bag.read(message)
        stamp = messages.stamp_key(read.header.stamp)
        # A malformed message is rejected here as in a live run; its frame lacks it.
        with suppress(Malformed):
            if message.topic in pictures.topics:
                pictures.add(message.topic, stamp, read, message.logged_ns / 1e9)
            elif message.topic in states:
                scorer.add_state(
                    states[message.topic], stamp, messages.odometry_to_estimate(read, 0.0))
            else:
                topic = chains.names[message.topic]
                entries = messages.array_to_sound_estimates(read, cell_size_m)
                scorer.add_array(topic, stamp, entries, message.logged_ns / 1e9)
                # Where the bag has no odometry, entries count as states without velocity.
                for item in () if f'{message.topic}/odometry' in bag.topics else entries:
                    scorer.add_state(topic, stamp, item)
        scorer.score()
    scorer.end_frames()
    scorer.score(float('inf'))


class _Pictures:
    """The frames of a bag, conditioned cells with their maps, and statistics, for a scorer."""

    def __init__(self, chains: RecordedChains, scorer: RunScorer) -> None:
        self._frames_topic, self._scorer = chains.frames_topic, scorer
        self._statistics, self._has_cells = chains.statistics, len(chains.cells_topics) > 1
        self.topics = {chains.frames_topic, *chains.cells_topics, *chains.statistics}
        # Maps are needed to the end of the bag; images until the scene is full.
        self.images = {topic for topic in self.topics if not topic.endswith('camera_info')}
        self._maps: dict[int, FrameMap] = {}

    def add(self, topic: str, stamp: int, message: Any, now_s: float) -> None:
        """Add a message of a topic that arrived at a time [s]; Malformed for an unusable one."""
        if topic == self._frames_topic:
            self._scorer.add_frame(stamp, _pixels(message), now_s)
        elif name := self._statistics.get(topic):
            self._scorer.scene.add_statistic(name, stamp, image_to_array(message))
        elif topic.endswith('camera_info'):
            found = info_to_map(message)
            self._scorer.add_map(stamp, found)
            if self._has_cells and not self._scorer.scene.full:
                self._maps[stamp] = found
        elif where := self._maps.pop(stamp, None):
            self._scorer.scene.add_cells(stamp, image_to_array(message), where)


def _pixels(image: Any) -> np.ndarray:
    """Return the pixels of an image, compressed or not."""
    return decode_compressed(image) if hasattr(image, 'format') else image_to_array(image)
