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
from lowsnr_eval.scoring.scene import SceneWriter
import numpy as np


def score_bag(bag: Bag, chains: RecordedChains, scorer: RunScorer) -> None:
    """
    Score what an open bag holds of these chains with their scorer.

    Raises
    ------
    ValueError
        One line, if a message is not of the type that the bag declares.

    """
    pictures = _Pictures(bag, chains, scorer.scene)
    states = {f'{own}/odometry': topic for own, topic in chains.names.items()}
    cell_size_m = chains.evaluation.sensor.cell_size_m
    for message in bag.messages({*pictures.topics, *chains.names, *states}):
        if message.topic in pictures.topics and scorer.scene.full:
            continue
        read = bag.read(message)
        stamp = messages.stamp_key(read.header.stamp)
        # A malformed message is rejected here as in a live run; its frame lacks it.
        with suppress(Malformed):
            if message.topic in pictures.topics:
                pictures.add(message.topic, stamp, read)
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
    scorer.score(float('inf'))


class _Pictures:
    """The frames of a bag, and their conditioned cells with their maps, for a scene."""

    def __init__(self, bag: Bag, chains: RecordedChains, scene: SceneWriter) -> None:
        self._frames_topic, self._scene = chains.frames_topic, scene
        self.topics = {chains.frames_topic, *chains.cells_topics}
        self._maps: dict[int, FrameMap] = {}

    def add(self, topic: str, stamp: int, message: Any) -> None:
        """Add a message of a topic; Malformed for one that cannot be used."""
        if topic == self._frames_topic:
            self._scene.add_frame(stamp, _pixels(message))
        elif topic.endswith('camera_info'):
            self._maps[stamp] = info_to_map(message)
        elif where := self._maps.pop(stamp, None):
            self._scene.add_cells(stamp, image_to_array(message), where)


def _pixels(image: Any) -> np.ndarray:
    """Return the pixels of an image, compressed or not."""
    return decode_compressed(image) if hasattr(image, 'format') else image_to_array(image)
