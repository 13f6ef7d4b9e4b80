const scene = JSON.parse(document.getElementById('scene').textContent);
const get = id => document.getElementById(id);
const greys = text => Uint8Array.from(atob(text), c => c.charCodeAt(0));
const frames = greys(scene.frames), cells = greys(scene.cells);
const small = document.createElement('canvas');
if (!cells.length) get('beside').remove();
let now = 0, timer = null, scale = 1, sized = scene.lines.find(line => line.shape);
for (const name of scene.chains) get('chain').add(new Option(name, name));

// Clears a view to the size of the frame; a missing frame has that of the one before it.
function clear(view) {
  const [rows, cols] = sized.shape, pen = view.getContext('2d');
  const zoom = Math.max(1, Math.round(700 / Math.max(rows, cols)));
  scale = zoom / sized.step;
  view.width = cols * zoom;
  view.height = rows * zoom;
  pen.fillStyle = 'white';
  pen.fillRect(0, 0, view.width, view.height);
  return pen;
}

// Draws greys; the edge of the first lies at a pixel of the frame, and each covers so many.
function paint(pen, greys, place, [rows, cols], [x, y], side) {
  small.width = cols;
  small.height = rows;
  const image = new ImageData(cols, rows);
  for (let n = 0; n < rows * cols; n++) {
    const grey = greys[place + n];
    image.data.set([grey, grey, grey, 255], 4 * n);
  }
  small.getContext('2d').putImageData(image, 0, 0);
  pen.imageSmoothingEnabled = false;
  pen.drawImage(small, (x + .5) * scale, (y + .5) * scale, cols * side * scale, rows * side * scale);
}

// Draws a mark at each point, on a dark edge; tracks get their number.
function mark(pen, points, colour, draw) {
  const r = Math.max(7, .6 * scale);
  for (const [x, y, id] of points) {
    const path = new Path2D(), [px, py] = [(x + .5) * scale, (y + .5) * scale];
    draw(path, px, py, r);
    for (const [ink, width] of [['black', 5], [colour, 2.5]]) {
      pen.strokeStyle = ink;
      pen.lineWidth = width;
      pen.stroke(path);
    }
    if (colour !== scene.colours.track) continue;
    pen.font = 'bold 15px sans-serif';
    pen.lineWidth = 4;
    pen.strokeStyle = 'black';
    pen.strokeText(id, px + r + 3, py - r);
    pen.fillStyle = colour;
    pen.fillText(id, px + r + 3, py - r);
  }
}

// Draws the marks of a line.
function annotate(pen, line, answer) {
  const {truth, detection, track} = scene.colours;
  mark(pen, line.truth, truth, (path, x, y, r) => path.arc(x, y, 1.5 * r, 0, 7));
  mark(pen, answer.detections, detection,
       (path, x, y, r) => path.rect(x - r, y - r, 2 * r, 2 * r));
  mark(pen, answer.tracks, track, (path, x, y, r) => {
    path.moveTo(x - r, y - r);
    path.lineTo(x + r, y + r);
    path.moveTo(x + r, y - r);
    path.lineTo(x - r, y + r);
  });
}

function show(k) {
  now = Math.min(Math.max(k, 0), scene.lines.length - 1);
  const line = scene.lines[now];
  const answer = line.chains[get('chain').value] || {detections: [], tracks: []};
  if (line.shape) sized = line;
  let pen = clear(get('view'));
  if (line.place >= 0) paint(pen, frames, line.place, line.shape, [-.5, -.5], line.step);
  annotate(pen, line, answer);
  if (get('cells')) {
    pen = clear(get('cells'));
    if (line.cells) {
      paint(pen, cells, line.cells_place, line.cells.shape, line.cells.corner, line.cells.side);
    }
    annotate(pen, line, answer);
  }
  get('slider').value = now;
  const count = (n, what) => `${n} ${what}${n === 1 ? '' : 's'}`;
  get('number').textContent = `frame ${line.frame}` +
    `${line.place < 0 ? ' (missing)' : ''}: ${count(line.truth.length, 'object')}, ` +
    `${count(answer.detections.length, 'detection')}, ${count(answer.tracks.length, 'track')}`;
}

function pause() {
  clearInterval(timer);
  timer = null;
  get('play').textContent = 'play';
}

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
