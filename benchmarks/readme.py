# SPDX-License-Identifier: Apache-2.0
"""
Make again what the README shows: its moving picture, and what its program and command print.

The left half of the picture shows the frames as they are, the right half the same ones with the
truth (a ring), detections (squares) and tracks (crosses with their trails).
"""

import argparse
import base64
from collections.abc import Iterator
from pathlib import Path
import re
import subprocess
import sys
from tempfile import TemporaryDirectory
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / 'scripts')]

import _environment  # noqa: E402

PICTURE = ROOT / 'docs' / 'run.svg'
PAGES = (ROOT / 'README.md', ROOT / 'docs' / 'start.md')
PROGRAM = re.compile(r'```python\n(import .*?)```\n\n```\n(.*?)```\n', re.DOTALL)
# What bring-up prints of a run, up to its latencies, which depend on the machine.
TABLE = re.compile(r'^example4, seed 0.*?by the detector -$', re.DOTALL | re.MULTILINE)
SCENARIO, DETECTOR, SNR_DB, SEED = 'example4', 'sdt', 9.0, 0
CELL, GAP, FRAME_S, TRAIL = 14, 16, 0.25, 12
TRUTH, DETECTION, TRACK = '#2ca02c', '#4c9be8', '#ff7f0e'


def main() -> int:
    """Write the picture and the outputs; return the exit code."""
    argparse.ArgumentParser(
        description=__doc__.strip().partition('\n')[0], allow_abbrev=False).parse_args()
    _environment.ensure()
    PICTURE.write_text(picture(), encoding='utf-8')
    text = PAGES[0].read_text(encoding='utf-8')
    source, shown = PROGRAM.findall(text)[0]
    PAGES[0].write_text(text.replace(shown, printed('-c', source)), encoding='utf-8')
    with TemporaryDirectory() as folder:
        table = TABLE.findall(printed(
            'scripts/bringup.py', '--detector', DETECTOR, '--results', folder))[0]
    for path in PAGES:
        text = path.read_text(encoding='utf-8')
        path.write_text(TABLE.sub(lambda _: table, text, count=1), encoding='utf-8')
    return 0


def printed(*arguments: str) -> str:
    """Return what a Python program prints."""
    return subprocess.run(
        [sys.executable, *arguments], cwd=ROOT, check=True, stdout=subprocess.PIPE,
        text=True).stdout


def picture() -> str:
    """Return the picture of a run as an SVG that moves."""
    import lowsnr

    made = lowsnr.simulate(SCENARIO, snr_db=SNR_DB, seed=SEED)
    found = lowsnr.track(made.frames, DETECTOR, SNR_DB, seed=SEED)
    count, rows, cols = made.frames.shape
    width, height = 2 * CELL * cols + GAP, CELL * rows + 24
    share = 100.0 / count
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" '
        f'width="{width}" height="{height}" font-family="sans-serif" font-size="12">',
        f'<title>{count} frames of an object of {SNR_DB:g} dB, and what {DETECTOR} and the '
        'tracker find in them</title>',
        f'<style>.f{{visibility:hidden;animation:f {count * FRAME_S:g}s step-end infinite}}'
        f'@keyframes f{{0%{{visibility:visible}}{share:g}%{{visibility:hidden}}}}'
        'image{image-rendering:pixelated}</style>']
    for k in range(count):
        lines += [f'<g class="f" style="animation-delay:{k * FRAME_S:g}s">',
                  *drawn_frame(k, made, found), '</g>']
    lines += [legend(CELL * rows + 17, CELL * cols + GAP), '</svg>']
    return '\n'.join(lines) + '\n'


def drawn_frame(k: int, made: Any, found: Any) -> Iterator[str]:
    """Yield the elements of a frame: twice the pixels, then the marks over the second ones."""
    import cv2
    import numpy as np

    _, rows, cols = made.frames.shape
    grey = np.clip(255.0 * (made.frames[k] + 3.0) / 8.0, 0.0, 255.0).astype(np.uint8)
    data = base64.b64encode(cv2.imencode('.png', grey)[1].tobytes()).decode()
    size = f'width="{CELL * cols}" height="{CELL * rows}"'
    right = CELL * cols + GAP
    yield (f'<image id="p{k}" {size} href="data:image/png;base64,{data}"/>'
           f'<use href="#p{k}" x="{right}"/>')
    for row in made.truth[made.truth.frame == k]:
        x, y = places(row, right)
        yield f'<circle cx="{x}" cy="{y}" r="12" fill="none" stroke="{TRUTH}" stroke-width="2"/>'
    for row in found.detections[found.detections.frame == k]:
        x, y = places(row, right)
        yield (f'<rect x="{x - 7:g}" y="{y - 7:g}" width="14" height="14" fill="none" '
               f'stroke="{DETECTION}" stroke-width="2"/>')
    for row in found.tracks[found.tracks.frame == k]:
        x, y = places(row, right)
        own = found.tracks[(found.tracks.id == row.id) & (found.tracks.frame <= k)][-TRAIL:]
        trail = ' '.join('{:g},{:g}'.format(*places(each, right)) for each in own)
        yield (f'<g fill="none" stroke="{TRACK}" stroke-width="2"><polyline points="{trail}"/>'
               f'<path d="M{x - 8:g} {y:g}h16M{x:g} {y - 8:g}v16"/></g>')


def places(row: Any, right: int) -> tuple[float, float]:
    """Return the place of a row of a table in the right half."""
    return round(right + CELL * (row.x + 0.5), 1), round(CELL * (row.y + 0.5), 1)


def legend(y: int, right: int) -> str:
    """Return what the marks mean."""
    words = ((TRUTH, 'object'), (DETECTION, 'detections'), (TRACK, 'track'))
    marks = ''.join(f'<tspan fill="{colour}" dx="12">{word}</tspan>' for colour, word in words)
    return (f'<g fill="#888"><text x="0" y="{y}">what the sensor sees, {SNR_DB:g} dB</text>'
            f'<text x="{right}" y="{y}">what is found{marks}</text></g>')


if __name__ == '__main__':
    sys.exit(main())
