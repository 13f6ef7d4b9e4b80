/* SPDX-License-Identifier: Apache-2.0 */
// Adds the frames that the server sends and numbers them; the page keeps the newest.
const MOST_LINES = 1000, MOST_CELLS = 2 ** 25;
let held = 0, shown = 0, awaited = false, patience = 1000, known = null;

// Returns how many cells a frame and its statistic have.
function size({greys, chains}) {
  return Object.values(chains).reduce((sum, {statistic}) => sum + (statistic?.levels.length || 0), greys.length);
}

function take(line) {
  const last = lines[lines.length - 1];
  if (last && line.stamp_s <= last.stamp_s) lines.length = held = shown = now = 0;
  line.frame = ++shown;
  line.greys = bytes(line.greys);
  for (const {statistic} of Object.values(line.chains)) {
    if (statistic) statistic.levels = bytes(statistic.levels);
  }
  held += size(line);
  lines.push(line);
  while (lines.length > MOST_LINES || held > MOST_CELLS) {
    held -= size(lines.shift());
    now = Math.max(now - 1, 0);
  }
  scene.asked[get('chain').value] = line.asked;
  if (following) now = lines.length - 1;
  if (awaited) return;
  awaited = true;
  requestAnimationFrame(() => { awaited = false; redraw(); });
}

// Another server, whose page says what it shows, may have taken the port meanwhile.
function meet(server) {
  if (known && known !== server) location.reload();
  known = server;
}

function connect() {
  const socket = new WebSocket(`ws://${location.host}/frames`);
  socket.onopen = () => {
    get('status').textContent = 'connected';
    patience = 1000;
  };
  socket.onmessage = event => {
    const message = JSON.parse(event.data);
    if (message.server) meet(message.server); else take(message);
  };
  socket.onclose = () => {
    get('status').textContent = 'not connected: the run has ended, or its viewer is away';
    setTimeout(connect, patience);
    patience = Math.min(2 * patience, 10000);
  };
}

get('play').textContent = 'pause';
connect();
