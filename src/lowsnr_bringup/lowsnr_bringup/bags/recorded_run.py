"""What a replay must know about a bag before it starts: from its metadata and its frames."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from dataclasses import field
from pathlib import Path
from typing import Any

from lowsnr_bringup.bags.errors import UnusableFile
from lowsnr_bringup.bags.reader import Bag
from lowsnr_bringup.bags.recording import CUSTOM_PARAMETERS
from lowsnr_common.settings.text import load_yaml
from lowsnr_common.settings.text import one_line
import numpy as np

IMAGE, ARRAY = 'sensor_msgs/msg/Image', 'vision_msgs/msg/Detection2DArray'
CAMERA_INFO = 'sensor_msgs/msg/CameraInfo'
_FRAMES = '/image_raw'


@dataclass(frozen=True)
class RecordedRun:
    """
    The frames of a bag or a camera, and the run that they belong to.

    Attributes
    ----------
    name
        Name of the scenario; that of the bag if its metadata do not name a scenario.
    frames
        Their number; 0 for a camera, whose frames have no end.
    rows, cols
        Size of a frame.
    period_s
        Median time between frames [s]; 1 for a single frame.
    truth
        Whether the bag has truth.
    raw
        Whether the frames have a background and noise of their own, and need a conditioner.
    simulated
        Whether the frames are simulated: then the settings of motion apply as they are.
    encoding
        Encoding of the images.
    seed, sensor
        Seed and settings ``sensor.*`` of the run, if the metadata hold them.
    notes : list of str
        A line for each thing that is damaged or missing.
    frames_topic
        Topic of the frames.

    """

    name: str
    frames: int
    rows: int
    cols: int
    period_s: float
    truth: bool
    raw: bool
    simulated: bool = False
    encoding: str = '32FC1'
    seed: int | None = None
    sensor: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    frames_topic: str = _FRAMES


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
        ``no frames``, ``stamps`` that do not increase, or ``size`` of a frame that is not that
        of the first one.

    """
    with Bag(path) as bag:
        parameters = recorded_parameters(bag)
        frames_topic = frames_topic or recorded_frames_topic(bag, parameters)
        check_type(bag, frames_topic, IMAGE, '--frames-topic')
        truth = truth_topic in bag.topics
        if truth:
            check_type(bag, truth_topic, ARRAY, '--truth-topic')
        stamps_ns, (rows, cols), encoding = _read_frames(bag, frames_topic)
        for message in bag.messages({truth_topic, f'{truth_topic}/odometry'} if truth else ()):
            bag.read(message)
        evaluator = parameters.get('/evaluator', {})
        steps_s = np.diff(stamps_ns) / 1e9
        return RecordedRun(
            name=one_line(evaluator.get('scenario') or path.resolve().stem),
            frames=len(stamps_ns), rows=rows, cols=cols,
            period_s=float(np.median(steps_s)) if steps_s.size else 1.0,
            truth=truth, encoding=encoding, raw=not evaluator or '/conditioner' in parameters,
            simulated='/sensor' in parameters or bool(
                parameters.get('/player', {}).get('simulated')),
            seed=evaluator.get('seed'), notes=tuple(bag.notes), frames_topic=frames_topic,
            sensor={k: v for k, v in evaluator.items() if k.startswith('sensor.')})


def check_type(bag: Bag, topic: str, msgtype: str, option: str) -> None:
    """
    Check that a bag has a topic of a type.

    Raises
    ------
    UnusableFile
        With reason ``type`` or ``no topic``; the line names the topics of that type, and the
        option that picks one.

    """
    alike = sorted(name for name, kind in bag.topics.items() if kind == msgtype)
    if topic in bag.topics and topic not in alike:
        raise UnusableFile(
            bag.path, 'type', f'{topic} is of type {bag.topics[topic]}, not {msgtype}')
    if topic not in bag.topics:
        hint = f'; {option} can be {", ".join(alike)}' if alike else ''
        raise UnusableFile(bag.path, 'no topic', f'has no topic {topic} of type {msgtype}{hint}')


def _read_frames(bag: Bag, topic: str) -> tuple[list[int], tuple[int, int], str]:
    """Return the stamps [ns] of the frames, their rows and columns, and their encoding."""
    stamps_ns: list[int] = []
    shape, encoding = (0, 0), ''
    for message in bag.messages({topic}):
        image = bag.read(message)
        stamp_ns = image.header.stamp.sec * 1_000_000_000 + image.header.stamp.nanosec
        where = f'{topic}: frame {len(stamps_ns) + 1}'
        if stamps_ns and stamp_ns <= stamps_ns[-1]:
            raise UnusableFile(
                bag.path, 'stamps', f'{where} has stamp {stamp_ns / 1e9:.9g} s, which is not '
                f'after {stamps_ns[-1] / 1e9:.9g} s of the one before')
        shape = shape if stamps_ns else (image.height, image.width)
        if (image.height, image.width) != shape or not all(shape):
            raise UnusableFile(
                bag.path, 'size', f'{where} has {image.width} x {image.height} pixels'
                + f' after frames of {shape[1]} x {shape[0]}' * all(shape))
        stamps_ns.append(stamp_ns)
        encoding = image.encoding
    if not stamps_ns:
        because = f' ({"; ".join(bag.notes)})' if bag.notes else ''
        raise UnusableFile(bag.path, 'no frames', f'{topic}: no frames{because}')
    return stamps_ns, shape, encoding


def recorded_frames_topic(bag: Bag, parameters: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the topic of the frames that entered a recorded run, by its parameters."""
    topics = parameters.get('/recorder', {}).get('topics')
    first = str(topics[0]) if isinstance(topics, list) and topics else _FRAMES
    return first if first in bag.topics else _FRAMES


def recorded_parameters(bag: Bag) -> dict[str, dict[str, Any]]:
    """Return the parameters of the recorded run by node; nothing where the bag has none."""
    try:
        tree = load_yaml(bag.custom.get(CUSTOM_PARAMETERS, '{}'))
        return {str(node): {str(key): value for key, value in body['ros__parameters'].items()}
                for node, body in tree.items()}
    except (AttributeError, KeyError, TypeError, ValueError):
        bag.notes.append(f'{bag.path}: the parameters of its run cannot be read')
        return {}
