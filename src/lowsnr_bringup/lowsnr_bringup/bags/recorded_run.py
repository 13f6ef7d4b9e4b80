"""What a replay must know of a bag before it starts: found in its metadata and its frames."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from dataclasses import field
from pathlib import Path
from typing import Any

from lowsnr_bringup.bags.reader import Bag
from lowsnr_bringup.bags.recording import CUSTOM_PARAMETERS
from lowsnr_bringup.bags.replaying import ARRAY
from lowsnr_bringup.bags.replaying import IMAGE
from lowsnr_common.settings.text import load_yaml
from lowsnr_common.settings.text import one_line
import numpy as np

_FRAMES = '/image_raw'


@dataclass(frozen=True)
class RecordedRun:
    """
    The frames of a bag, or of a camera, and the run they are of.

    ``name`` is that of the scenario, or of the bag where it does not tell; ``frames`` is 0 where
    there is no end of them; ``period_s`` the
    median time from a frame to the next [s], 1 for a single frame; ``truth`` whether the bag has
    any; ``encoding`` that of the images.  ``raw`` frames have a background and noise of their
    own to be taken off first; for ``simulated`` ones the settings of motion hold as they are.
    ``seed`` and ``sensor``, its settings ``sensor.*``, are those of the run where one is told;
    ``notes`` say what was damaged or missing, one line each; ``frames_topic`` is where the frames
    are.
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
    Look through a bag; None for the frames of the run that it is of.

    Raises
    ------
    ValueError
        One line that names the bag and why its frames cannot be replayed.

    """
    with Bag(path) as bag:
        parameters = recorded_parameters(bag)
        frames_topic = frames_topic or told_frames_topic(bag, parameters)
        check_type(bag, frames_topic, IMAGE, '--frames-topic')
        truth = truth_topic in bag.topics
        if truth:
            check_type(bag, truth_topic, ARRAY, '--truth-topic')
        stamps_ns, (rows, cols), encoding = _look_at_frames(bag, frames_topic)
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
    ValueError
        One line, if it has not; names the topics of that type and the option that picks one.

    """
    alike = sorted(name for name, kind in bag.topics.items() if kind == msgtype)
    if topic in bag.topics and topic not in alike:
        raise ValueError(f'{bag.path}: {topic} is of type {bag.topics[topic]}, not {msgtype}')
    if topic not in bag.topics:
        hint = f'; {option} can be {", ".join(alike)}' if alike else ''
        raise ValueError(f'{bag.path}: has no topic {topic} of type {msgtype}{hint}')


def _look_at_frames(bag: Bag, topic: str) -> tuple[list[int], tuple[int, int], str]:
    """Return the stamps [ns] of the frames, their rows and columns, and their encoding."""
    stamps_ns: list[int] = []
    shape, encoding = None, ''
    for message in bag.messages({topic}):
        image = bag.read(message)
        stamp_ns = image.header.stamp.sec * 1_000_000_000 + image.header.stamp.nanosec
        number = len(stamps_ns) + 1
        where = f'{bag.path}: {topic}: frame {number}'
        if stamps_ns and stamp_ns <= stamps_ns[-1]:
            raise ValueError(f'{where} has stamp {stamp_ns / 1e9:.9g} s, which is not after '
                             f'{stamps_ns[-1] / 1e9:.9g} s of the one before')
        shape = shape or (image.height, image.width)
        if (image.height, image.width) != shape or not all(shape):
            raise ValueError(f'{where} has {image.width} x {image.height} pixels'
                             + f' after frames of {shape[1]} x {shape[0]}' * all(shape))
        stamps_ns.append(stamp_ns)
        encoding = image.encoding
    if shape is None:
        raise ValueError(f'{bag.path}: {topic}: no frames' + _because(bag))
    return stamps_ns, shape, encoding


def _because(bag: Bag) -> str:
    return f' ({"; ".join(bag.notes)})' if bag.notes else ''


def told_frames_topic(bag: Bag, parameters: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the topic of the frames that a recorded run began with, as its parameters tell."""
    topics = parameters.get('/recorder', {}).get('topics')
    told = str(topics[0]) if isinstance(topics, list) and topics else _FRAMES
    return told if told in bag.topics else _FRAMES


def recorded_parameters(bag: Bag) -> dict[str, dict[str, Any]]:
    """Return the parameters by node of the run that a bag was recorded from, or nothing."""
    try:
        tree = load_yaml(bag.custom.get(CUSTOM_PARAMETERS, '{}'))
        return {str(node): {str(key): value for key, value in body['ros__parameters'].items()}
                for node, body in tree.items()}
    except (AttributeError, KeyError, TypeError, ValueError):
        bag.notes.append(f'{bag.path}: the parameters of its run cannot be read')
        return {}
