"""The messages of a bag, given to a scorer as the evaluator gives it those of a live run."""

from __future__ import annotations

from contextlib import suppress

from lowsnr_bringup.bags.bag_frames import COMPRESSED
from lowsnr_bringup.bags.reader import Bag
from lowsnr_common.core.frame_map import FrameMap
from lowsnr_common.core.records import Malformed
from lowsnr_common.images.compressed import decode_compressed
from lowsnr_common.ros import messages
from lowsnr_common.ros.frame_maps import info_to_map
from lowsnr_common.ros.images import image_to_array
from lowsnr_eval.scoring.recorded_chains import RecordedChains
from lowsnr_eval.scoring.run_scoring import RunScorer


def score_bag(bag: Bag, chains: RecordedChains, scorer: RunScorer) -> None:
    """
    Score what an open bag holds of these chains with their scorer.

    Raises
    ------
    ValueError
        One line, if a message is not of the type that the bag declares.

    """
    maps: dict[int, FrameMap] = {}
    is_packed = bag.topics.get(chains.frames_topic) == COMPRESSED
    array_of = decode_compressed if is_packed else image_to_array
    states = {f'{own}/odometry': topic for own, topic in chains.names.items()}
    cell_size_m = chains.evaluation.sensor.cell_size_m
    shown = {chains.frames_topic, *chains.cells_topics}
    for message in bag.messages({*shown, *chains.names, *states}):
        if message.topic in shown and scorer.scene.full:
            continue
        read = bag.read(message)
        stamp = messages.stamp_key(read.header.stamp)
        # A malformed message is rejected here as in a live run; its frame lacks it.
        with suppress(Malformed):
            if message.topic == chains.frames_topic:
                scorer.scene.add_frame(stamp, array_of(read))
            elif message.topic in shown and message.topic.endswith('camera_info'):
                maps[stamp] = info_to_map(read)
            elif message.topic in shown:
                if where := maps.pop(stamp, None):
                    scorer.scene.add_cells(stamp, image_to_array(read), where)
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
