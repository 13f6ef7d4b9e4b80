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
from lowsnr_common.core.records import Malformed
from lowsnr_common.core.timeline import in_seconds
from lowsnr_common.core.timeline import increasing
from lowsnr_common.images.compressed import decode_compressed
from lowsnr_common.images.encodings import check_image
from lowsnr_common.images.encodings import is_whole
from lowsnr_common.images.encodings import pixels_of
from lowsnr_common.settings.text import load_yaml
from lowsnr_common.settings.text import one_line
import numpy as np
from numpy.typing import NDArray

IMAGE, ARRAY = 'sensor_msgs/msg/Image', 'vision_msgs/msg/Detection2DArray'
COMPRESSED = 'sensor_msgs/msg/CompressedImage'
CAMERA_INFO = 'sensor_msgs/msg/CameraInfo'
_FRAMES = '/image_raw'
_MOST_STEPS = 100  # periods from a first stamp 0 to the next: beyond, no clock was set


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
    left_out : tuple of int
        Indices of the frames whose stamps are not in order, see :func:`increasing`.
    blank
        The first frame with a pixel that is not a finite number up to 1e9; empty if none has.

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
    left_out: tuple[int, ...] = ()
    blank: str = ''


@dataclass(frozen=True)
class BagFrames:
    """
    The frames of a topic of a bag.

    Attributes
    ----------
    stamps_ns : (T,) ndarray
        Their stamps, in the order of the bag [ns].
    kept : (K,) ndarray
        Indices of the frames that are replayed, whose stamps increase.
    shape
        Rows and columns of every frame.
    encoding
        How they are encoded; of compressed ones as what they are unpacked to.
    blank
        The first frame with a pixel that is not a finite number up to 1e9; empty if none has.

    """

    stamps_ns: NDArray[np.int64]
    kept: NDArray[np.int64]
    shape: tuple[int, int]
    encoding: str
    blank: str

    def note(self, topic: str) -> str:
        """Return how many frames are left out and which is the first; nothing if none is."""
        out = np.setdiff1d(np.arange(len(self.stamps_ns)), self.kept)
        if not out.size:
            return ''
        return (f'{topic}: {out.size} of {len(self.stamps_ns)} frames are left out, because their '
                'stamps are zero, repeated or not after those before them; the first is frame '
                f'{out[0] + 1}, of {in_seconds(int(self.stamps_ns[out[0]]))} s')


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
        frames = _read_frames(bag, frames_topic)
        for message in bag.messages({truth_topic, f'{truth_topic}/odometry'} if truth else ()):
            bag.read(message)
        evaluator = parameters.get('/evaluator', {})
        steps_s = np.diff(frames.stamps_ns[frames.kept]) / 1e9
        out = np.setdiff1d(np.arange(len(frames.stamps_ns)), frames.kept)
        return RecordedRun(
            name=one_line(evaluator.get('scenario') or path.resolve().stem),
            frames=len(frames.kept), rows=frames.shape[0], cols=frames.shape[1],
            period_s=float(np.median(steps_s)) if steps_s.size else 1.0,
            truth=truth, encoding=frames.encoding,
            raw=not evaluator or '/conditioner' in parameters,
            simulated='/sensor' in parameters or bool(
                parameters.get('/player', {}).get('simulated')),
            seed=evaluator.get('seed'),
            notes=(*bag.notes, *filter(None, [frames.note(frames_topic)])),
            frames_topic=frames_topic, left_out=tuple(map(int, out)), blank=frames.blank,
            sensor={k: v for k, v in evaluator.items() if k.startswith('sensor.')})


def frames_of(path: Path, frames_topic: str | None) -> BagFrames:
    """Return the frames of a bag; raises as :func:`inspect_bag`."""
    with Bag(path) as bag:
        topic = frames_topic or recorded_frames_topic(bag, recorded_parameters(bag))
        check_type(bag, topic, (IMAGE, COMPRESSED), '--frames-topic')
        return _read_frames(bag, topic)


def check_type(bag: Bag, topic: str, msgtypes: tuple[str, ...], option: str) -> None:
    """
    Check that a bag has a topic of one of some types.

    Raises
    ------
    UnusableFile
        With reason ``type`` or ``no topic``; the line names the topics of that type, and the
        option that picks one.

    """
    alike = sorted(name for name, kind in bag.topics.items() if kind in msgtypes)
    if topic in bag.topics and topic not in alike:
        raise UnusableFile(
            bag.path, 'type', f'{topic} is of type {bag.topics[topic]}, not {msgtypes[0]}')
    if topic not in bag.topics:
        hint = f'; {option} can be {", ".join(alike)}' if alike else ''
        raise UnusableFile(
            bag.path, 'no topic', f'has no topic {topic} of type {msgtypes[0]}{hint}')


def _read_frames(bag: Bag, topic: str) -> BagFrames:
    """Read all frames; UnusableFile names the first that detectors cannot use."""
    stamps_ns: list[int] = []
    shape, encoding, blank = (0, 0), '', ''
    for message in bag.messages({topic}):
        image = bag.read(message)
        where = f'{topic}: frame {len(stamps_ns) + 1}'
        try:
            found, encoding = _checked(image)
        except Malformed as error:
            raise UnusableFile(bag.path, error.reason, f'{where}: {error}') from None
        shape = shape if stamps_ns else found
        if found != shape:
            raise UnusableFile(
                bag.path, 'size', f'{where} has {found[1]} x {found[0]} pixels after frames of '
                f'{shape[1]} x {shape[0]}')
        if not blank and encoding == '32FC1' and not is_whole(pixels_of(image)):
            blank = f'frame {len(stamps_ns) + 1}'
        stamp = image.header.stamp
        stamps_ns.append(stamp.sec * 1_000_000_000 + stamp.nanosec)
    if not stamps_ns:
        because = f' ({"; ".join(bag.notes)})' if bag.notes else ''
        raise UnusableFile(bag.path, 'no frames', f'{topic}: no frames{because}')
    kept = _in_order(stamps_ns)
    if len(kept) < min(2, len(stamps_ns)):
        raise UnusableFile(
            bag.path, 'stamps', f'{topic}: the stamps of its {len(stamps_ns)} frames do not '
            'increase: record it again with a camera that stamps each frame')
    return BagFrames(np.array(stamps_ns), np.array(kept, np.int64), shape, encoding, blank)


def _in_order(stamps_ns: list[int]) -> list[int]:
    """Return the indices of frames that are replayed; a first stamp 0 must be near the next."""
    kept = increasing(stamps_ns)
    if len(kept) > 1 and stamps_ns[kept[0]] == 0:
        steps_ns = np.diff([stamps_ns[k] for k in kept])
        if steps_ns[0] > _MOST_STEPS * np.median(steps_ns):
            return kept[1:]
    return kept


def _checked(image: Any) -> tuple[tuple[int, int], str]:
    """Return rows, columns and encoding of an image; Malformed if detectors cannot use it."""
    if hasattr(image, 'format'):
        pixels = decode_compressed(image)
        return (pixels.shape[0], pixels.shape[1]), f'mono{8 * pixels.itemsize}'
    check_image(image)
    return (image.height, image.width), image.encoding


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
