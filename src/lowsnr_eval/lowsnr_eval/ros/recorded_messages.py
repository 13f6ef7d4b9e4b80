"""The messages of a bag, given to a scorer as the evaluator gives it those of a live run."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from lowsnr_bringup.bags.reader import Bag
from lowsnr_bringup.bags.reader import Message
from lowsnr_common.core.records import Malformed
from lowsnr_common.ros import messages
from lowsnr_eval.scoring.recorded_chains import RecordedChains
from lowsnr_eval.scoring.run_scoring import RunScorer


def score_bag(bag: Bag, chains: RecordedChains, scorer: RunScorer) -> None:
    """
    Score all that a bag holds.

    Parameters
    ----------
    bag
        The bag, open.
    chains
        What of it is scored.
    scorer
        The scorer of these chains.

    Raises
    ------
    ValueError
        One line, if a message is not of the type that the bag declares.

    """
    states = {f'{own}/odometry': topic for own, topic in chains.names.items()}
    cell_size_m = chains.evaluation.sensor.cell_size_m
    for message in bag.messages({chains.frames_topic, *chains.names, *states}):
        is_frame = message.topic == chains.frames_topic
        if is_frame and not scorer.keeps_frames:
            continue
        read = bag.read(message)
        stamp = messages.stamp_key(read.header.stamp)
        # A malformed message is rejected here as in a live run; its frame lacks it.
        if is_frame:
            with suppress(ValueError):
                scorer.add_frame(stamp, messages.image_to_frame(read))
        elif message.topic in states:
            with suppress(Malformed):
                scorer.add_state(
                    states[message.topic], stamp, messages.odometry_to_estimate(read, 0.0))
        else:
            with suppress(Malformed):
                _add_array(bag, scorer, chains.names[message.topic], message, read, cell_size_m)
        scorer.score()
    scorer.score(float('inf'))


def _add_array(
    bag: Bag, scorer: RunScorer, topic: str, message: Message, read: Any, cell_size_m: float,
) -> None:
    """Add an array, and its entries as states where the bag has no odometry of them."""
    stamp = messages.stamp_key(read.header.stamp)
    entries = messages.array_to_sound_estimates(read, cell_size_m)
    scorer.add_array(topic, stamp, entries, message.logged_ns / 1e9)
    if f'{message.topic}/odometry' not in bag.topics:
        for item in entries:
            scorer.add_state(topic, stamp, item)
