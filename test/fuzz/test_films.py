# SPDX-License-Identifier: Apache-2.0
"""Damaged films and truth of every form are used, or rejected in one line."""

import gzip
import io
import json
from pathlib import Path
import struct
from tempfile import TemporaryDirectory

from astropy.io import fits
import av
import cv2
from fuzz.counting import fuzz
from fuzz.counting import tried
from fuzz.strategies import damaged
from hypothesis import strategies as st
from lowsnr_bringup.bags.recorded_run import inspect_bag
from lowsnr_bringup.formats.image_files import open_frames
from lowsnr_bringup.truth.forms import read_truth
from lowsnr_bringup.truth.frame_index import FrameIndex
import numpy as np
import pytest
from rosbags.rosbag1 import Writer
from rosbags.typesys import get_typestore
from rosbags.typesys import Stores
import tifffile

pytestmark = pytest.mark.filterwarnings('ignore::RuntimeWarning', 'ignore::UserWarning')
FRAMES = np.random.default_rng(0).integers(900, 1100, (3, 12, 16)).astype('u2')
STAMPS = 621_355_968_000_000_000 + np.arange(1, 4)


def tiff(**how):
    file = io.BytesIO()
    tifffile.imwrite(file, FRAMES, **how)
    return file.getvalue()


def fits_file(*units):
    file = io.BytesIO()
    fits.HDUList([fits.PrimaryHDU(), *units]).writeto(file)
    return file.getvalue()


def video():
    file = io.BytesIO()
    with av.open(file, 'w', format='matroska') as container:
        stream = container.add_stream('ffv1', rate=10)
        stream.width, stream.height, stream.pix_fmt = 16, 12, 'gray16le'
        for frame in FRAMES:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, 'gray16le')))
        container.mux(stream.encode(None))
    return file.getvalue()


CUBE = fits_file(fits.ImageHDU(FRAMES, fits.Header({'DATE-OBS': '2026-01-01T00:00:00'})))
NPY = io.BytesIO()
np.save(NPY, FRAMES)
FILMS = {
    'a.tif': tiff(), 'b.tif': tiff(compression='zlib', tile=(16, 16)),
    'c.tif': tiff(compression='lzw', predictor=True), 'd.tif': tiff(imagej=True),
    'a.fits': CUBE, 'b.fits.gz': gzip.compress(CUBE, mtime=0), 'a.mkv': video(),
    'a.npy': NPY.getvalue(), 'a.pgm': cv2.imencode('.pgm', FRAMES[0])[1].tobytes(),
    'a.jpg': cv2.imencode('.jpg', (FRAMES[0] // 8).astype('u1'))[1].tobytes(),
    'a.ser': struct.pack('<14s7i120s2q', b'LUCAM-RECORDER', 0, 0, 1, 16, 12, 12, 3, b'', 0, 0)
    + FRAMES.tobytes() + STAMPS.astype('<i8').tobytes()}
PACKED = {
    way: fits_file(fits.CompImageHDU((FRAMES[:2] - 900).astype('i2'), compression_type=way))
    for way in ('RICE_1', 'GZIP_1', 'PLIO_1', 'HCOMPRESS_1')}
TRUTH = {
    'mot': b'1,4,10,20,5,3,1,-1,-1,-1\n3,4,10.5,20,5,3,1,-1,-1,-1\n',
    'coco': json.dumps({
        'images': [{'id': k, 'file_name': f'{k}.png'} for k in (1, 2, 3)],
        'annotations': [{'image_id': 2, 'bbox': [1, 2, 3, 4], 'category_id': 1}],
        'categories': [{'id': 1, 'name': 'x'}]}).encode(),
    'table': b'time;u;v\n0,5;1;2\n2026-01-01T00:00:00;3;4\n'}


def ros1_bag(compression=None):
    """Return a bag of ROS 1 of these frames."""
    store = get_typestore(Stores.ROS1_NOETIC)
    time, header, image = (store.types[name] for name in (
        'builtin_interfaces/msg/Time', 'std_msgs/msg/Header', 'sensor_msgs/msg/Image'))
    with TemporaryDirectory() as folder:
        writer = Writer(Path(folder) / 'a.bag')
        if compression:
            writer.set_compression(compression)
        with writer:
            topic = writer.add_connection('/image_raw', image.__msgtype__, typestore=store)
            for k, frame in enumerate(FRAMES, start=1):
                writer.write(topic, k, store.serialize_ros1(image(
                    header(k, time(k, 0), ''), 12, 16, 'mono16', 0, 32,
                    frame.view('u1').ravel()), image.__msgtype__))
        return (Path(folder) / 'a.bag').read_bytes()


def read(path):
    """Read all frames with their stamps."""
    for frame, stamp_ns in open_frames(path).stamped():
        assert frame.ndim == 2
        assert frame.dtype in (np.uint8, np.uint16, np.float32)
        assert stamp_ns > 0


ROS1 = {
    'plain': ros1_bag(), 'bz2': ros1_bag(Writer.CompressionFormat.BZ2),
    'lz4': ros1_bag(Writer.CompressionFormat.LZ4)}


@fuzz('films', 600, name=st.sampled_from(sorted(FILMS)), data=st.data())
def test_film_is_read_or_rejected(place, name, data):
    path = place / name
    path.write_bytes(data.draw(damaged(FILMS[name])))
    tried(path, read, path)


@fuzz('compressed FITS images', 80, way=st.sampled_from(sorted(PACKED)), data=st.data())
def test_compressed_image_is_read_or_rejected(place, way, data):
    path = place / 'a.fits'
    path.write_bytes(data.draw(damaged(PACKED[way])))
    tried(path, read, path)


@fuzz('bags of ROS 1', 200, name=st.sampled_from(sorted(ROS1)), data=st.data())
def test_bag_of_ros_1_is_read_or_rejected(place, name, data):
    path = place / 'a.bag'
    path.write_bytes(data.draw(damaged(ROS1[name])))
    tried(path, inspect_bag, path, None, '/ground_truth')


@fuzz('truth of several forms', 300, form=st.sampled_from(sorted(TRUTH)), data=st.data())
def test_truth_is_read_or_rejected(place, form, data):
    path = place / 'truth'
    path.write_bytes(data.draw(damaged(TRUTH[form])))
    tried(path, read_truth, path, FrameIndex(np.arange(1.0, 4.0)))
