# SPDX-License-Identifier: Apache-2.0
"""Videos and SER films give all frames at their depth and with their own stamps."""

from fractions import Fraction
import struct

import av
from film_files import read
from film_files import reason
from film_files import SHAPE
from film_files import twelve_bit_frames
import numpy as np
import pytest

UNIX_TICKS = 621_355_968_000_000_000


@pytest.fixture
def frames(rng):
    return twelve_bit_frames(rng)


@pytest.mark.parametrize(('form', 'scale'), [
    ('gray16le', 1), ('gray12le', 1), ('gray10le', 0.25), ('gray', 1 / 16),
    ('yuv420p12le', 1), ('yuv422p10le', 0.25), ('yuv420p', 1 / 16)])
def test_video_keeps_the_depth_of_its_luminance(tmp_path, frames, form, scale):
    given = (frames * scale).astype('u2' if '1' in form.replace('yuv42', '') else 'u1')
    with av.open(str(tmp_path / 'a.mkv'), 'w') as container:
        stream = container.add_stream('ffv1', rate=25)
        stream.width, stream.height, stream.pix_fmt = SHAPE[1], SHAPE[0], form
        stream.codec_context.color_range = 2  # black is 0
        for frame in given:
            picture = av.VideoFrame(SHAPE[1], SHAPE[0], form)
            picture.color_range = 2
            plane = picture.planes[0]
            rows = np.zeros((SHAPE[0], plane.line_size), 'u1')
            rows[:, :SHAPE[1] * frame.itemsize] = frame.view('u1')
            plane.update(rows.tobytes())
            for other in picture.planes[1:]:
                other.update(bytes(other.buffer_size))
            container.mux(stream.encode(picture))
        container.mux(stream.encode(None))
    _, found, stamps = read(tmp_path / 'a.mkv')
    np.testing.assert_array_equal(found, given)
    assert found.dtype == given.dtype
    np.testing.assert_allclose(stamps, 0.04 * np.arange(1, 7), rtol=0, atol=1e-9)


@pytest.mark.parametrize('form', ['yuv420p', 'yuv422p', 'nv12'])
def test_video_whose_black_is_16_is_read_as_another_library_reads_it(tmp_path, frames, form):
    path, given = tmp_path / 'a.avi', (frames // 8).astype('u1')
    with av.open(str(path), 'w') as container:
        stream = container.add_stream('rawvideo', rate=25)
        stream.width, stream.height, stream.pix_fmt = SHAPE[1], SHAPE[0], form
        for frame in given:
            container.mux(stream.encode(
                av.VideoFrame.from_ndarray(frame, 'gray').reformat(format=form)))
        container.mux(stream.encode(None))
    found = read(path)[1]
    np.testing.assert_allclose(found.astype(int), given, atol=1)
    assert abs(found.mean() - given.mean()) < 0.1


def test_video_that_is_cut_off_says_so(tmp_path, frames):
    path = tmp_path / 'a.mkv'
    with av.open(str(path), 'w') as container:
        stream = container.add_stream('ffv1', rate=25)
        stream.width, stream.height, stream.pix_fmt = SHAPE[1], SHAPE[0], 'gray16le'
        for frame in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, 'gray16le')))
        container.mux(stream.encode(None))
    assert read(path)[0].notes == []
    path.write_bytes(path.read_bytes()[:-2500])
    reader, found, _ = read(path)
    assert 1 < len(found) < 6
    assert f'declares 6 frames and holds {len(found)}' in reader.notes[0]


def test_video_has_the_times_of_its_frames(tmp_path, frames):
    ticks = [0, 40, 80, 200, 240, 290]  # ms: a gap, and a time beside the rate
    with av.open(str(tmp_path / 'a.mkv'), 'w') as container:
        stream = container.add_stream('ffv1', rate=25)
        stream.width, stream.height, stream.pix_fmt = SHAPE[1], SHAPE[0], 'gray16le'
        stream.codec_context.time_base = Fraction(1, 1000)
        for frame, tick in zip(frames, ticks):
            picture = av.VideoFrame.from_ndarray(frame, format='gray16le')
            picture.pts, picture.time_base = tick, Fraction(1, 1000)
            container.mux(stream.encode(picture))
        container.mux(stream.encode(None))
    stamps = read(tmp_path / 'a.mkv')[2]
    np.testing.assert_allclose(np.diff(stamps), np.diff(ticks) / 1e3, atol=1.1e-3)


def test_colours_of_a_video_become_luminance(tmp_path, rng):
    image = rng.integers(255, size=(*SHAPE, 3)).astype('u1')
    with av.open(str(tmp_path / 'a.mkv'), 'w') as container:
        stream = container.add_stream('ffv1', rate=25)
        stream.width, stream.height, stream.pix_fmt = SHAPE[1], SHAPE[0], 'bgr0'
        container.mux(stream.encode(av.VideoFrame.from_ndarray(image, 'rgb24').reformat(
            format='bgr0')))
        container.mux(stream.encode(None))
    reader, found, _ = read(tmp_path / 'a.mkv')
    np.testing.assert_allclose(found[0], image @ [0.299, 0.587, 0.114], atol=0.6)
    assert len(reader.notes) == 1


def ser(path, frames, *, little, flag, color=0, bits=16, ticks=None):
    """Write a SER film by its definition."""
    rows, cols = frames.shape[1:3]
    head = struct.pack('<14s7i120s2q', b'LUCAM-RECORDER', 0, color, flag, cols, rows, bits,
                       len(frames), b'', 0, 0)
    kind = 'u1' if bits <= 8 else '<u2' if little else '>u2'
    tail = b'' if ticks is None else np.asarray(ticks, '<i8').tobytes()
    path.write_bytes(head + frames.astype(kind).tobytes() + tail)
    return path


@pytest.mark.parametrize('little', [True, False])
@pytest.mark.parametrize('flag', [0, 1])
@pytest.mark.parametrize('bits', [12, 16])
def test_ser_is_read_in_its_byte_order_whatever_the_flag_says(
        tmp_path, frames, little, flag, bits):
    _, found, stamps = read(ser(
        tmp_path / 'a.ser', frames, little=little, flag=flag, bits=bits))
    np.testing.assert_array_equal(found, frames)
    assert stamps == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]


def test_ser_has_its_own_stamps_and_colours(tmp_path, frames, rng):
    times_s = 1_700_000_000 + np.array([0, 1, 2, 3, 7, 8])
    _, found, stamps = read(ser(
        tmp_path / 'a.ser', frames // 16, little=True, flag=0, bits=8,
        ticks=UNIX_TICKS + times_s * 10**7 + 5))
    np.testing.assert_array_equal(found, frames // 16)
    np.testing.assert_allclose(stamps, times_s, atol=1e-6)
    image = rng.integers(255, size=(1, *SHAPE, 3)).astype('u1')
    found = read(ser(tmp_path / 'b.ser', image, little=True, flag=0, bits=8, color=101))[1]
    np.testing.assert_allclose(found[0], image[0] @ [0.114, 0.587, 0.299], atol=0.6)
    flat = np.full((1, *SHAPE), 90)
    assert (read(ser(tmp_path / 'c.ser', flat, little=True, flag=1, color=9))[1] == 90).all()


def test_ser_without_increasing_stamps_says_so(tmp_path, frames):
    reader, _, stamps = read(ser(
        tmp_path / 'a.ser', frames, little=True, flag=0, ticks=np.full(6, UNIX_TICKS + 9)))
    assert stamps[:2] == [1.0, 2.0]
    assert len(reader.notes) == 1


@pytest.mark.parametrize('spoil', [
    lambda data: data[:100], lambda data: data[:-1], lambda data: b'x' + data[1:],
    lambda data: data[:26] + bytes(4) + data[30:]])
def test_damaged_ser_is_refused(tmp_path, frames, spoil):
    path = ser(tmp_path / 'a.ser', frames, little=True, flag=0)
    path.write_bytes(spoil(path.read_bytes()))
    assert reason(path) == 'unreadable'
