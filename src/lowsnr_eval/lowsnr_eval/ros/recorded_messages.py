"""The messages of a bag given to a judge, as the middleware gives them to the evaluator."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from lowsnr_bringup.bags.reader import Bag
from lowsnr_bringup.bags.reader import Message
from lowsnr_common.core.records import Malformed
from lowsnr_common.ros import messages
from lowsnr_eval.scoring.recorded_chains import RecordedChains
from lowsnr_eval.scoring.run_scoring import Judge


def feed(bag: Bag, chains: RecordedChains, judge: Judge) -> None:
    """
    Have a judge score all that a bag holds.

    Parameters
    ----------
    bag
        The bag, open.
    chains
        What of it is scored.
    judge
        Who scores.

    Raises
    ------
    ValueError
        One line, if a message is not of the type that the bag says it is.

    """
    states = {f'{own}/odometry': topic for own, topic in chains.names.items()}
    cell_size_m = chains.evaluation.sensor.cell_size_m
    for message in bag.messages({chains.frames_topic, *chains.names, *states}):
        frame = message.topic == chains.frames_topic
        if frame and not judge.shows_all:
            continue
        read = bag.read(message)
        stamp = messages.stamp_key(read.header.stamp)
        if frame:
            # A frame that cannot be shown is missing in the report only.
            with suppress(ValueError):
                judge.see(stamp, messages.image_to_frame(read))
        elif message.topic in states:
            # What cannot be believed is missing in the answer, as it is in a run.
            with suppress(Malformed):
                judge.add_state(
                    states[message.topic], stamp, messages.odometry_to_estimate(read, 0.0))
        else:
            with suppress(Malformed):
                _add_array(bag, judge, chains.names[message.topic], message, read, cell_size_m)
        judge.score()
    judge.score(float('inf'))


def _add_array(
    bag: Bag, judge: Judge, topic: str, message: Message, read: Any, cell_size_m: float,
) -> None:
    """Hand an array on, and its entries as states where no odometry was recorded."""
    stamp = messages.stamp_key(read.header.stamp)
    entries = messages.array_to_sound_estimates(read, cell_size_m)
    judge.add_array(topic, stamp, entries, message.logged_ns / 1e9)
    if f'{message.topic}/odometry' not in bag.topics:
        for item in entries:
            judge.add_state(topic, stamp, item)
