# SPDX-License-Identifier: Apache-2.0
"""The live page and its server, with browsers that are slow, of other sites, and real."""

import asyncio
import base64
from contextlib import closing
import json
import os
from pathlib import Path
import re
import socket
import struct
import sys
import time

from browser import browser
from browser import port_of_no_other
from lowsnr_bringup.plan.loopback import check_ports
from lowsnr_bringup.plan.loopback import FIRST_PORT
from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.core.records import AlarmRate
from lowsnr_common.core.records import Estimate
from lowsnr_common.settings.node_settings import ViewSettings
from lowsnr_eval.live.live_page import frame_text
from lowsnr_eval.live.live_page import live_page
from lowsnr_eval.live.live_page import open_page
from lowsnr_eval.live.live_server import KEPT
from lowsnr_eval.live.live_server import LiveServer
import numpy as np
import pytest
from tornado.httpclient import AsyncHTTPClient
from tornado.httpclient import HTTPClientError
from tornado.httpclient import HTTPRequest
from tornado.websocket import websocket_connect

SHAPE = (7, 5)
NUMBER = "get('number').textContent"


@pytest.fixture
def server():
    """Return the server of a live page."""
    made = LiveServer(live_page(ViewSettings(
        title='<b>a run</b>', sensor=SensorModel(cell_size_m=2.0))))
    yield made
    made.close()


def tracked(x, y, name):
    cov = np.zeros((4, 4))
    cov[np.ix_([0, 2], [0, 2])] = [[4.0, 1.0], [1.0, 2.0]]
    return Estimate(np.array([x, 0.0, y, 0.0]), cov, 0.75, name)


def text_of(stamp_s, truth=None):
    """Return what is sent of a frame with a track, whose first cell alone is white."""
    greys = np.zeros(SHAPE, np.uint8)
    greys[0, 0] = 255
    return frame_text(
        stamp_s, greys, (-1.0, 3.0), (truth, [], [tracked(2.0, 3.0, '7')]),
        AlarmRate(0.01, 0.02), 2.0)


def until(condition, within_s=60.0):
    end = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < end, 'the condition did not come true'
        time.sleep(0.02)


def fetch(address, **headers):
    """Return the status of a request with these headers."""
    async def ask():
        try:
            answer = await AsyncHTTPClient().fetch(HTTPRequest(
                address, headers={name.title(): value for name, value in headers.items()}))
        except HTTPClientError as error:
            return error.code
        return answer.code
    return asyncio.run(ask())


def connect(address, **headers):
    """Return the status with which a browser may not have the frames, 101 if it may."""
    async def ask():
        request = HTTPRequest(
            address.replace('http', 'ws') + 'frames',
            headers={name.title(): value for name, value in headers.items()})
        try:
            connection = await websocket_connect(request)
            connection.close()
            while await connection.read_message() is not None:
                pass
        except HTTPClientError as error:
            return error.code
        return 101
    return asyncio.run(ask())


def test_frame_is_sent_in_cells_with_identity_existence_and_covariance():
    sent = json.loads(text_of(3, [tracked(4.0, 6.0, 'east')]))
    assert (sent['stamp_s'], sent['shape'], sent['asked']) == (3, [7, 5], 0.01)
    assert base64.b64decode(sent['greys'])[:2] == b'\xff\0'
    assert sent['truth'] == [[2.0, 3.0, 'east']]
    chain, = sent['chains'].values()
    assert chain['tracks'] == [[1.0, 1.5, '7', 0.75, 1.0, 0.25, 0.5]]
    assert (chain['detections'], chain['measured']) == ([], 0.02)
    assert json.loads(text_of(3))['truth'] is None


@pytest.mark.parametrize('host', ['127.0.0.1:{}', 'localhost:{}', 'localhost:9', '[::1]:{}'])
def test_browser_of_this_host_may_have_page_and_frames(server, host):
    port = server.address.split(':')[2].strip('/')
    own = host.format(port)
    assert fetch(server.address, host=own) == 200
    assert connect(server.address, host=own, origin=f'http://{own}') == 101


@pytest.mark.parametrize('host', [
    'evil.example', 'evil.example:8470', '127.0.0.1.evil.example', '[', '[::1'])
def test_name_that_leads_here_from_another_site_is_rejected(server, host):
    assert fetch(server.address, host=host) == 403
    assert connect(server.address, host=host, origin=f'http://{host}') == 403


@pytest.mark.parametrize('origin', [
    'https://evil.example', 'http://127.0.0.1:1', 'http://localhost', 'null', 'http://['])
def test_page_of_another_site_may_not_have_the_frames(server, origin):
    assert connect(server.address, origin=origin) == 403
    assert not server.watched


def test_server_listens_on_the_loopback_address_alone(server):
    port = int(server.address.split(':')[2].strip('/'))
    wanted = f':{port:04X}'
    found = [line.split()[1] for name in ('tcp', 'tcp6') for line in
             Path(f'/proc/net/{name}').read_text().splitlines()
             if line.split()[1].endswith(wanted) and line.split()[3] == '0A']
    assert found == [f'{struct.unpack("<I", socket.inet_aton("127.0.0.1"))[0]:08X}{wanted}']


def test_port_that_is_taken_is_passed_over_or_named(server):
    port = int(server.address.split(':')[2].strip('/'))
    assert port >= FIRST_PORT
    with pytest.raises(ValueError, match=f'{port}.*--view-port'):
        check_ports([port])
    with closing(LiveServer('page')) as other:
        assert other.address != server.address


def test_server_that_is_closed_has_left_its_port():
    port = port_of_no_other()
    LiveServer('page', port).close()
    check_ports([port])


def test_browser_that_never_reads_delays_nobody_and_gets_the_newest(server):
    """
    Frames of 0.5 MB: 200 of them are more than any buffer of the system takes.

    All are published before the browser reads, so that a server that waits for it never ends.
    """
    port = int(server.address.split(':')[2].strip('/'))
    with socket.create_connection(('127.0.0.1', port)) as slow:
        slow.sendall((
            f'GET /frames HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\n'
            'Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\n'
            f'Sec-WebSocket-Key: {base64.b64encode(bytes(16)).decode()}\r\n\r\n').encode())
        until(lambda: server.watched)
        last = 200
        for number in range(1, last + 1):
            server.publish(f'{number:06d}' + 'x' * 500_000)
            time.sleep(0.002)
        received = bytearray()
        slow.settimeout(60.0)
        while not re.search(rb'%06dx' % last, received):
            received += (more := slow.recv(2**20))
            assert more
    numbers = [int(each) for each in re.findall(rb'(\d{6})x', received)]
    assert numbers == sorted(numbers)
    assert numbers[-KEPT:] == list(range(last - KEPT + 1, last + 1))
    assert len(numbers) < last / 2
    until(lambda: not server.watched)


def test_page_follows_pauses_and_scrubs_back(server, tmp_path, chromium):
    with browser(chromium, tmp_path / 'profile') as page:
        page.load(server.address)
        assert page.value('document.title') == '<b>a run</b>'
        until(lambda: server.watched)
        for stamp_s in (1.5, 2.0, 3.25):
            server.publish(text_of(stamp_s, [] if stamp_s < 3 else [tracked(4.0, 6.0, 'east')]))
        until(lambda: page.value(NUMBER) == (
            'frame 3 shown, stamp 3.250 s: 1 object, 0 detections, 1 track'))
        assert page.value('[plots.view.x, plots.view.y]') == [[-1.0, 9.0], [13.0, -1.0]]  # [m]
        assert page.value("get('asked').textContent").startswith('asked 0.01')
        page.press('ArrowLeft')
        assert page.value(NUMBER).startswith('frame 2 shown, stamp 2.000 s: 0 objects')
        server.publish(text_of(4))
        until(lambda: page.value('lines.length') == 4)
        assert page.value(NUMBER).startswith('frame 2 shown, stamp 2.000 s:')  # it is paused
        page.click('#play')
        assert page.value(NUMBER).startswith('frame 4 shown, stamp 4.000 s: truth unknown')
        page.press('Home')
        assert page.value(NUMBER).startswith('frame 1 shown, stamp 1.500 s:')
        server.publish(text_of(1))  # the clock was set back
        until(lambda: page.value('lines.map(line => line.frame)') == [1])
        server.close()
        until(lambda: page.value("get('status').textContent").startswith('not connected'))
        assert not [error for error in page.errors if 'WebSocket' not in error]
        local = server.address.partition(':')[2]
        assert all(local in address or address.startswith('data:') for address in page.requests)


def test_page_shows_no_frames_of_another_server_under_its_own_title(
    server, tmp_path, chromium,
):
    with browser(chromium, tmp_path / 'profile') as page:
        page.load(server.address)
        until(lambda: server.watched)
        server.publish(text_of(7))
        until(lambda: page.value('lines.length') == 1)
        server.close()
        until(lambda: page.value("get('status').textContent").startswith('not connected'))
        port = int(server.address.split(':')[2].strip('/'))
        with closing(LiveServer(live_page(ViewSettings(title='another run')), port)) as other:
            until(lambda: page.value('document.title') == 'another run')
            # Until the page has connected again it gets none.
            until(lambda: other.publish(text_of(7)) or page.value(
                'typeof lines === "object" && lines.length === 1'))


def test_page_opens_in_the_browser_of_the_user_where_there_is_a_screen(tmp_path, monkeypatch):
    opened = tmp_path / 'opened'
    program = tmp_path / 'a-browser'
    program.write_text(f'#!{sys.executable}\nimport sys\nopen({str(opened)!r}, "a").write('
                       'sys.argv[1])\n')
    program.chmod(0o700)
    for name in ('BROWSER', 'DISPLAY', 'WAYLAND_DISPLAY'):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv('PATH', os.devnull)
    open_page('http://127.0.0.1:1/')
    monkeypatch.setenv('BROWSER', f'{program} %s')
    open_page('http://127.0.0.1:2/')
    until(lambda: opened.exists() and opened.read_text() == 'http://127.0.0.1:2/')
