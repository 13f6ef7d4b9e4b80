# SPDX-License-Identifier: Apache-2.0
"""One sequence of :mod:`real_frames` through the graph: to a bag, replayed, and read back."""

import json
from pathlib import Path
import subprocess
import sys
import tempfile
from typing import Any

ROOT = Path(__file__).resolve().parents[1]


def through_graph(
    data: Any, frames: Any, options: Any,
) -> tuple[list[Any], list[Any], float]:
    """Return positions x, y [pixels] of detections and tracks in each frame, and the rate."""
    from lowsnr_bringup.bags.reader import Bag
    import numpy as np

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        arrays = {key: data[key] for key in ('t_s',) if key in data}
        np.savez(folder / 'frames.npz', frames=frames, **arrays)
        script('convert.py', folder / 'frames.npz', '--out', folder / 'frames')
        script(
            'bringup.py', '--replay', folder / 'frames', '--detector', options.detector, '--snr',
            options.snr, '--lockstep', '--record', folder / 'answers', '--results', folder / 'run',
            '--set', f'{options.detector}.false_alarm_prob={options.prob:g}')
        summary = json.loads((folder / 'run' / 'summary.json').read_text())
        places: dict[str, list[Any]] = {'/detections': [], '/tracks': []}
        with Bag(folder / 'answers') as bag:
            for message in bag.messages(places):
                centres = [each.bbox.center.position for each in bag.read(message).detections]
                places[message.topic].append(
                    np.array([(at.x, at.y) for at in centres]).reshape(-1, 2))
    found, tracks = places.values()
    assert len(found) == len(tracks) == len(frames), 'the recording lacks answers'
    return found, tracks, summary['detectors'][options.detector]['pfa_measured']


def script(name: str, *arguments: Any) -> None:
    """Run a script of the project; its last lines end this program if it fails."""
    done = subprocess.run(
        [sys.executable, str(ROOT / 'scripts' / name), *map(str, arguments)],
        capture_output=True, text=True)
    if done.returncode:
        sys.exit(f'{name}: {done.stderr[-1000:]}')
