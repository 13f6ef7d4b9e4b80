# SPDX-License-Identifier: Apache-2.0
"""What a replay must know about a bag before it starts: from its metadata and its frames."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lowsnr_bringup.bags.bag_frames import BagFrames
from lowsnr_bringup.bags.bag_frames import check_type
from lowsnr_bringup.bags.bag_frames import COMPRESSED
from lowsnr_bringup.bags.bag_frames import IMAGE
from lowsnr_bringup.bags.bag_frames import read_frames
from lowsnr_bringup.bags.reader import Bag
from lowsnr_bringup.bags.recording import CUSTOM_PARAMETERS
from lowsnr_bringup.plan.recorded_frames import FRAMES
from lowsnr_bringup.plan.recorded_frames import RecordedRun
from lowsnr_common.settings.text import load_yaml
from lowsnr_common.settings.text import one_line
import numpy as np

ARRAY = 'vision_msgs/msg/Detection2DArray'
CAMERA_INFO = 'sensor_msgs/msg/CameraInfo'


def inspect_bag(path: Path, frames_topic: str | None, truth_topic: str) -> RecordedRun:
    """
    Read through a bag, and return what it holds.

    Parameters
    ----------
    path
        Folder of the bag, or a storage file.
    frames_topic, truth_topic
        Their names in the bag; None for the frames of the run that was recorded.

    Raises
    ------
    UnusableFile
        With a reason of :class:`~lowsnr_bringup.bags.reader.Bag` or :func:`check_type`, or
        ``no frames``, ``stamps`` of which no two are in order, ``size`` of a frame that is not
        that of the first one, or that of a malformed image.

    """
    with Bag(path) as bag:
        parameters = recorded_parameters(bag)
        frames_topic = frames_topic or recorded_frames_topic(bag, parameters)
        check_type(bag, frames_topic, (IMAGE, COMPRESSED), '--frames-topic')
        truth = truth_topic in bag.topics
        if truth:
            check_type(bag, truth_topic, (ARRAY,), '--truth-topic')
        frames = read_frames(bag, frames_topic)
        evaluator = parameters.get('/evaluator', {})
        raw = not evaluator or '/conditioner' in parameters
        told = _read_truth(bag, truth_topic, frames, raw) if truth else []
        steps_s = np.diff(frames.stamps_ns[frames.kept]) / 1e9
        out = np.setdiff1d(np.arange(len(frames.stamps_ns)), frames.kept)
        return RecordedRun(
            name=one_line(evaluator.get('scenario') or path.resolve().stem),
            frames=len(frames.kept), rows=frames.shape[0], cols=frames.shape[1],
            period_s=float(np.median(steps_s)) if steps_s.size else 1.0,
            truth=truth, encoding=frames.encoding, raw=raw,
            simulated='/sensor' in parameters or bool(
                parameters.get('/player', {}).get('simulated')),
            seed=evaluator.get('seed'),
            notes=(*bag.notes, *filter(None, [frames.note(frames_topic), *told])),
            frames_topic=frames_topic, left_out=tuple(map(int, out)), blank=frames.blank,
            sensor={k: v for k, v in evaluator.items() if k.startswith('sensor.')})


def _read_truth(bag: Bag, topic: str, frames: BagFrames, raw: bool) -> list[str]:
    """Read all truth; return what is wrong with that of a camera, whose truth is in pixels."""
    stamps_ns, outside, count = set(), 0, 0
    rows, cols = frames.shape
    for message in bag.messages({topic, f'{topic}/odometry'}):
        read = bag.read(message)
        if message.topic != topic:
            continue
        stamps_ns.add(read.header.stamp.sec * 1_000_000_000 + read.header.stamp.nanosec)
        for item in read.detections:
            place = item.bbox.center.position
            inside = -0.5 <= place.x < cols - 0.5 and -0.5 <= place.y < rows - 0.5
            count, outside = count + 1, outside + (not inside)
    found = []
    if raw and outside:
        found.append(f'{topic}: {outside} of {count} positions are outside the picture of {cols} '
                     f'x {rows} pixels, and count as missed')
    if raw and stamps_ns and not stamps_ns & {*frames.stamps_ns.tolist()}:
        found.append(f'{topic}: no message has the stamp of a frame, so that nothing can be hit; '
                     '--truth FILE joins truth by the nearest time')
    return found


def frames_of(path: Path, frames_topic: str | None) -> BagFrames:
    """Return the frames of a bag; raises as :func:`inspect_bag`."""
    with Bag(path) as bag:
        topic = frames_topic or recorded_frames_topic(bag, recorded_parameters(bag))
        check_type(bag, topic, (IMAGE, COMPRESSED), '--frames-topic')
        return read_frames(bag, topic)


def recorded_frames_topic(bag: Bag, parameters: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the topic of the frames that entered a recorded run, by its parameters."""
    topics = parameters.get('/recorder', {}).get('topics')
    first = str(topics[0]) if isinstance(topics, list) and topics else FRAMES
    return first if first in bag.topics else FRAMES


def recorded_parameters(bag: Bag) -> dict[str, dict[str, Any]]:
    """Return the parameters of the recorded run by node; nothing where the bag has none."""
    try:
        tree = load_yaml(bag.custom.get(CUSTOM_PARAMETERS, '{}'))
        return {str(node): {str(key): value for key, value in body['ros__parameters'].items()}
                for node, body in tree.items()}
    except (AttributeError, KeyError, TypeError, ValueError):
        bag.notes.append(f'{bag.path}: the parameters of its run cannot be read')
        return {}
