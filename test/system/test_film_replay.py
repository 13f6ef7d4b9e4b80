# SPDX-License-Identifier: Apache-2.0
"""Files with frames and bags of cameras are replayed with truth from a table, or refused first."""

from astropy.io import fits
import cv2
from graph_runs import own_domain
from graph_runs import run_bringup
from graph_runs import start_bringup
import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer
from rosbags.typesys import get_typestore
from rosbags.typesys import Stores

COUNT, SHAPE = 24, (48, 64)
START_S = 1_767_225_600  # 2026-01-01T00:00:00
TOPIC, KIND = '/camera/image_raw/compressed', 'sensor_msgs/msg/CompressedImage'
RUN = ('--detector', 'sdt', '--snr', '8', '--lockstep')


@pytest.fixture(scope='module')
def scene(tmp_path_factory):
    """Return frames in which an object crosses, and a table of where it is."""
    rng = np.random.default_rng(3)
    rows, cols = np.indices(SHAPE)
    x, y = 6.0 + 2.0 * np.arange(COUNT), 10.0 + 0.8 * np.arange(COUNT)
    object_ = np.exp(-((cols - x[:, None, None])**2 + (rows - y[:, None, None])**2) / 2.0)
    frames = np.rint(rng.normal(1000.0, 20.0, (COUNT, *SHAPE)) + 200.0 * object_).astype('u2')
    table = tmp_path_factory.mktemp('truth') / 'truth.csv'
    table.write_text('Bild;Spalte;Zeile\n' + ''.join(
        f'{k + 1};{x[k]:.2f};{y[k]:.2f}\n'.replace('.', ',') for k in range(COUNT)))
    return frames, table


def scored(folder, *arguments):
    """Return the summary of a run that ends well, and what it prints for the user."""
    with start_bringup(folder / 'results', *RUN, *arguments, domain_id=own_domain()) as run:
        code, _, err = run.finish()
        assert code == 0, err
        return run.summary(), run.rows(), err


def test_folder_of_fits_files_is_replayed_in_the_order_of_its_times(tmp_path, scene):
    frames, table = scene
    (tmp_path / 'night').mkdir()
    for k, frame in enumerate(frames):
        card = {'DATE-OBS': f'2026-01-01T00:{k // 2:02}:{30 * (k % 2):02}'}
        fits.PrimaryHDU(frame, fits.Header(card)).writeto(
            tmp_path / 'night' / f'{"rg"[k % 2]}_{k}.fits')
    summary, rows, _ = scored(tmp_path, '--replay', str(tmp_path / 'night'), '--truth', str(table))
    assert summary['frames']['scored'] == COUNT
    assert min(float(row.split(',')[1]) for row in rows[1:]) == START_S
    assert summary['detectors']['sdt']['tracking']['pd'] > 0.3  # thresholds adapt at first


def test_bag_of_a_compressed_camera_loses_a_frame_without_stamp_and_is_scored(tmp_path, scene):
    frames, table = scene
    store = get_typestore(Stores.ROS2_JAZZY)
    image, header, stamp = (store.types[name] for name in (
        KIND, 'std_msgs/msg/Header', 'builtin_interfaces/msg/Time'))
    with Writer(tmp_path / 'bag', version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        camera = writer.add_connection(TOPIC, KIND, typestore=store)
        for k, frame in enumerate(frames):
            writer.write(camera, k, store.serialize_cdr(image(
                header(stamp(0 if k == 9 else START_S + k, 0), 'lens'),
                'mono16; png compressed mono16', cv2.imencode('.png', frame)[1].ravel()), KIND))
    summary, _, err = scored(
        tmp_path, '--replay', str(tmp_path / 'bag'), '--frames-topic', TOPIC,
        '--truth', str(table))
    assert summary['frames']['scored'] == COUNT - 1
    assert f'1 of {COUNT} frames' in err
    assert summary['detectors']['sdt']['tracking']['pd'] > 0.3  # thresholds adapt at first


@pytest.mark.parametrize(('arguments', 'culprit'), [
    (('--period', '2'), '--period'), (('--truth', 'truth.csv'), '--truth'),
    (('--replay', 'night.mcap', '--select', 'SCI'), '--select')])
def test_option_that_would_do_nothing_is_refused(tmp_path, arguments, culprit):
    for name in ('night.mcap', 'truth.csv'):
        (tmp_path / name).touch()
    done = run_bringup(*(
        str(tmp_path / word) if (tmp_path / word).exists() else word for word in arguments))
    assert (done.returncode, done.stdout, len(done.stderr.splitlines())) == (2, '', 1)
    assert culprit in done.stderr


@pytest.mark.parametrize(('shape', 'more', 'culprit'), [
    ((3, 1, 200), (), 'film'), ((3, 9, 9), ('--truth', 'none.csv'), 'none.csv'),
    ((3, 9, 9), ('--select', 'cube'), 'cube'), ((3,), (), 'film.npz')])
def test_film_that_cannot_be_used_is_refused_in_one_line(tmp_path, shape, more, culprit):
    np.savez(tmp_path / 'film.npz', frames=np.zeros(shape, 'u2'))
    done = run_bringup('--replay', str(tmp_path / 'film.npz'), *more)
    assert (done.returncode, done.stdout, len(done.stderr.splitlines())) == (2, '', 1)
    assert culprit in done.stderr
