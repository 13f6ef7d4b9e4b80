# SPDX-License-Identifier: Apache-2.0
"""Bags made from files with frames and from files of truth, and what a replay makes of both."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from dataclasses import field
import itertools
import math
from pathlib import Path
import shutil

from lowsnr_bringup.bags.bag_files import is_bag
from lowsnr_bringup.bags.recorded_run import frames_of
from lowsnr_bringup.formats.film import FrameReader
from lowsnr_bringup.formats.image_files import is_film
from lowsnr_bringup.formats.image_files import open_frames
from lowsnr_bringup.ros.frame_bag import FrameBag
from lowsnr_bringup.truth.forms import read_truth
from lowsnr_bringup.truth.forms import truth_of_array
from lowsnr_bringup.truth.forms import within
from lowsnr_bringup.truth.frame_index import FrameIndex
from lowsnr_bringup.truth.frame_index import Reading
from lowsnr_common.core.records import Truth
from lowsnr_common.core.timeline import in_seconds

_SINCE_1970_NS = 10**18  # stamps below are counted from some start, not from 1970
_MESSAGE_BYTES = 150  # of a frame and its time in a bag, besides the pixels


def write_film(
    film: FrameReader, out: Path, storage: str = 'mcap', *, period_s: float | None = None,
    truth_file: Path | None = None, reading: Reading | None = None,
) -> int:
    """
    Write the frames of a film, and its truth if it is known, to a bag; return their number.

    Parameters
    ----------
    film
        The frames; its notes are complete afterwards.
    out, storage
        Folder of the bag, which must not exist, and its storage format.
    period_s
        Time between frames [s]; None for their own times.
    truth_file, reading
        Where the objects are, if that is in a file of its own, and how it is read.

    Raises
    ------
    UnusableFile
        One line that names the file.
    ValueError
        If the disk has no room for the bag.

    """
    truth: Iterable[list[Truth] | None] = itertools.repeat(None)
    if truth_file is not None:
        index = FrameIndex(film.times_s(period_s), film.files)
        truth = within(
            read_truth(truth_file, index, reading, film.notes), film.shape, truth_file,
            film.notes)
    elif film.truth is not None:
        truth = within(truth_of_array(film.truth), film.shape, film.path, film.notes)
    check_room(out, film)
    count = 0
    with FrameBag(out, storage) as bag:
        for (frame, stamp_ns), objects in zip(film.stamped(period_s), truth):
            bag.add(frame, stamp_ns, objects)
            count += 1
        next(iter(truth), None)  # so that it notes what is outside
    return count


def check_room(out: Path, film: FrameReader) -> None:
    """Raise ValueError if the disk has no room for the frames, as far as their number is known."""
    each = math.prod(film.shape) * film.dtype.itemsize + _MESSAGE_BYTES
    size = each * (film.count or 0)
    folder = next(path for path in out.absolute().parents if path.is_dir())
    if size > (free := shutil.disk_usage(folder).free):
        raise ValueError(
            f'{out}: the bag takes {size} bytes, and the disk of {folder} has {free} free')


def is_film_only(path: Path) -> bool:
    """Whether something is a file or folder with frames, and no bag."""
    return is_film(path) and not is_bag(path)


@dataclass
class Replayable:
    """A bag to replay, made from files where it has to be, and a bag of truth for it."""

    bag: Path
    truth_bag: Path | None = None
    notes: list[str] = field(default_factory=list)


def replayable(
    path: Path, folder: Path, *, select: str | None = None, pattern: str = '*',
    period_s: float | None = None, truth_file: Path | None = None,
    reading: Reading | None = None, frames_topic: str | None = None,
) -> Replayable:
    """
    Return what is replayed: a bag as it is, or one that is made from a film in a folder.

    Raises
    ------
    ValueError
        One line that names the file and why it cannot be used.

    """
    if is_film_only(path):
        film = open_frames(path, select, pattern)
        bag = folder / (path.resolve().name.partition('.')[0] or 'film')
        write_film(film, bag, period_s=period_s, truth_file=truth_file, reading=reading)
        return Replayable(bag, None, film.notes)
    found = Replayable(path)
    if truth_file is not None:
        found.truth_bag = folder / 'truth'
        frames = frames_of(path, frames_topic)
        index = FrameIndex(frames.stamps_ns / 1e9)
        if 0 < frames.stamps_ns[0] < _SINCE_1970_NS:
            found.notes.append(
                f'{truth_file}: its times, if it has any, are compared with the stamps of the '
                f'bag, the first of which is {in_seconds(int(frames.stamps_ns[0]))} s')
        truth = [*within(
            read_truth(truth_file, index, reading, found.notes), frames.shape, truth_file,
            found.notes)]
        with FrameBag(found.truth_bag) as bag_of_truth:
            for k in frames.kept:
                bag_of_truth.add_truth(int(frames.stamps_ns[k]), truth[k])
    return found
