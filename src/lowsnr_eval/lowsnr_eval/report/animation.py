"""The animation of a report: frames that one can step through, with marks over them."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from collections.abc import Sequence
import json
from typing import Any

from lowsnr_eval.report.html_page import Markup
from lowsnr_eval.report.palette import DETECTION
from lowsnr_eval.report.palette import stretch
from lowsnr_eval.report.palette import TRACK
from lowsnr_eval.report.palette import TRUTH
import numpy as np

_HTML = """
<div class="player">
<p><button id="back" title="one frame back">&#9664;&#xFE0E;</button>
<button id="play" title="play or pause" style="width:4rem">play</button>
<button id="forward" title="one frame forward">&#9654;&#xFE0E;</button>
<input id="slider" type="range" min="0" max="{last}" value="0"
 style="width:24rem;vertical-align:middle" aria-label="frame">
<select id="chain" aria-label="detector"></select></p>
<p id="number" style="font-variant-numeric:tabular-nums"></p>
<canvas id="view" width="600" height="600" style="border:1px solid #ccc;max-width:100%"></canvas>
<p class="note">Legend: <b style="color:{truth}">&#9711;</b> object,
<b style="color:{detection}">&#9633;</b> detection,
<b style="color:{track}">&#10005;</b> track with its number. Arrow keys step. {note}</p>
</div>
<script type="application/json" id="scene">{data}</script>
"""
SCRIPT = """
const scene = JSON.parse(document.getElementById('scene').textContent);
const get = id => document.getElementById(id), view = get('view'), pen = view.getContext('2d');
const bytes = Uint8Array.from(atob(scene.pixels), c => c.charCodeAt(0));
const small = document.createElement('canvas');
let now = 0, timer = null, scale = 1, whole = scene.lines.find(line => line.shape);
for (const name of scene.chains) get('chain').add(new Option(name, name));
function paint(line) {
  if (line.shape) whole = line;  // one that did not come is as large as the one before
  const [rows, cols] = whole.shape;
  const zoom = Math.max(1, Math.round(700 / Math.max(rows, cols)));
  scale = zoom / whole.step;
  view.width = cols * zoom; view.height = rows * zoom;
  pen.fillStyle = 'white'; pen.fillRect(0, 0, view.width, view.height);
  if (line.place < 0) return;
  small.width = cols; small.height = rows;
  const image = new ImageData(cols, rows);
  for (let n = 0; n < rows * cols; n++) {
    const grey = bytes[line.place + n];
    image.data.set([grey, grey, grey, 255], 4 * n);
  }
  small.getContext('2d').putImageData(image, 0, 0);
  pen.imageSmoothingEnabled = false;
  pen.drawImage(small, 0, 0, view.width, view.height);
}
function mark(points, colour, draw) {
  const r = Math.max(7, .6 * scale);
  for (const [x, y, id] of points) {
    const path = new Path2D(), [px, py] = [(x + .5) * scale, (y + .5) * scale];
    draw(path, px, py, r);
    for (const [ink, width] of [['black', 5], [colour, 2.5]]) {
      pen.strokeStyle = ink; pen.lineWidth = width; pen.stroke(path);
    }
    if (colour !== scene.colours.track) continue;
    pen.font = 'bold 15px sans-serif'; pen.lineWidth = 4; pen.strokeStyle = 'black';
    pen.strokeText(id, px + r + 3, py - r); pen.fillStyle = colour;
    pen.fillText(id, px + r + 3, py - r);
  }
}
function show(k) {
  now = Math.min(Math.max(k, 0), scene.lines.length - 1);
  const line = scene.lines[now], {truth, detection, track} = scene.colours;
  const said = line.chains[get('chain').value] || {detections: [], tracks: []};
  paint(line);
  mark(line.truth, truth, (path, x, y, r) => path.arc(x, y, 1.5 * r, 0, 7));
  mark(said.detections, detection, (path, x, y, r) => path.rect(x - r, y - r, 2 * r, 2 * r));
  mark(said.tracks, track, (path, x, y, r) => {
    path.moveTo(x - r, y - r); path.lineTo(x + r, y + r);
    path.moveTo(x + r, y - r); path.lineTo(x - r, y + r); });
  get('slider').value = now;
  const count = (n, what) => `${n} ${what}${n === 1 ? '' : 's'}`;
  get('number').textContent = `frame ${line.frame}` +
    `${line.place < 0 ? ' (did not come)' : ''}: ${count(line.truth.length, 'object')}, ` +
    `${count(said.detections.length, 'detection')}, ${count(said.tracks.length, 'track')}`;
}
function pause() { clearInterval(timer); timer = null; get('play').textContent = 'play'; }
function play() {
  if (timer) return pause();
  get('play').textContent = 'pause';
  timer = setInterval(() => show((now + 1) % scene.lines.length), 200);
}
get('back').onclick = () => { pause(); show(now - 1); };
get('forward').onclick = () => { pause(); show(now + 1); };
get('play').onclick = play;
get('slider').oninput = event => { pause(); show(+event.target.value); };
get('chain').onchange = () => show(now);
document.addEventListener('keydown', event => {
  const step = {ArrowLeft: -1, ArrowRight: 1}[event.key];
  if (step && !['INPUT', 'SELECT'].includes(event.target.tagName)) { pause(); show(now + step); }
});
show(0);
"""


def player(
    lines: Sequence[Mapping[str, Any]], frames: Sequence[np.ndarray | None], scored: int,
) -> Markup:
    """
    Return the animation of a run as HTML; the page needs ``SCRIPT`` at its end.

    Parameters
    ----------
    lines, frames
        As :func:`lowsnr_eval.scoring.scene.read_scene` returns them; at least one frame came.
    scored
        Number of frames of the whole run.

    """
    pixels = np.concatenate([frame.ravel() for frame in frames if frame is not None])
    sizes = [0 if frame is None else frame.size for frame in frames]
    places = np.where(np.array(sizes) > 0, np.cumsum(sizes) - sizes, -1)
    data = json.dumps({
        'chains': sorted({name for line in lines for name in line['chains']}),
        'colours': {'truth': TRUTH, 'detection': DETECTION, 'track': TRACK},
        'pixels': base64.b64encode(stretch(pixels).tobytes()).decode(),
        'lines': [{**line, 'place': int(place)} for line, place in zip(lines, places)]})
    # No text of a run can end the element that holds it.
    return Markup(_HTML.format(
        last=len(lines) - 1, note=_note(lines, scored), truth=TRUTH, detection=DETECTION,
        track=TRACK, data=data.replace('<', '\\u003c')))


def _note(lines: Sequence[Mapping[str, Any]], scored: int) -> str:
    """Say what is not shown as it was."""
    notes = []
    if scored > len(lines):
        notes.append(f'Shown are the first {len(lines)} of {scored} frames.')
    if (step := max(line['step'] for line in lines)) > 1:
        notes.append(f'A pixel is the brightest of {step} x {step} cells.')
    return ' '.join(notes)
