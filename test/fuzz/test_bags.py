# SPDX-License-Identifier: Apache-2.0
"""Bags with any bytes flipped, cut or swapped are read up to the damage, or rejected."""

import argparse
from contextlib import redirect_stderr
import copy
import csv
import functools
from io import StringIO
import json
from pathlib import Path
import re
import shutil
import tempfile

from builtin_interfaces.msg import Time
import evaluate
from fuzz.counting import fuzz
from fuzz.counting import tried
from fuzz.messages import sendable
from fuzz.strategies import damaged
from fuzz.strategies import HOSTILE
from fuzz.strategies import names
from fuzz.test_yaml_files import nasty
from fuzz.test_yaml_files import replace_somewhere
from fuzz.test_yaml_files import trees
from hypothesis import strategies as st
from lowsnr_bringup.bags.reader import Bag
from lowsnr_bringup.bags.recorded_run import inspect_bag
from lowsnr_bringup.bags.recording import CUSTOM_PARAMETERS
from lowsnr_bringup.bags.replay import played_frames
from lowsnr_bringup.bags.writer import BagWriter
from lowsnr_bringup.plan import config_files
from lowsnr_common.core.records import Estimate
from lowsnr_common.ros import messages
from lowsnr_eval.report import figures
from lowsnr_eval.report import html_page as pages
from lowsnr_eval.report import run_report
from lowsnr_eval.report.run_report import write_run_report
from lowsnr_eval.report.table import format_table
from lowsnr_eval.scoring.score_rows import FRAME_COLUMNS
import numpy as np
import pytest
from rclpy.serialization import serialize_message
from std_msgs.msg import Header
import yaml

pytestmark = pytest.mark.filterwarnings('ignore::RuntimeWarning')
NANO, FRAMES = 1_000_000_000, 4
STORAGES = {'mcap': 'bag.mcap', 'sqlite3': 'bag.db3'}
TYPES = {
    '/image_raw': 'sensor_msgs/msg/Image', '/ground_truth': 'vision_msgs/msg/Detection2DArray',
    '/ground_truth/odometry': 'nav_msgs/msg/Odometry',
    '/detections': 'vision_msgs/msg/Detection2DArray',
    '/tracks': 'vision_msgs/msg/Detection2DArray',
    '/tracks/odometry': 'nav_msgs/msg/Odometry'}
PARAMETERS = {
    '/sensor': {'ros__parameters': {'seed': 3}},
    '/evaluator': {'ros__parameters': {
        'scenario': 'example4', 'detectors': ['sdt'], 'operating_points': ['matched'], 'seed': 3,
        'namespaces': False, 'sensor.snr_db': 9.0, 'gate_cells': 1.5}}}


def write_bag(folder, storage='mcap', parameters=None, spaces=('',)):
    """Write the bag of a run of a few frames."""
    custom = {CUSTOM_PARAMETERS: parameters or yaml.safe_dump(PARAMETERS)}
    with BagWriter(folder, storage, custom) as bag:
        topics = {}
        for k in range(1, FRAMES + 1):
            header = Header(frame_id='sensor', stamp=Time(sec=k))
            for name, message in one_frame(k, header):
                shared = name.startswith(('/image', '/ground'))
                for topic in [name] if shared else {f'{space}{name}' for space in spaces}:
                    if topic not in topics:
                        topics[topic] = bag.add_topic(topic, TYPES[name])
                    bag.write(topics[topic], serialize_message(message), k * NANO, k * NANO)
            bag.sync()


def one_frame(k, header):
    """Yield the messages of a frame with their topics."""
    item = Estimate(np.array([k, 0.5, 2.0, 0.0]), np.eye(4), 0.9, '1')
    for name in ('/ground_truth', '/tracks'):
        yield f'{name}/odometry', messages.estimate_to_odometry(item, header)
        yield name, messages.estimates_to_array([item], header, 1.0)
    bare = Estimate(item.state, item.cov, item.score)
    yield '/detections', messages.estimates_to_array([bare], header, 1.0)
    yield '/image_raw', messages.frame_to_image(np.full((5, 6), float(k)), header)


@functools.cache
def shipped(storage):
    """Return the files of a whole bag by name."""
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder, 'bag')
        write_bag(bag, storage)
        return {path.name: path.read_bytes() for path in bag.iterdir()}


@st.composite
def bags(draw):
    """Return the files of a faulty bag by name."""
    storage = draw(st.sampled_from(sorted(STORAGES)))
    files = dict(shipped(storage))
    name = STORAGES[storage]
    how = draw(st.integers(0, 7))
    if how < 4:
        files[name] = draw(damaged(files[name]))
    elif how == 4:
        files['metadata.yaml'] = draw(damaged(files['metadata.yaml']))
    elif how == 5:
        tree = yaml.safe_load(files['metadata.yaml'])['rosbag2_bagfile_information']
        tree[draw(st.sampled_from(sorted(tree)))] = draw(trees)
        files['metadata.yaml'] = yaml.safe_dump({'rosbag2_bagfile_information': tree}).encode()
    elif how == 6:
        del files[draw(st.sampled_from(sorted(files)))]
    else:  # the files of another kind of bag
        other = shipped(draw(st.sampled_from(sorted(STORAGES))))
        files[name] = draw(st.sampled_from(sorted(other.values())))
    return files


def lay_out(place, files):
    """Write the files of a bag; return its folder and a folder for results."""
    for name in ('bag', 'results'):
        shutil.rmtree(place / name, ignore_errors=True)
    (place / 'bag').mkdir()
    for name, data in files.items():
        (place / 'bag' / name).write_bytes(data)
    return place / 'bag', place / 'results'


def evaluated(folder, results):
    """Score a bag as evaluate.py does; return the notes."""
    options = argparse.Namespace(bag=folder, results=results, frames_topic=None, truth_topic=None)
    with redirect_stderr(StringIO()) as notes:
        made, _ = evaluate.score(options)
    check_results(made)
    return [line.removeprefix('evaluate.py: ') for line in notes.getvalue().splitlines()]


def check_results(folder):
    """Check that the results of a bag are complete and inert."""
    summary = json.loads((folder / 'summary.json').read_text())
    assert all(line.isprintable() for line in format_table(summary).split('\n'))
    with (folder / 'frames.csv').open(newline='') as file:
        assert {len(row) for row in csv.reader(file)} == {len(FRAME_COLUMNS)}
    page = write_run_report(folder, 'again').read_text()
    assert page.count('<script') == page.count('</script') <= 2
    assert not re.search('<img(?! alt="[^"]*" src="data:)', page)


def played(folder):
    """Play a bag as the player does."""
    with Bag(folder) as bag:
        count = sum(1 for _ in played_frames(bag, '/image_raw', '/ground_truth'))
        assert count <= FRAMES * 64
        return bag.notes


def inspected(folder):
    """Read through a bag as bringup.py --replay does."""
    return inspect_bag(folder, '/image_raw', '/ground_truth').notes


@pytest.fixture(autouse=True)
def config(monkeypatch):
    """Read the configuration once, not for every bag."""
    whole = functools.cache(config_files.load_config)
    monkeypatch.setattr(config_files, 'load_config', whole)
    # Drawing takes a second; test_files.py draws hostile names.
    monkeypatch.setattr(figures, 'single_run', lambda *_: None)
    monkeypatch.setattr(run_report, 'render', lambda figure: ('<svg/>', b''))
    monkeypatch.setattr(pages, 'versions', lambda: pages.Markup('versions'))


@fuzz('damaged bags', 240, files=bags())
def test_damaged_bag_is_used_or_rejected(place, files):
    use_all(place, files)


def use_all(place, files):
    """Use a bag in every way: it is rejected, or used with a line for each fault."""
    folder, results = lay_out(place, files)
    for use in (inspected, played, lambda path: evaluated(path, results)):
        notes = tried(folder, use, folder)
        for note in notes or ():
            assert note.startswith((str(folder), 'answers to stamp')), note
            assert note.isprintable(), note
    inside = {path.relative_to(place).parts[0] for path in place.rglob('*')}
    assert inside <= {'bag', 'results'}


@st.composite
def parameter_texts(draw):
    """Return the parameters that a bag carries, as text."""
    if draw(st.integers(0, 4)) == 0:
        return draw(nasty | trees.map(yaml.safe_dump))
    tree = copy.deepcopy(PARAMETERS)
    for _ in range(draw(st.integers(1, 2))):
        replace_somewhere(draw, tree)
    return yaml.safe_dump(tree).replace('PLACE', draw(nasty | st.sampled_from(HOSTILE).map(repr)))


@fuzz('parameters in bags', 120, text=parameter_texts(), storage=st.sampled_from(sorted(STORAGES)))
def test_bag_may_carry_any_parameters(place, text, storage):
    use_all(place, shipped(storage) | {'metadata.yaml': with_parameters(storage, text)})


def with_parameters(storage, text):
    """Return the metadata of a bag that carries these parameters of its run."""
    tree = yaml.safe_load(shipped(storage)['metadata.yaml'])
    tree['rosbag2_bagfile_information']['custom_data'][CUSTOM_PARAMETERS] = text
    return yaml.safe_dump(tree).encode()


@fuzz('names of topics', 48, first=names.filter(sendable), second=names.filter(sendable),
      storage=st.sampled_from(sorted(STORAGES)))
def test_topics_may_be_called_anything(place, first, second, storage):
    shutil.rmtree(place / 'bag', ignore_errors=True)
    write_bag(place / 'bag', storage, '{}', (f'/{first}', f'/{second}'))
    use_all(place, {path.name: path.read_bytes() for path in (place / 'bag').iterdir()})
