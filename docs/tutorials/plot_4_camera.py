# SPDX-License-Identifier: Apache-2.0
"""
A live camera
=============

Every node that publishes ``sensor_msgs/Image`` is a camera. Here the simulated sensor stands in
for one: it publishes frames with an object of 12 dB on a topic of its own, and knows nothing of
the graph that looks at it.
"""

import csv
import json
from pathlib import Path
import signal
import subprocess
import sys
from tempfile import TemporaryDirectory
import time

import lowsnr
import matplotlib.pyplot as plt

ROOT = Path(lowsnr.__file__).resolve().parents[3]  # the checkout
PLACE = TemporaryDirectory()
RESULTS = Path(PLACE.name, 'run')
TOPIC, FRAMES = '/camera/image_raw', 120

CAMERA = [
    sys.executable, '-m', 'lowsnr_sensor.sensor_node', '--ros-args',
    '-p', f'scenario:={ROOT / "config" / "scenarios" / "example4.yaml"}',
    '-p', 'sensor.snr_db:=12.0', '-p', 'loop:=true', '-p', 'rate_hz:=30.0',
    '-r', f'image_raw:={TOPIC}', '-r', '__ns:=/camera']

# %%
# ``--camera`` takes the topic. The run ends with Ctrl-C, which this program sends once enough
# frames have been answered; in your own terminal you press the keys. ``--record FOLDER`` would
# keep the frames. These frames are noise already, so that they are not conditioned.

GRAPH = [
    sys.executable, 'scripts/bringup.py', '--camera', TOPIC, '--detector', 'sdt', '--snr', '12',
    '--condition', 'off', '--results', str(RESULTS), '--camera-within', '60']
answers = RESULTS / 'frames.csv'
with subprocess.Popen(
        CAMERA, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as camera, \
     subprocess.Popen(GRAPH, cwd=ROOT, stdout=subprocess.PIPE, text=True) as graph:
    try:
        while graph.poll() is None and not (
                answers.exists() and answers.read_text().count('\n') > 2 * FRAMES):
            time.sleep(0.2)
    finally:
        graph.send_signal(signal.SIGINT)
        print(graph.communicate()[0].replace(PLACE.name, ''))
        camera.kill()

# %%
# There is no truth, so that nothing is scored: declarations are counted, and the false-alarm rate
# that was asked for stands beside the one that the detector measured itself.

summary = json.loads((RESULTS / 'summary.json').read_text())
print(json.dumps(summary['frames'], indent=2))
tracks = list(csv.DictReader((RESULTS / 'tracks.csv').open()))
figure, axis = plt.subplots(figsize=(5.5, 4.5), layout='constrained')
axis.scatter([float(row['x']) for row in tracks], [float(row['y']) for row in tracks],
             c=[float(row['score']) for row in tracks], s=14)
axis.set(title='tracks, coloured by their score', xlim=(-0.5, 19.5), ylim=(19.5, -0.5),
         xlabel='x [pixels]', ylabel='y [pixels]')

# %%
# :doc:`/real_frames` has the encodings and the ways in which a camera may fail, and
# :doc:`/operations` how to let cameras on other hosts in.
PLACE.cleanup()
plt.show()
