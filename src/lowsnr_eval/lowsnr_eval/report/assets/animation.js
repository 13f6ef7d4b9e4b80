/* SPDX-License-Identifier: Apache-2.0 */
const scene = JSON.parse(document.getElementById('scene').textContent);
const get = id => document.getElementById(id);
const bytes = text => Uint8Array.from(atob(text), c => c.charCodeAt(0));
const lines = scene.lines, small = document.createElement('canvas'), plots = {};
const {truth: TRUTH, detection: DETECTION, identities: COLOURS} = scene.colours;
const MOST_ROWS = 12, LEAST_CELLS = .25, GREY = '#bbb', NOTHING = {detections: [], tracks: []};
// Colours of levels: greys, and those of a statistic below and above its threshold, none black.
const GREYS = Uint32Array.from({length: 256}, (_, n) => 0xff000000 | n * 0x10101);
const LEVELS = Uint32Array.from({length: 256}, (_, n) => n < 128
  ? mix([20, 24, 48], [176, 186, 204], (n - 1) / 126) : mix([255, 228, 92], [190, 10, 20], (n - 128) / 127));
LEVELS[0] = 0xff000000;
const TIMES = ['existence', 'identities', 'alarms'];
let now = 0, timer = null, following = !!scene.live, sized = null, whole = null, part = null, owners = new Map();
for (const name of scene.chains) get('chain').add(new Option(name, name));
if (scene.chains.length < 2) get('chain').hidden = true;
{
  const frames = bytes(scene.frames), cells = bytes(scene.cells);
  for (const line of lines) {
    if (line.place >= 0) line.greys = frames.subarray(line.place);
    if (line.cells_place >= 0) line.cells.greys = cells.subarray(line.cells_place);
  }
  for (const [name, own] of Object.entries(scene.statistics || {})) {
    const levels = bytes(own.levels);
    lines.forEach((line, n) => {
      if (own.places[n] >= 0) Object.assign(line.chains[name].statistic, {
        levels: levels.subarray(own.places[n]), limits: own.limits});
    });
  }
}
get('beside').hidden = !scene.cells.length;

const answerOf = line => line.chains[get('chain').value] || NOTHING;
const list = items => items || [];
const count = (n, what) => `${n} ${what}${n === 1 ? '' : 's'}`;

// Returns the colour between two as a picture has it.
function mix(from, to, share) {
  const [r, g, b] = from.map((value, n) => Math.round(value + share * (to[n] - value)));
  return (0xff000000 | b << 16 | g << 8 | r) >>> 0;
}

// Returns the bar of the greys between two intensities.
function greyBar([low, high, name]) {
  return {values: [low, (low + high) / 2, high], name, inks: GREYS};
}

// Returns the colour of an identity: that of its place among those of the chain.
function colourOf(id) {
  const key = `${get('chain').value} ${id}`;
  if (!owners.has(key)) owners.set(key, owners.size);
  return COLOURS[owners.get(key) % COLOURS.length];
}

// Returns the edges of the frame that is shown; a missing one has those of another.
function extent(line) {
  if (line.shape) sized = line;
  sized = sized || lines.find(each => each.shape);
  const [rows, cols] = sized ? [sized.shape[0] * sized.step, sized.shape[1] * sized.step] : [1, 1];
  return {x: [-.5, cols - .5], y: [rows - .5, -.5]};
}

// Begins a picture of a part of the frame: axes in the unit of positions, from cells.
function begin(id, {x, y}, bar) {
  const {name, size} = scene.unit;
  const axes = plot(get(id), {x: x.map(v => v * size), y: y.map(v => v * size), bar,
                              labels: [`x [${name}]`, `y [${name}]`]});
  const [X, Y] = [axes.X, axes.Y];
  plots[id] = {...axes, X: v => X(v * size), Y: v => Y(v * size),
               fromX: p => axes.fromX(p) / size, fromY: p => axes.fromY(p) / size};
  return plots[id];
}

// Draws levels; the corner of the first lies at a pixel of the frame, and each covers so many.
function paint({pen, X, Y}, levels, [rows, cols], [x, y], side, inks = GREYS) {
  small.width = cols;
  small.height = rows;
  const image = new ImageData(cols, rows), ink = new Uint32Array(image.data.buffer);
  for (let n = 0; n < rows * cols; n++) ink[n] = inks[levels[n]];
  small.getContext('2d').putImageData(image, 0, 0);
  pen.imageSmoothingEnabled = false;
  pen.drawImage(small, X(x), Y(y), X(x + cols * side) - X(x), Y(y + rows * side) - Y(y));
}

// Draws a path on a dark edge, so that any grey shows it.
function stroke(pen, path, colour) {
  for (const [ink, width] of [['black', 4], [colour, 2]]) {
    pen.strokeStyle = ink;
    pen.lineWidth = width;
    pen.stroke(path);
  }
}

// Writes a name beside a point.
function tag(pen, text, x, y, colour) {
  pen.font = 'bold 13px sans-serif';
  pen.textAlign = 'left';
  pen.lineWidth = 3.5;
  pen.strokeStyle = 'black';
  pen.strokeText(text, x, y);
  pen.fillStyle = colour;
  pen.fillText(text, x, y);
}

// Adds the ellipse of a covariance [cells^2] around a point to a path.
function ellipse(path, {X, Y}, [x, y, , , xx, xy, yy]) {
  if (yy === undefined || xx === null) return;
  const mean = (xx + yy) / 2, half = Math.hypot((xx - yy) / 2, xy), turn = Math.atan2(2 * xy, xx - yy) / 2;
  const [a, b] = [mean + half, mean - half].map(v => scene.sigmas * Math.sqrt(Math.max(v, 0)));
  const scale = X(1) - X(0);
  path.moveTo(X(x + a * Math.cos(turn)), Y(y + a * Math.sin(turn)));
  path.ellipse(X(x), Y(y), Math.abs(a * scale), Math.abs(b * scale), turn, 0, 2 * Math.PI);
}

// Draws the marks of a frame over a picture of it.
function annotate(axes, line, answer) {
  const {pen, X, Y} = axes, r = Math.min(Math.max(6, .6 * (X(1) - X(0))), 14);
  for (const [x, y] of list(line.truth)) {
    const path = new Path2D();
    path.arc(X(x), Y(y), 1.5 * r, 0, 7);
    stroke(pen, path, TRUTH);
  }
  for (const [x, y] of list(answer.detections)) {
    const path = new Path2D();
    path.rect(X(x) - r, Y(y) - r, 2 * r, 2 * r);
    stroke(pen, path, DETECTION);
  }
  for (const track of list(answer.tracks)) {
    const [x, y, id] = track, path = new Path2D(), [px, py] = [X(x), Y(y)], h = .7 * r;
    path.moveTo(px - h, py - h);
    path.lineTo(px + h, py + h);
    path.moveTo(px + h, py - h);
    path.lineTo(px - h, py + h);
    ellipse(path, axes, track);
    stroke(pen, path, colourOf(id));
    tag(pen, id, px + r + 2, py - r, colourOf(id));
  }
}

// Returns the points of each id in a list of each line, with null where it is not in a line.
function paths(select, point) {
  const found = new Map();
  lines.forEach((line, n) => {
    for (const item of list(select(line))) {
      if (!found.has(item[2])) found.set(item[2], {points: [], last: n});
      const own = found.get(item[2]);
      if (n > own.last + 1) own.points.push(null);
      own.points.push(point(item, line));
      own.last = n;
    }
  });
  return found;
}

const place = ([x, y]) => [x, y];

// Returns the part of the frame in which points lie, in the form of the frame.
function around(points) {
  const [xs, ys] = [0, 1].map(n => points.map(point => point[n])), {x, y} = whole;
  const [wide, tall] = [x[1] - x[0], y[0] - y[1]];
  const least = values => values.reduce((a, b) => Math.min(a, b), Infinity);
  const most = values => values.reduce((a, b) => Math.max(a, b), -Infinity);
  const size = Math.min(1, 1.3 * Math.max(
    (most(xs) - least(xs)) / wide, (most(ys) - least(ys)) / tall, 10 / Math.max(wide, tall)));
  if (!points.length || size > .7) return whole;
  const [mx, my] = [(least(xs) + most(xs)) / 2, (least(ys) + most(ys)) / 2];
  return {x: [mx - size * wide / 2, mx + size * wide / 2],
          y: [my + size * tall / 2, my - size * tall / 2]};
}

function drawPlane() {
  const objects = [...paths(line => line.truth, place).values()];
  const tracks = [...paths(line => answerOf(line).tracks, place)];
  const points = [...objects, ...tracks.map(([, own]) => own)].flatMap(own => own.points);
  const axes = begin('plane', part || around(points.filter(Boolean)));
  for (const own of objects) trace(axes, own.points, TRUTH, 7);
  for (const line of lines) {
    for (const [x, y] of list(answerOf(line).detections)) {
      for (const [ink, r] of [['black', 3], [DETECTION, 2]]) {
        axes.pen.fillStyle = ink;
        axes.pen.fillRect(axes.X(x) - r, axes.Y(y) - r, 2 * r, 2 * r);
      }
    }
  }
  for (const [id, own] of tracks) {
    const [x, y] = own.points[own.points.length - 1];
    trace(axes, own.points, 'black', 3.5);
    trace(axes, own.points, colourOf(id), 2);
    tag(axes.pen, id, axes.X(x) + 5, axes.Y(y) - 5, colourOf(id));
  }
}

// Begins a diagram over the frames.
function overFrames(id, y, label, height, rows) {
  const [first, last] = [lines[0].frame, lines[lines.length - 1].frame];
  plots[id] = plot(get(id), {
    x: [first - .5, last + .5], y, height, rows, labels: [scene.live ? 'frames shown' : 'frame', label]});
  return plots[id];
}

function drawExistence() {
  const axes = overFrames('existence', [0, 1.02], 'existence', 130), {pen, X, height} = axes;
  pen.fillStyle = '#8882';
  for (const line of lines) {
    if (list(line.truth).length) {
      pen.fillRect(X(line.frame - .5), MARGIN.top, X(line.frame + .5) - X(line.frame - .5), height);
    }
  }
  const points = paths(line => list(answerOf(line).tracks).filter(track => track[3] != null),
                       (track, line) => [line.frame, track[3]]);
  for (const [id, own] of points) {
    trace(axes, own.points, colourOf(id));
    for (const point of own.points) {
      pen.fillStyle = colourOf(id);
      if (point) pen.fillRect(X(point[0]) - 1.5, axes.Y(point[1]) - 1.5, 3, 3);
    }
  }
}

// Returns the id of the track nearest to an object within the gate, undefined if there is none.
function nearest([x, y], tracks) {
  let least = scene.gate, found;
  for (const [tx, ty, id] of list(tracks)) {
    const distance = Math.hypot(tx - x, ty - y);
    if (distance <= least) [least, found] = [distance, id];
  }
  return found;
}

function drawIdentities() {
  const names = [...paths(line => line.truth, place).keys()].slice(0, MOST_ROWS);
  get('whose').hidden = !names.length;
  if (!names.length) return;
  const axes = overFrames('identities', [names.length, 0], '', 22 * names.length, names);
  const {pen, X, Y} = axes, begins = names.map(() => []);
  for (const line of lines) {
    for (const object of list(line.truth)) {
      const row = names.indexOf(object[2]), id = nearest(object, answerOf(line).tracks);
      if (row < 0) continue;
      const left = X(line.frame - .5);
      pen.fillStyle = id === undefined ? GREY : colourOf(id);
      pen.fillRect(left, Y(row) + 4, X(line.frame + .5) - left + .5, 14);
      if (id !== undefined && id !== begins[row].at(-1)?.[1]) begins[row].push([left, id]);
    }
  }
  begins.forEach((own, row) => nameIdentities(axes, own, Y(row) + 1));
}

// Marks where the identities of an object begin, [place, id], and writes those that have room.
function nameIdentities({pen}, begins, top) {
  pen.textAlign = 'left';
  pen.strokeStyle = 'white';
  pen.lineWidth = 3;
  pen.fillStyle = INK;
  begins.forEach(([left, id], n) => {
    pen.fillRect(left - 1, top, 2, 20);
    if (left + pen.measureText(id).width + 6 > (begins[n + 1] || [Infinity])[0]) return;
    pen.strokeText(id, left + 4, top + 10);
    pen.fillText(id, left + 4, top + 10);
  });
}

// Returns the interval of Wilson with 95 % for a share.
function wilson(hits, n) {
  const p = hits / n, z2 = 3.8415 / n;
  const half = Math.sqrt(z2 * p * (1 - p) + z2 * z2 / 4);
  return [(p + z2 / 2 - half) / (1 + z2), (p + z2 / 2 + half) / (1 + z2)];
}

function drawAlarms() {
  const asked = scene.asked[get('chain').value], rates = [], measured = [];
  let empty = 0, alarms = 0;
  for (const line of lines) {
    const answer = answerOf(line);
    if (line.truth && !line.truth.length && answer.detections) {
      empty += 1;
      alarms += answer.detections.length > 0;
      rates.push([line.frame, alarms / empty, ...wilson(alarms, empty)]);
    }
    if (answer.measured != null) measured.push([line.frame, answer.measured]);
  }
  get('rates').hidden = !rates.length && !measured.length;
  if (get('rates').hidden) return;
  const last = rates[rates.length - 1] || [0, 0, 0, 0];
  const top = Math.min(1, 1.2 * Math.max(
    last[3], 2 * (asked || 0), .001, ...measured.map(point => point[1])));
  const axes = overFrames('alarms', [0, top], 'false-alarm rate', 130);
  trace(axes, [...rates.map(([k, , low]) => [k, low]),
               ...rates.map(([k, , , high]) => [k, high]).reverse()], 'transparent');
  axes.pen.fillStyle = '#0072b233';
  axes.pen.fill();
  trace(axes, rates, '#0072B2');
  trace(axes, measured, '#D55E00', 1.8, [2, 3]);
  if (asked != null) trace(axes, [[axes.x[0], asked], [axes.x[1], asked]], INK, 1.2, [6, 4]);
  get('asked').textContent = [
    asked != null && `asked ${short(asked)} (dashed)`,
    rates.length && `share of the ${empty} frames without object, those after its end included, that hold a detection, so far: ` +
      `${short(alarms / empty)}, 95 % interval ${last[2].toFixed(3)} to ${last[3].toFixed(3)} (line)`,
    measured.length && `as the detector measures it: ${short(measured[measured.length - 1][1])} ` +
      '(dotted)'].filter(Boolean).join('; ');
}

function drawFrame(line, answer) {
  let axes = begin('view', part || whole, greyBar(line.values || scene.values.frames));
  if (line.greys) paint(axes, line.greys, line.shape, [-.5, -.5], line.step);
  annotate(axes, line, answer);
  drawStatistic(line, answer);
  if (get('beside').hidden) return;
  axes = begin('cells', part || whole, greyBar(scene.values.cells));
  if (line.cells && line.cells.greys) {
    paint(axes, line.cells.greys, line.cells.shape, line.cells.corner, line.cells.side);
  }
  annotate(axes, line, answer);
}

// Draws the statistic of the chain, if it publishes one; the marks of tracks would hide it.
function drawStatistic(line, answer) {
  get('tested').hidden = !lines.some(each => answerOf(each).statistic);
  if (get('tested').hidden) return;
  const {levels, limits: [low, high] = [-1, 1], shape, corner, side} = answer.statistic || {};
  const bar = {values: [low, 0, high], name: 'nat', inks: LEVELS.subarray(1)};
  const axes = begin('statistic', part || whole, bar);
  if (levels) paint(axes, levels, shape, corner, side, LEVELS);
  annotate(axes, line, {detections: answer.detections});
}

// Puts a line at the frame that is shown into each diagram over the frames.
function drawCursors() {
  for (const id of TIMES) {
    const axes = plots[id], figure = get(id).parentElement;
    if (!axes || figure.hidden) continue;
    const cursor = figure.querySelector('.cursor') ||
      figure.insertBefore(Object.assign(document.createElement('div'), {className: 'cursor'}),
                          figure.firstChild);
    cursor.style.left = `${axes.X(lines[now].frame)}px`;
    cursor.style.height = `${axes.height}px`;
  }
}

// Shows a frame.
function show(k) {
  if (!lines.length) return;
  now = Math.min(Math.max(k, 0), lines.length - 1);
  const line = lines[now], answer = answerOf(line), before = JSON.stringify(whole);
  whole = extent(line);
  if (before !== JSON.stringify(whole)) part = null;
  drawFrame(line, answer);
  drawCursors();
  get('slider').value = now;
  const objects = line.truth ? count(line.truth.length, 'object') : 'truth unknown';
  const name = scene.live
    ? `frame ${line.frame} shown, stamp ${line.stamp_s.toFixed(3)} s`
    : `frame ${line.frame}`;
  get('number').textContent = `${name}${line.greys ? '' : ' (missing)'}: ${objects}, ` +
    `${count(list(answer.detections).length, 'detection')}, ${count(list(answer.tracks).length, 'track')}`;
}

// Draws all again: the chain, the zoom, the width of the page or the frames have changed.
function redraw() {
  if (!lines.length) return;
  get('slider').max = lines.length - 1;
  show(now);
  drawPlane();
  drawExistence();
  drawIdentities();
  drawAlarms();
  drawCursors();
}

// Returns the frame to open on: one with an object that is tracked, or as much of that as there is.
function opening() {
  const near = (line, items) => list(line.truth).some(object => nearest(object, items) !== undefined);
  const wanted = [
    line => near(line, answerOf(line).tracks), line => near(line, answerOf(line).detections),
    line => list(line.truth).length, line => list(answerOf(line).tracks).length,
    line => list(answerOf(line).detections).length].map(has => lines.findIndex(has));
  return Math.max(wanted.find(k => k >= 0) ?? 0, 0);
}

function pause() {
  clearInterval(timer);
  timer = null;
  following = false;
  get('play').textContent = scene.live ? 'live' : 'play';
}

function play() {
  if (timer || following) return pause();
  get('play').textContent = 'pause';
  if (scene.live) {
    following = true;
    return show(lines.length - 1);
  }
  timer = setInterval(() => show((now + 1) % lines.length), 200);
}

function go(k) {
  pause();
  show(k);
}

// Shows 1 / factor of what is shown, around a point of the frame: at most all, and at least
// LEAST_CELLS a side.
function zoom(factor, at) {
  const {x, y} = part || whole, [mx, my] = at || [(x[0] + x[1]) / 2, (y[0] + y[1]) / 2];
  const nearer = ([a, b], m) => [m - (m - a) / factor, m + (b - m) / factor];
  const next = {x: nearer(x, mx), y: nearer(y, my)};
  if (factor > 1 && Math.min(next.x[1] - next.x[0], next.y[0] - next.y[1]) < LEAST_CELLS) return;
  part = next.x[1] - next.x[0] >= whole.x[1] - whole.x[0] ? null : next;
  redraw();
}

// Moves what is shown by a part of its size.
function move(across, down) {
  if (!part) return;
  const shift = ([a, b], by) => [a + by * Math.abs(b - a), b + by * Math.abs(b - a)];
  part = {x: shift(part.x, across), y: shift(part.y, down)};
  redraw();
}

// Returns the distance between two fingers [CSS pixels], and the place between them.
function spread(fingers) {
  const [a, b] = fingers.values();
  return Math.max(Math.hypot(a.offsetX - b.offsetX, a.offsetY - b.offsetY), 1);
}

function middle(fingers) {
  const [a, b] = fingers.values();
  return {offsetX: (a.offsetX + b.offsetX) / 2, offsetY: (a.offsetY + b.offsetY) / 2};
}

const STEPS = {ArrowLeft: () => now - 1, ArrowRight: () => now + 1, Home: () => 0,
               End: () => lines.length - 1, PageUp: () => now - 10, PageDown: () => now + 10};
const MOVES = {ArrowLeft: [-.2, 0], ArrowRight: [.2, 0], ArrowUp: [0, -.2], ArrowDown: [0, .2]};
const ZOOMS = {'+': 1.5, '=': 1.5, '-': 1 / 1.5, '0': 0};

function onKey(event) {
  const {key, target, shiftKey} = event;
  if (event.ctrlKey || event.altKey || event.metaKey) return;
  if (['INPUT', 'SELECT'].includes(target.tagName) && !(key in ZOOMS)) return;
  if (key === ' ' && ['BUTTON', 'SUMMARY'].includes(target.tagName)) return;
  if (shiftKey && key in MOVES && part) move(...MOVES[key]);
  else if (!shiftKey && key in STEPS) go(STEPS[key]());
  else if (key in ZOOMS) zoom(ZOOMS[key]);
  else if (key === ' ') play();
  else return;
  event.preventDefault();
}

get('back').onclick = () => go(now - 1);
get('forward').onclick = () => go(now + 1);
get('play').onclick = () => play();
get('closer').onclick = () => zoom(1.5);
get('wider').onclick = () => zoom(1 / 1.5);
get('whole').onclick = () => zoom(0);
get('slider').oninput = event => go(+event.target.value);
get('chain').onchange = redraw;
document.addEventListener('keydown', onKey);
for (const id of TIMES) {
  get(id).onclick = event => {
    const frame = plots[id].fromX(event.offsetX);
    go(lines.findLastIndex(line => line.frame - .5 <= frame));
  };
}
for (const id of ['view', 'cells', 'statistic', 'plane']) {
  const canvas = get(id);
  const at = event => [plots[id].fromX(event.offsetX), plots[id].fromY(event.offsetY)];
  canvas.ondblclick = event => zoom(2, at(event));
  canvas.addEventListener('wheel', event => {  // a pinch on a touchpad is a wheel with Ctrl
    if (!event.ctrlKey) return;
    event.preventDefault();
    zoom(1.01 ** -event.deltaY, at(event));
  }, {passive: false});
  const fingers = new Map();
  canvas.onpointerdown = event => {
    if (event.pointerType === 'touch') fingers.set(event.pointerId, event);
  };
  canvas.onpointerup = canvas.onpointercancel = event => fingers.delete(event.pointerId);
  canvas.onpointermove = event => {
    if (fingers.size > 1 && fingers.has(event.pointerId)) {
      const before = spread(fingers);
      fingers.set(event.pointerId, event);
      return zoom(spread(fingers) / before, at(middle(fingers)));
    }
    if (!event.buttons || !part) return;
    move(-event.movementX / plots[id].across, -event.movementY / plots[id].height);
  };
}
window.addEventListener('resize', redraw);
if (lines.length) {
  now = opening();
  redraw();
}
