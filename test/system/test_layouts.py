# SPDX-License-Identifier: Apache-2.0
"""The shipped layouts for Foxglove and RViz show what the bag of a run holds."""

import json
from pathlib import Path
import re

from graph_runs import own_domain
from graph_runs import start_bringup
from lowsnr_bringup.bags.reader import Bag
import numpy as np
import pytest
import yaml

CONFIG = Path(__file__).resolve().parents[2] / 'config'
# Type of the topic that each kind of panel shows, and where its settings name the topic.
IMAGE, MARKERS, DIAGNOSTICS = (
    'sensor_msgs/msg/Image', 'visualization_msgs/msg/MarkerArray',
    'diagnostic_msgs/msg/DiagnosticArray')
# Foxglove's syntax of a path: /topic.field[:]{key=="text"}.field
TOPIC = re.compile(r'(/[\w/]+)\.')
STEP = re.compile(r'(\w+)(\[:\]|\[0\])?(?:\{(\w+)=="([^"]*)"\})?(?:\.|$)')


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    """Return the bag of a run with adaptive thresholds whose viewer was recorded, open."""
    folder = tmp_path_factory.mktemp('layouts')
    with start_bringup(
            folder / 'run', '--detector', 'cdt', '--snr', '15', '--rate', '40', '--frames', '80',
            '--set', 'cdt.operating_point=adaptive', '--view', '--record', str(folder / 'bag'),
            domain_id=own_domain()) as run:
        code, _, err = run.finish()
    assert code == 0, err
    with Bag(folder / 'bag') as opened:
        yield opened


@pytest.fixture(scope='module')
def layout():
    """Return the layout for Foxglove."""
    return json.loads((CONFIG / 'lowsnr_foxglove.json').read_text())


def values_at(message, path):
    """Return the values that a path leads to in a message, as Foxglove finds them."""
    found, at = [message], 0
    while at < len(path):
        step = STEP.match(path, at)
        name, index, key, text = step.groups()
        found = [getattr(each, name) for each in found]
        if index == '[:]':
            found = [item for items in found for item in items]
        elif index == '[0]':
            found = [items[0] for items in found if len(items)]
        if key:
            found = [each for each in found if getattr(each, key) == text]
        at = step.end()
    return found


def plotted(bag, path):
    """Return the numbers that a plot shows of a bag."""
    topic = TOPIC.match(path)
    messages = [bag.read(each) for each in bag.messages([topic[1]])]
    return [float(value) for message in messages
            for value in values_at(message, path[topic.end():])]


def test_foxglove_layout_has_the_panels_that_it_places(layout):
    def panels(node):
        return [node] if isinstance(node, str) else panels(node['first']) + panels(node['second'])

    placed = panels(layout['layout'])
    assert len(set(placed)) == len(placed)
    assert set(placed) == set(layout['configById'])


def test_every_panel_is_of_a_kind_that_foxglove_has(layout):
    # Of the panels that Foxglove documents, by the names that layouts give them.
    known = {
        '3D', 'DiagnosticStatusPanel', 'DiagnosticSummary', 'Gauge', 'Image', 'Indicator', 'Plot',
        'RawMessages', 'RosOut', 'SourceInfo', 'StateTransitions', 'Table', 'TopicGraph'}
    assert {panel.partition('!')[0] for panel in layout['configById']} <= known


def test_foxglove_plots_find_their_numbers_in_a_bag(bag, layout):
    paths = {
        (panel, path['label']): path for panel, settings in layout['configById'].items()
        if panel.startswith('Plot!') for path in settings['paths']}
    assert set(paths) == {
        ('Plot!existence', 'confirmed'), ('Plot!existence', 'tentative'),
        ('Plot!false_alarms', 'asked'), ('Plot!false_alarms', 'measured')}
    shown = {label: plotted(bag, path['value']) for (_, label), path in paths.items()}
    for label, numbers in shown.items():
        assert numbers, label
        assert min(numbers) >= 0.0
        assert max(numbers) <= 1.0
    assert set(shown['asked']) == {0.01}
    assert min(shown['confirmed']) > max(0.0, min(shown['tentative']))
    # The time axis is that of the bag: stamps of headers are data time.
    assert {path['timestampMethod'] for path in paths.values()} == {'receiveTime'}


def test_foxglove_panels_show_topics_of_a_bag(bag, layout):
    panels = layout['configById']
    shown = {
        panels['Image!overlay']['imageMode']['imageTopic']: IMAGE,
        panels['Image!frames']['imageMode']['imageTopic']: IMAGE,
        panels['DiagnosticSummary!nodes']['topicToRender']: DIAGNOSTICS,
        **dict.fromkeys(panels['3D!markers']['topics'], MARKERS)}
    assert len(shown) == 4
    assert {topic: bag.topics.get(topic) for topic in shown} == shown
    assert {message.topic for message in bag.messages(shown)} == set(shown)


def test_rviz_displays_show_topics_of_a_bag(bag):
    config = yaml.safe_load((CONFIG / 'lowsnr.rviz').read_text())['Visualization Manager']
    frames = {bag.read(each).header.frame_id for each in bag.messages(['/image_raw'])}
    assert frames == {config['Global Options']['Fixed Frame']}
    kinds = {'rviz_default_plugins/Image': IMAGE, 'rviz_default_plugins/MarkerArray': MARKERS}
    for display in config['Displays']:
        assert bag.topics['/' + display['Topic']['Value']] == kinds[display['Class']]


def test_rviz_configuration_shows_the_topics_of_the_viewer():
    config = yaml.safe_load((CONFIG / 'lowsnr.rviz').read_text())['Visualization Manager']
    displays = {item['Topic']['Value']: item for item in config['Displays']}
    assert {topic: item['Class'] for topic, item in displays.items()} == {
        'overlay': 'rviz_default_plugins/Image', 'image_raw': 'rviz_default_plugins/Image',
        'markers': 'rviz_default_plugins/MarkerArray'}
    assert displays['image_raw']['Normalize Range'] is True
    # Seen by the orbit camera, x points right and y down.
    view = config['Views']['Current']
    pitch, yaw = view['Pitch'], view['Yaw']
    ahead = -np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)])
    right = np.cross(ahead, [0.0, 0.0, 1.0]) / np.hypot(*ahead[:2])
    assert right == pytest.approx([1.0, 0.0, 0.0], abs=1e-3)
    assert np.cross(ahead, right) == pytest.approx([0.0, 1.0, 0.0], abs=2e-3)
