# SPDX-License-Identifier: Apache-2.0
"""Videos: the luminance of every frame at its own depth, with its own time."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
import re
from typing import Any

from lowsnr_bringup.bags.errors import UnusableFile
from lowsnr_bringup.formats.bounds import check_frame_size
from lowsnr_bringup.formats.frames import FrameSource
from lowsnr_bringup.formats.frames import library
from lowsnr_bringup.formats.frames import Pixels
from lowsnr_bringup.formats.frames import TimedFrame
from lowsnr_common.settings.text import one_line
import numpy as np

# The first plane of these is the luminance, in numbers as they were recorded.
_PLANAR = re.compile(r'(?:gray|yuvj?a?4\d\dp|yuva?4\d\dp|nv\d\d)(f?)(\d*)(le|be)?')
_FULL_RANGE = 2  # of AVColorRange
# Packed formats, and the planar ones that hold the same numbers.
_UNPACKED = {
    'yuyv422': 'yuv422p', 'uyvy422': 'yuv422p', 'yvyu422': 'yuv422p', 'ya8': 'gray',
    'ya16le': 'gray16le', 'ya16be': 'gray16le', 'p010le': 'yuv420p10le', 'p012le': 'yuv420p12le',
    'p016le': 'yuv420p16le', 'y210le': 'yuv422p10le', 'monow': 'gray', 'monob': 'gray'}


def open_video(path: Path, select: str | None = None) -> FrameSource:
    """Return the frames of the first video stream of a file."""
    av = library(path, 'av')
    rate, declared = _with_stream(path, av, _described)
    source = FrameSource(path, lambda: iter(()), period_s=float(1 / rate) if rate else None)
    source.frames = lambda: _counted(_frames(path, av, rate), declared, source)
    return source


def _described(stream: Any) -> tuple[Fraction | None, int]:
    """Return the rate, and the number of frames that a file declares, 0 if it does not."""
    rate = stream.average_rate or stream.base_rate
    ticks, base = stream.duration, stream.time_base
    if ticks is None and stream.container.duration is not None:
        ticks, base = stream.container.duration, Fraction(1, 1_000_000)
    # A duration of the container may be that of its sound.
    alone = len(stream.container.streams) == 1
    return rate, stream.frames or (int(ticks * base * rate) if ticks and rate and alone else 0)


def _counted(
    frames: Iterator[TimedFrame], declared: int, source: FrameSource,
) -> Iterator[TimedFrame]:
    """Yield frames; note whether fewer came than the file declares."""
    count, last_ns = 0, 0
    for frame in frames:
        count, last_ns = count + 1, frame.time_ns or 0
        yield frame
    came = max(count, round(last_ns / 1e9 / source.period_s) + 1 if source.period_s else 0)
    note = f'declares {declared} frames and holds {count}: it is cut off'
    if came < declared and note not in source.notes:
        source.notes.append(note)


def _with_stream(path: Path, av: Any, ask: Any) -> Any:
    try:
        with av.open(str(path)) as container:
            return ask(_stream(path, container))
    except (av.error.FFmpegError, OSError, ValueError) as error:
        raise _unreadable(path, error) from None


def _unreadable(path: Path, error: BaseException) -> UnusableFile:
    if isinstance(error, UnusableFile):
        return error
    return UnusableFile(
        path, 'unreadable', 'neither an .npz, .npy, .ser, FITS or TIFF file, a folder of images '
        f'nor a video: {one_line(error)}')


def _stream(path: Path, container: Any) -> Any:
    if not container.streams.video:
        raise UnusableFile(path, 'no frames', 'has no video stream')
    stream = container.streams.video[0]
    stream.thread_type = 'AUTO'
    check_frame_size(path, (stream.codec_context.height or 0, stream.codec_context.width or 0))
    return stream


def _frames(path: Path, av: Any, rate: Fraction | None) -> Iterator[TimedFrame]:
    first: int | None = None
    last_ns = -1
    try:
        with av.open(str(path)) as container:
            for frame in container.decode(_stream(path, container)):
                check_frame_size(path, (frame.height, frame.width))
                pts = frame.pts
                first = pts if first is None else first
                time_ns = None
                if pts is not None and first is not None:
                    time_ns = _time_ns(pts - first, frame.time_base, rate, last_ns)
                    last_ns = time_ns
                yield TimedFrame(_luminance(frame), time_ns)
    except (av.error.FFmpegError, OSError, ValueError) as error:
        raise _unreadable(path, error) from None


def _time_ns(ticks: int, base: Fraction, rate: Fraction | None, last_ns: int) -> int:
    """
    Return a time [ns] that a container has rounded to its time base.

    A time within one tick of a multiple of the period is that multiple.
    """
    time_s = ticks * base
    if rate:
        even_s = Fraction(round(time_s * rate)) / rate
        if abs(even_s - time_s) <= base and round(even_s * 10**9) > last_ns:
            time_s = even_s
    return round(time_s * 10**9)


def _luminance(frame: Any) -> Pixels:
    """Return the first plane of a frame, or red, green and blue where that is not the grey."""
    name = frame.format.name
    if name in _UNPACKED:
        name = _UNPACKED[name]
        frame = frame.reformat(format=name)
    found = _PLANAR.fullmatch(name)
    if found is None:
        deep = max(component.bits for component in frame.format.components) > 8
        return np.asarray(frame.to_ndarray(format='rgb48le' if deep else 'rgb24'))
    order = '>' if found[3] == 'be' else '<'
    bits = frame.format.components[0].bits
    kind = np.dtype(f'{order}f4' if found[1] else f'{order}u{1 if bits <= 8 else 2}')
    plane = frame.planes[0]
    pixels = np.ndarray(
        (frame.height, frame.width), kind, bytes(plane),
        strides=(plane.line_size, kind.itemsize))
    is_full = frame.color_range == _FULL_RANGE or name.startswith(('gray', 'yuvj'))
    return pixels if is_full else _full_range(pixels, bits)


def _full_range(pixels: Pixels, bits: int) -> Pixels:
    """Return luminance whose black is 16 and whose white is 235, of 8 bits, from 0 on."""
    black, white, most = 16 << bits - 8, 235 << bits - 8, 2**bits - 1
    grey = np.rint((np.arange(most + 1) - black) * (most / (white - black)))
    table = np.clip(grey, 0, most).astype(pixels.dtype.newbyteorder('='))
    return np.asarray(table[pixels & most])
