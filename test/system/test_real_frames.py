"""
Real sequences from file to bag to graph: conditioner, detector and tracker follow the object.

The sequences lie in shared/data beside the checkout, and are no part of it: a checkout without
them skips these tests, save under ``CI=true``, where they must be there.
"""

from contextlib import ExitStack
import os
from pathlib import Path
import subprocess
import sys

from graph_runs import own_domain
from graph_runs import start_bringup
from lowsnr_bringup.bags.reader import Bag
from lowsnr_common.ros import messages
from lowsnr_sensor.conditioning.conditioner import ConditioningSettings
import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT.parent / 'shared' / 'data'
GATE_CELLS = 2.5
SEQUENCES = {'lasco_c3_8dB': 'mmtbd2', 'ir_helicopter_049': 'sdt'}  # and their detectors


def sequence(name):
    """Return the arrays of a sequence, or end the test without them."""
    path = DATA / f'{name}.npz'
    if not path.is_file():
        end = pytest.fail if os.environ.get('CI') == 'true' else pytest.skip
        end(f'needs the sequence {path}, which is not there')
    with np.load(path) as archive:
        return dict(archive)


@pytest.fixture(scope='module')
def started(tmp_path_factory):
    """Return a run for every sequence that is there; at once, since each needs one core."""
    runs = {}
    with ExitStack() as within:
        for number, (name, detector) in enumerate(SEQUENCES.items()):
            if not (DATA / f'{name}.npz').is_file():
                continue
            folder = tmp_path_factory.mktemp(name)
            subprocess.run(
                [sys.executable, str(ROOT / 'scripts' / 'convert.py'), str(DATA / f'{name}.npz'),
                 '--out', str(folder / 'frames')], check=True, timeout=120, capture_output=True)
            runs[name] = within.enter_context(start_bringup(
                folder / 'run', '--replay', str(folder / 'frames'), '--detector', detector,
                '--snr', '8', '--lockstep', '--record', str(folder / 'recorded'),
                domain_id=own_domain(number)))
        yield runs


@pytest.fixture
def replayed(request):
    """Return a function that gives a sequence and its confirmed tracks by frame."""
    def run(name):
        data = sequence(name)
        replay = request.getfixturevalue('started')[name]
        code, _, err = replay.finish(within_s=400.0)
        assert code == 0, err
        frames = replay.summary()['frames']
        assert frames['unanswered'] == 0
        return data, tracks_of(replay.results.parent / 'recorded', frames['published'])
    return run


def tracks_of(bag, count):
    """Return the places x, y of the confirmed tracks of every frame, in cells."""
    answers = {}
    with Bag(bag) as recorded:
        for message in recorded.messages({'/tracks'}):
            array = recorded.read(message)
            answers[messages.stamp_key(array.header.stamp)] = np.reshape([
                (item.bbox.center.position.x, item.bbox.center.position.y)
                for item in array.detections], (-1, 2))
    assert len(answers) == count
    return [answers[stamp] for stamp in sorted(answers)]


def near(places, objects):
    """Return which places are near which objects, (places, objects)."""
    return np.linalg.norm(places[:, None] - objects, axis=-1) <= GATE_CELLS


def followed(tracks, truth):
    """Return the share of frames, from the tenth after it appeared, with a track on the object."""
    present = np.isfinite(truth).all(axis=-1)
    asked = np.flatnonzero(present & (np.arange(len(truth)) >= np.argmax(present) + 10))
    assert len(asked) > 20
    return np.mean([near(tracks[k], truth[None, k]).any() for k in asked])


@pytest.mark.slow
def test_star_in_a_coronagraph_is_followed_without_false_tracks(replayed):
    (data, tracks), cells = replayed('lasco_c3_8dB'), ConditioningSettings().cells
    assert followed(tracks, cells(data['truth'])) >= 0.8
    known = cells(np.concatenate(
        [data['truth'][None], data['other_truth'], data['uncatalogued_truth']]))
    false = [not near(places, known[:, k]).any(axis=1).all() for k, places in enumerate(tracks)]
    assert np.mean(false) < 0.02


@pytest.mark.slow
def test_helicopter_before_static_clutter_is_followed(replayed):
    data, tracks = replayed('ir_helicopter_049')
    assert followed(tracks, ConditioningSettings().cells(data['truth'])) >= 0.8
