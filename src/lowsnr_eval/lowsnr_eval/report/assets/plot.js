/* SPDX-License-Identifier: Apache-2.0 */
// Axes on a canvas that is as wide as its place in the page.
const MARGIN = {left: 50, right: 12, top: 8, bottom: 38}, BAR = 58, INK = '#1b1b1b', MOST_TICKS = 100;

// Returns round numbers between two ends, about one for each ``every`` pixels of ``length``.
function ticks([low, high], length, every, whole = false) {
  const rough = (high - low) * every / Math.max(length, 1), power = 10 ** Math.floor(Math.log10(rough));
  const round = power * [1, 2, 5, 10].find(factor => factor * power >= rough);
  const step = whole ? Math.max(round, 1) : round, first = Math.ceil(low / step);
  const found = Math.floor((high + step * 1e-9) / step) - first + 1;
  return Array.from({length: Math.min(found, MOST_TICKS)}, (_, n) => (first + n) * step);
}

// Returns a number as short text.
function short(value) {
  return Math.abs(value) >= 1e4 || (value && Math.abs(value) < 1e-3)
    ? value.toExponential(1) : String(+value.toPrecision(4));
}

// Clears a canvas and draws axes; returns the pen, clipped to the axes, and the places of values.
// ``x`` and ``y`` are the values at left and right, and at bottom and top.  ``height`` is that of
// the axes [CSS pixels]; without one a unit is as long on both axes.  ``bar`` holds the values at
// the bottom, in the middle and at the top of a bar beside the axes, what they are, and the colours
// from bottom to top; ``rows`` are names in place of the values of y.
function plot(canvas, {x, y, labels, height, bar, rows}) {
  const ratio = window.devicePixelRatio || 1, width = canvas.parentElement.clientWidth;
  const left = MARGIN.left + (height ? 24 : 0), right = bar ? BAR : MARGIN.right;
  let across = Math.max(width - left - right, 10);
  if (!height) {
    const tall = Math.abs((y[1] - y[0]) / (x[1] - x[0]));
    across = Math.min(across, 640 / Math.min(tall, 1), 900);
    height = across * tall;
    if (height > 640) [across, height] = [640 / tall, 640];
  }
  canvas.width = width * ratio;
  canvas.height = (height + MARGIN.top + MARGIN.bottom) * ratio;
  canvas.style.height = `${height + MARGIN.top + MARGIN.bottom}px`;
  const pen = canvas.getContext('2d');
  pen.scale(ratio, ratio);
  pen.fillStyle = 'white';
  pen.fillRect(0, 0, width, height + MARGIN.top + MARGIN.bottom);
  const X = value => left + (value - x[0]) / (x[1] - x[0]) * across;
  const Y = value => MARGIN.top + (y[1] - value) / (y[1] - y[0]) * height;
  const made = {pen, X, Y, x, y, left, across, height, ratio,
                fromX: place => x[0] + (place - left) / across * (x[1] - x[0]),
                fromY: place => y[1] - (place - MARGIN.top) / height * (y[1] - y[0])};
  scales(made, labels, rows);
  if (bar) colourBar(made, bar);
  pen.beginPath();
  pen.rect(left, MARGIN.top, across, height);
  pen.clip();
  return made;
}

// Draws frame, ticks and labels.
function scales({pen, X, Y, x, y, left, across, height}, labels, rows) {
  pen.strokeStyle = pen.fillStyle = INK;
  pen.font = '12px sans-serif';
  pen.lineWidth = 1;
  pen.strokeRect(left, MARGIN.top, across, height);
  pen.beginPath();
  pen.textAlign = 'center';
  for (const value of ticks(x, across, 55, labels[0].startsWith('frame'))) {
    pen.moveTo(X(value), MARGIN.top + height);
    pen.lineTo(X(value), MARGIN.top + height + 4);
    pen.fillText(short(value), X(value), MARGIN.top + height + 16);
  }
  pen.fillText(labels[0], left + across / 2, MARGIN.top + height + 32);
  pen.textAlign = 'right';
  pen.textBaseline = 'middle';
  const [low, high] = y[0] < y[1] ? y : [y[1], y[0]];
  const marks = rows ? rows.map((name, n) => [n + .5, name])
    : ticks([low, high], height, 34).map(value => [value, short(value)]);
  for (const [value, text] of marks) {
    pen.moveTo(left, Y(value));
    pen.lineTo(left - 4, Y(value));
    pen.fillText(text.length > 9 ? `${text.slice(0, 8)}…` : text, left - 6, Y(value));
  }
  pen.stroke();
  pen.save();
  pen.translate(11, MARGIN.top + height / 2);
  pen.rotate(-Math.PI / 2);
  pen.textAlign = 'center';
  pen.fillText(labels[1], 0, 0);
  pen.restore();
}

// Returns a colour as CSS has it, of one as a picture has it.
const css = ink => `rgb(${ink & 255} ${ink >> 8 & 255} ${ink >> 16 & 255})`;

// Draws the bar of the colours beside the axes.
function colourBar({pen, left, across, height}, {values, name, inks}) {
  const from = left + across + 8, step = height / inks.length;
  inks.forEach((ink, n) => {
    pen.fillStyle = css(ink);
    pen.fillRect(from, MARGIN.top + height - (n + 1) * step, 10, step + .5);
  });
  pen.strokeRect(from, MARGIN.top, 10, height);
  pen.fillStyle = INK;
  pen.textAlign = 'left';
  values.forEach((value, n) => {
    const place = [height - 5, height / 2, 6][n];
    pen.fillText(short(+value.toPrecision(3)), from + 13, MARGIN.top + place);
  });
  pen.textAlign = 'right';
  pen.fillText(name, from + BAR - 8, MARGIN.top + height + 32);
}

// Draws a line through points [x, y]; null begins a new one.
function trace({pen, X, Y}, points, colour, width = 1.8, dash = []) {
  let on = false;
  pen.beginPath();
  for (const point of points) {
    if (point) pen[on ? 'lineTo' : 'moveTo'](X(point[0]), Y(point[1]));
    on = !!point;
  }
  pen.setLineDash(dash);
  pen.strokeStyle = colour;
  pen.lineWidth = width;
  pen.lineJoin = 'round';
  pen.stroke();
  pen.setLineDash([]);
}
