# SPDX-License-Identifier: Apache-2.0
"""What ``--view`` shows of a real run, and that showing it changes nothing."""

import functools
from pathlib import Path
import signal
import time

from browser import browser
from browser import port_of_no_other
from drain import drain
from graph_runs import own_domain
from graph_runs import start_bringup
from lowsnr_common.ros.messages import array_to_estimates
from lowsnr_common.ros.messages import stamp_key
from lowsnr_common.ros.qos import reliable
from lowsnr_eval.report.palette import rgb
from lowsnr_eval.report.palette import TRACK
from lowsnr_eval.report.palette import TRUTH
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from ros_nodes import spun_node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image
from vision_msgs.msg import Detection2DArray
from visualization_msgs.msg import Marker
from visualization_msgs.msg import MarkerArray
import yaml

CONFIG = Path(__file__).resolve().parents[2] / 'config'
FRAMES, SIZE, ZOOM = 40, 20, 24
RUN = ('--detector', 'cdt', '--snr', '15')
# All that sensor and tracker publish: with observers they wait for a reader of each.
SENSOR = {
    'image_raw': Image, 'ground_truth': Detection2DArray, 'ground_truth/odometry': Odometry,
    'clock': Clock}
TRACKER = {
    'tracks': Detection2DArray, 'tracks/odometry': Odometry, 'tracks/tentative': Detection2DArray}
VIEWER = {'overlay': Image, 'markers': MarkerArray}
ALL = (*VIEWER.items(), *SENSOR.items(), *TRACKER.items())
OBSERVED = (
    '--rate', '10', '--view', '--set', 'sensor.observers=1', '--set', 'tracker.observers=1',
    '--set', 'viewer.observers=1')


@pytest.fixture(scope='module')
def watch(tmp_path_factory):
    """Return a function that runs a graph, once, and returns what came by topic and stamp."""
    @functools.cache
    def run(topics, *arguments):
        seen, readers = {topic: {} for topic, _ in topics}, []
        with spun_node('onlooker', own_domain()) as (node, executor):
            for topic, kind in topics:
                def take(message, topic=topic, received=seen[topic]):
                    if topic != 'clock':
                        header = getattr(message, 'header', None) or message.markers[0].header
                        received[stamp_key(header.stamp)] = message
                readers.append(node.create_subscription(kind, topic, take, reliable(1000)))
            with start_bringup(
                    tmp_path_factory.mktemp('watched') / 'run', *arguments,
                    domain_id=own_domain()) as started:
                while started.process.poll() is None:
                    executor.spin_once(timeout_sec=0.05)
                for reader in readers:
                    drain(reader)
                code, _, err = started.finish()
        assert code == 0, err
        return seen, started

    return run


def coloured(picture, colour):
    """Return (x, y) in cells of the pixels that have a colour."""
    rows, cols = np.nonzero((picture == rgb(colour)).all(axis=-1))
    return (np.stack([cols, rows], axis=-1) + 0.5) / ZOOM - 0.5


def drawn(tracks, picture):
    """Return how many tracks lie well within a picture, after checking that they are drawn."""
    places = [item.state[[0, 2]] for item in tracks]
    inside = [place for place in places if (place > 1.0).all() and (place < SIZE - 2.0).all()]
    for place in inside:
        crossing = coloured(picture, TRACK) - place
        assert np.hypot(*crossing.T).min() < 0.1
    return len(inside)


@pytest.fixture(scope='module')
def widowed(tmp_path_factory):
    """Return a run whose viewer was killed; it goes on while another test runs."""
    with start_bringup(
            tmp_path_factory.mktemp('widowed') / 'run', '--detector', 'cdt', '--rate', '4',
            '--view', domain_id=own_domain(1)) as run:
        run.wait_for_rows(10)
        run.kill('viewer_node')
        yield run


@pytest.mark.slow
@pytest.mark.usefixtures('widowed')
def test_viewer_changes_no_result(bringup, watch):
    # Long enough for the viewer and its onlooker to discover each other.
    run = (*RUN, '--lockstep', '--frames', '400')
    plain = bringup(*run)
    assert plain.finish()[0] == 0
    seen, viewed = watch(
        tuple(VIEWER.items()), *run, '--view', '--set', 'viewer.observers=1')
    assert seen['overlay']
    assert seen['markers']
    assert (viewed.results / 'frames.csv').read_bytes() == (
        plain.results / 'frames.csv').read_bytes()


def test_viewer_shows_what_is_there(watch):
    seen, _ = watch(ALL, *RUN, *OBSERVED)
    assert len(seen['ground_truth']) == len(seen['tracks']) == FRAMES
    # Some frames may pass before the viewer and its onlooker have discovered each other, or on a
    # machine that is busy.
    shown = seen['overlay'].keys() & seen['markers'].keys()
    assert len(shown) >= FRAMES // 2
    followed = late = 0
    for stamp in shown:
        image = seen['overlay'][stamp]
        assert (image.encoding, image.width, image.height) == ('rgb8', SIZE * ZOOM, SIZE * ZOOM)
        picture = np.frombuffer(image.data, np.uint8).reshape(SIZE * ZOOM, SIZE * ZOOM, 3)
        truth = array_to_estimates(seen['ground_truth'][stamp], 1.0)
        circle = coloured(picture, TRUTH)
        assert (len(circle) > 0) == (len(truth) > 0)
        tracks = array_to_estimates(seen['tracks'][stamp], 1.0)
        markers = {marker.ns: marker for marker in seen['markers'][stamp].markers}
        assert (len(coloured(picture, TRACK)) > 0) == (len(markers.keys() & {'trails', 'ids'}) > 0)
        if tracks and 'ellipses' not in markers:  # they came when it was shown
            late += 1
            continue
        followed += drawn(tracks, picture)
        if truth and not tracks:
            assert circle.mean(axis=0) == pytest.approx(truth[0].state[[0, 2]], abs=0.35)
        points = [(p.x, p.y) for p in markers['truth'].points] if truth else []
        assert points == [tuple(item.state[[0, 2]]) for item in truth]
    assert followed > 5
    assert late < len(shown) // 2


def test_markers_name_every_namespace_that_rviz_shows(watch):
    seen, _ = watch(ALL, *RUN, *OBSERVED)
    config = yaml.safe_load((CONFIG / 'lowsnr.rviz').read_text())['Visualization Manager']
    (shown,) = [item['Namespaces'] for item in config['Displays'] if 'Namespaces' in item]
    arrays = seen['markers'].values()
    assert {marker.ns for array in arrays for marker in array.markers} == set(shown) | {''}
    for array in arrays:
        assert array.markers[0].action == Marker.DELETEALL
        assert len({(marker.ns, marker.id) for marker in array.markers}) == len(array.markers)
        assert {marker.header.frame_id for marker in array.markers} == {'sensor'}


def test_every_chain_has_its_viewer(watch):
    # All that the viewers publish: with observers they wait for a reader of each.
    seen, _ = watch(
        tuple((f'{name}/{topic}', kind) for name in ('cdt', 'sdt')
              for topic, kind in VIEWER.items()),
        '--detector', 'cdt', 'sdt', '--rate', '10', '--view', '--set', 'viewer.side=100',
        '--set', 'viewer.observers=1')
    for name in ('cdt', 'sdt'):
        assert len(seen[f'{name}/overlay']) >= FRAMES // 2
        assert {image.width for image in seen[f'{name}/overlay'].values()} == {100}


def test_run_goes_on_without_a_viewer_that_died(widowed):
    run = widowed
    code, _, err = run.finish()
    assert code == 0, err
    assert [line for line in err.splitlines() if 'viewer' in line and 'SIGKILL' in line]
    assert run.summary()['frames'] == {
        'expected': FRAMES, 'published': FRAMES, 'scored': FRAMES, 'unanswered': 0, 'unseen': 0,
        'lost': 0}


def test_live_page_follows_the_run_and_its_viewer_that_was_started_again(
    bringup, tmp_path, chromium,
):
    port = port_of_no_other()
    run = bringup(
        '--detector', 'cdt', '--loop', '--rate', '20', '--view', '--view-port', str(port))
    with browser(chromium, tmp_path / 'profile') as page:
        run.wait_for_rows(2)
        page.load(f'http://127.0.0.1:{port}/')

        def wait_for(count):
            run.wait_for_rows(len(run.rows()) + 2 * count)
            until = time.monotonic() + 120.0
            # The page of a viewer that was started again is loaded again.
            while page.value('typeof lines === "object" ? lines.length : 0') < count:
                assert time.monotonic() < until
                time.sleep(0.05)

        wait_for(50)
        lines = page.value('lines.map(line => ({...line, greys: line.greys.length}))')
        assert ({line['greys'] for line in lines}, lines[-1]['asked']) == ({SIZE * SIZE}, 0.01)
        stamps = [line['stamp_s'] for line in lines]
        assert stamps == sorted(set(stamps))
        assert {len(line['truth']) for line in lines} == {0, 1}
        run.kill('viewer_node')
        run.wait_for_restarts(1)
        page.value('lines.length = 0')
        wait_for(5)
        run.process.send_signal(signal.SIGINT)
        code, _, err = run.finish()
    assert code == 130
    assert set(stamps) <= {float(row.split(',')[1]) for row in run.rows()}
    assert err.count(f'http://127.0.0.1:{port}/') == 2
