// Charts to work with. Each figure of the page is a finished SVG beside its data (JSON); nothing is drawn here until the
// reader zooms, moves, hides a line or asks for values. Loads nothing, stores nothing, needs no library.
"use strict";

const MISSING = {16: 65535, 32: 4294967295};  // by the bits of a packed value
const ZOOM = 1.25, MOVE = 0.2;  // factor of one step of zoom; share of the view of one step sideways
const CLICK = 5;                // [px] below which a drag is a click
const MAX_ZOOM = 1e6;
const HELP = "Drag to zoom, double-click to reset.";
const MORE = "Shift and drag: move. Click, then wheel: zoom. Keys: arrows read values, + and − zoom, Page Up and Page " +
  "Down move, Home and End go to the first and the last value, A shows all, 0 resets.";
const plots = [];

function decode(code) {
  const out = new Float64Array(code.n);
  if (code.even) {
    const [start, step] = code.even;
    return out.map((_, i) => start === null ? NaN : start + i * step);
  }
  const text = atob(code.data), bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  const whole = code.bits === 32 ? new Uint32Array(bytes.buffer) : new Uint16Array(bytes.buffer);
  return out.map((_, i) => whole[i] === MISSING[code.bits] ? NaN : code.low + whole[i] * code.unit);
}

// First index with x[i] >= value.
function findIndex(x, value) {
  let low = 0, high = x.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (x[middle] < value) low = middle + 1; else high = middle;
  }
  return low;
}

function findNearest(x, value) {
  const i = Math.min(findIndex(x, value), x.length - 1);
  return i > 0 && value - x[i - 1] < x[i] - value ? i - 1 : i;
}

// The samples of a rising x that the view touches, one more on each side.
function findVisible(mark, view) {
  if (!mark.rising) return [0, mark.x.length];
  return [Math.max(0, findIndex(mark.x, view[0]) - 1), Math.min(mark.x.length, findIndex(mark.x, view[1]) + 1)];
}

const limit = (value, low, high) => Math.min(Math.max(value, low), high);

const escapeText = text => text.replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;");
const withMinus = text => text.replace(/-/g, "\u2212");

function formatNumber(value) {
  if (!Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  if (size !== 0 && (size < 1e-4 || size >= 1e7)) return withMinus(value.toExponential(3));
  return withMinus(value.toFixed(size === 0 ? 0 : limit(3 - Math.floor(Math.log10(size)), 0, 8)));
}

// "Force [N]" is the name Force and the unit N, which follows a value after a space.
function splitLabel(label) {
  const [, name, unit] = /^(.*?)\s*\[([^\]]*)\]/.exec(label) || [null, label, ""];
  return {name, unit: unit && " " + unit};
}

const decimalsOf = step => limit(-Math.floor(Math.log10(step) + 1e-9), 0, 12);

// Up to `count` round values inside low to high, with their labels.
function findTicks(low, high, count) {
  const rough = (high - low) / count, decade = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map(s => s * decade).find(s => s >= rough * (1 - 1e-9)), out = [];
  for (let i = Math.ceil(low / step - 1e-9); i <= Math.floor(high / step + 1e-9); i++) {
    const text = (i * step).toFixed(decimalsOf(step));
    out.push({value: i * step, text: withMinus(Number(text) === 0 ? text.replace("-", "") : text)});
  }
  return out;
}

// Ticks of an axis around zero: at 0, if its label fits, and at the largest round value on both sides.
function findThreeTicks(high, height) {
  const decade = 10 ** Math.floor(Math.log10(high)), step = [5, 2, 1].map(s => s * decade).find(s => s <= high);
  const text = step.toFixed(decimalsOf(step)), zero = height / 2 * step / high >= 17 ? "0" : "";
  return [{value: -step, text: withMinus("-" + text)}, {value: 0, text: zero}, {value: step, text}];
}

// Pixels of an area, with the range of x and of y that it shows now.
function makeScale(area, view, y) {
  const [left, top, width, height] = area.box;
  return {
    left, top, width, height, right: left + width, bottom: top + height, view, y,
    px: value => left + width * (value - view[0]) / (view[1] - view[0]),
    py: value => top + height * (y[1] - value) / (y[1] - y[0]),
    x: pixel => view[0] + (pixel - left) / width * (view[1] - view[0]),
    value: pixel => y[1] - (pixel - top) / height * (y[1] - y[0]),
  };
}

const at = value => value.toFixed(1);

// A polyline. With more than two points in a pixel column, the column's extremes are drawn, so no peak is lost.
function linePath(mark, scale) {
  const [first, last] = findVisible(mark, scale.view), {x, y} = mark, out = [];
  const dense = mark.rising && last - first >= 3 * scale.width;
  let pen = "M", column = null, low = -1, high = -1;
  const add = (px, i) => { out.push(pen, at(px), ",", at(scale.py(y[i]))); pen = "L"; };
  const close = () => {
    if (low >= 0) for (const i of low < high ? [low, high] : [high, low]) add(column + 0.5, i);
    low = high = -1;
  };
  for (let i = first; i < last; i++) {
    const missing = !Number.isFinite(y[i]), ends = missing || mark.breaks.has(i), here = Math.floor(scale.px(x[i]));
    if (ends || here !== column) close();
    column = here;
    if (ends) pen = "M";
    if (!missing && !dense) add(scale.px(x[i]), i);
    if (missing || !dense) continue;
    if (low < 0 || y[i] < y[low]) low = i;
    if (high < 0 || y[i] > y[high]) high = i;
  }
  close();
  return out.join("");
}

function dotsPath({x, y}, {view, px, py}) {
  const out = [];
  x.forEach((value, i) => {
    if (Number.isFinite(y[i]) && value >= view[0] && value <= view[1]) out.push(`M${at(px(value))},${at(py(y[i]))}h0`);
  });
  return out.join("");
}

// The area between two lines, in pieces without missing values.
function bandPath(mark, {view, px, py}) {
  const [first, last] = findVisible(mark, view), pieces = [[]];
  for (let i = first; i < last; i++) {
    if (Number.isFinite(mark.low[i] + mark.high[i])) pieces.at(-1).push(i); else pieces.push([]);
  }
  const edge = (piece, y) => piece.map(i => `${at(px(mark.x[i]))},${at(py(y[i]))}`);
  const loop = piece => "M" + [...edge(piece, mark.high), ...edge(piece.reverse(), mark.low)].join("L") + "Z";
  return pieces.filter(piece => piece.length).map(loop).join("");
}

const box = (css, left, top, right, bottom) => `<rect class="${css}" x="${at(left)}" y="${at(top)}" ` +
  `width="${at(Math.max(right - left, 0))}" height="${at(Math.max(bottom - top, 0))}"/>`;

function drawMark(mark, scale) {
  const {px, py} = scale, css = escapeText(mark.css);
  if (mark.kind === "shade") return mark.spans.map(([a, b]) => box(css, px(a), scale.top, px(b), scale.bottom)).join("");
  const draw = {line: linePath, dots: dotsPath, band: bandPath}[mark.kind];
  return `<path class="${css}${mark.kind === "band" ? " area" : ""}" d="${draw(mark, scale)}"/>`;
}

function drawAxes(area, scale, xTicks) {
  const out = [], css = value => Math.abs(value) < 1e-12 ? "zero" : "grid";
  const text = (css, x, y, what) => out.push(`<text class="${css}" x="${at(x)}" y="${at(y)}">${escapeText(what)}</text>`);
  for (const tick of findTicks(...scale.view, xTicks)) {
    const x = scale.px(tick.value);
    out.push(`<path class="${css(tick.value)}" d="M${at(x)},${at(scale.top)}V${at(scale.bottom)}"/>`);
    if (area.xLabel) text("tick mid", x, scale.bottom + 19, tick.text);
  }
  const three = area.zero && !area.chosen;
  for (const tick of three ? findThreeTicks(scale.y[1], scale.height) : findTicks(...scale.y, area.yTicks)) {
    const y = scale.py(tick.value);
    out.push(`<path class="${css(tick.value)}" d="M${at(scale.left)},${at(y)}H${at(scale.right)}"/>`);
    text("tick end", scale.left - 7, y + 4, tick.text);
  }
  text("name", area.nameX, scale.top - 11, area.label);
  if (area.xLabel) text("name end", scale.right, scale.bottom + 36, area.xLabel);
  return out.join("");
}

function makeElement(tag, properties, attributes = {}) {
  const element = Object.assign(document.createElement(tag), properties);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  return element;
}

class InteractivePlot {
  constructor(root) {
    Object.assign(this, {root, group: root.dataset.group || null, hidden: new Set(), cursor: null, drag: null});
    this.svg = root.querySelector(":scope > svg");
    this.addControls();
    this.listen();
    root.interactivePlot = this;
  }

  // What the page has as JSON; decoded when it is needed first.
  get data() {
    if (this.decoded) return this.decoded;
    const data = JSON.parse(this.root.querySelector(":scope > script").textContent), arrays = data.arrays.map(decode);
    for (const mark of data.areas.flatMap(area => area.marks)) {
      for (const key of ["x", "y", "low", "high"]) if (key in mark) mark[key] = arrays[mark[key]];
      mark.rising = Boolean(mark.x) && mark.x.every((value, i) => !(value < mark.x[i - 1]));
      mark.breaks = new Set(mark.breaks || []);
    }
    this.view = data.view;
    return this.decoded = data;
  }

  addControls() {
    const title = this.svg.querySelector("title").textContent, bar = makeElement("div", {className: "plot-controls"});
    const actions = [["+", "Zoom in", () => this.zoom(1 / ZOOM ** 2)], ["−", "Zoom out", () => this.zoom(ZOOM ** 2)],
      ["All", "Show all data", () => this.showAll()], ["Reset", "Back to the first view", () => this.reset()],
      ["?", "How to use this chart", () => this.showHelp(`${HELP} ${MORE}`)]];
    for (const [text, label, act] of actions) {
      bar.append(makeElement("button", {type: "button", textContent: text, title: label, onclick: act}, {"aria-label": `${label}: ${title}`}));
    }
    this.root.prepend(bar);
    for (const entry of this.root.querySelectorAll(":scope > .plot-legend > li[data-name]")) {
      const button = makeElement("button", {type: "button", title: "Show or hide"}, {"aria-pressed": "true"});
      button.append(...entry.childNodes);
      entry.append(button);
      button.addEventListener("click", () => {
        const shown = this.hidden.delete(entry.dataset.name);
        if (!shown) this.hidden.add(entry.dataset.name);
        button.setAttribute("aria-pressed", String(shown));
        this.redraw();
      });
    }
    const name = {role: "application", "aria-roledescription": "interactive chart", "aria-label": `${title}. ${HELP} ${MORE}`};
    this.frame = makeElement("div", {className: "plot-frame", tabIndex: 0}, name);
    this.svg.replaceWith(this.frame);
    this.frame.append(this.svg);
    this.overlay = document.createElementNS("http://www.w3.org/2000/svg", "g");
    this.overlay.setAttribute("class", "plot-overlay");
    this.svg.append(this.overlay);
    this.readout = makeElement("output", {className: "plot-readout"}, {"aria-live": "polite"});
    this.frame.after(this.readout);
    this.showHelp();
    this.root.classList.add("live");
  }

  linked() { return this.group ? plots.filter(plot => plot.group === this.group) : [this]; }

  isVisible(mark) { return !this.hidden.has(mark.name) && !this.hidden.has(mark.group); }

  // The range of y: chosen by the reader, as at first, or what is visible with some room.
  fitY(area, view) {
    if (area.chosen) return area.chosen;
    const isFirst = view.every((end, i) => end === this.data.view[i]);
    if (area.whole || area.fixed || this.data.free || isFirst) return area.y;
    let low = Infinity, high = -Infinity;
    for (const mark of area.marks.filter(one => one.y && this.isVisible(one))) {
      for (const value of mark.y.subarray(...findVisible(mark, view))) {
        if (value < low) low = value;
        if (value > high) high = value;
      }
    }
    if (!(low <= high)) return area.y;
    if (area.zero) { high = Math.max(Math.abs(low), Math.abs(high)); low = -high; }
    const room = 0.05 * (high - low) || Math.max(1e-9, 1e-3 * Math.abs(high));
    return [low - room, high + room];
  }

  scaleOf(area) {
    const view = area.whole ? this.data.full : this.view;
    return makeScale(area, view, this.fitY(area, view));
  }

  redraw() {
    const groups = this.svg.querySelectorAll(":scope > g.area");
    this.data.areas.forEach((area, n) => {
      const scale = this.scaleOf(area), clip = groups[n].querySelector(":scope > g[clip-path]").getAttribute("clip-path");
      const marks = area.marks.filter(mark => this.isVisible(mark)).map(mark => drawMark(mark, scale));
      if (area.whole) marks.push(box("window", scale.px(this.view[0]), scale.top, scale.px(this.view[1]), scale.bottom));
      groups[n].innerHTML = `${drawAxes(area, scale, this.data.xTicks)}<g clip-path="${clip}">${marks.join("")}</g>`;
    });
    this.drawCursor();
  }

  // Show a range of x (and the `chosen` range of y in an area) in this chart and all of its group: within the data of
  // all of them, and not too narrow.
  show([low, high], chosen = null) {
    const all = this.linked().map(plot => plot.data.full);
    const start = Math.min(...all.map(full => full[0])), stop = Math.max(...all.map(full => full[1]));
    const width = limit(high - low, (stop - start) / MAX_ZOOM, stop - start);
    const left = limit((low + high) / 2 - width / 2, start, stop - width);
    for (const plot of this.linked()) {
      plot.view = [left, left + width];
      if (chosen && plot.data.areas[chosen.area]) plot.data.areas[chosen.area].chosen = chosen.y;
      plot.redraw();
    }
  }

  reset() {
    for (const plot of this.linked()) {
      for (const area of plot.data.areas) area.chosen = null;
      plot.view = plot.data.view;
      plot.redraw();
    }
  }

  showAll() {
    for (const area of this.linked().flatMap(plot => plot.data.areas)) area.chosen = null;
    this.show(this.data.full);
  }

  // Zoom about x (and, with free axes, about y in an area).
  zoom(factor, x = null, area = this.data.areas[0], y = null) {
    const {free, areas} = this.data, [low, high] = this.view;
    if (x === null) x = this.cursor === null || this.cursor < low || this.cursor > high ? (low + high) / 2 : this.cursor;
    const about = (value, ends) => ends.map(end => value + (end - value) * factor), range = this.scaleOf(area).y;
    this.show(about(x, [low, high]), free ? {area: areas.indexOf(area), y: about(y ?? (range[0] + range[1]) / 2, range)} : null);
  }

  move(share) {
    const [low, high] = this.data && this.view, by = share * (high - low);
    this.show([low + by, high + by]);
  }

  showHelp(text = HELP) { this.readout.textContent = text; this.readout.classList.add("idle"); }

  setCursor(x, nearest = null) {
    for (const plot of this.linked()) {
      Object.assign(plot, {cursor: x, nearest: plot === this ? nearest : null});
      if (x !== null || plot.decoded) plot.drawCursor();
    }
  }

  drawCursor() {
    this.overlay.replaceChildren();
    if (this.cursor === null) return this.showHelp();
    const {drawn, texts} = this.data.free ? this.readNearest() : this.readLines();
    this.overlay.innerHTML = drawn.join("");
    this.readout.textContent = texts.join("   ");
    this.readout.classList.remove("idle");
  }

  // All lines at the sample next to the cursor.
  readLines() {
    const {name, unit} = splitLabel(this.data.x), drawn = [], texts = [];
    let shownX = this.cursor;
    for (const area of this.data.areas) {
      const scale = this.scaleOf(area), label = splitLabel(area.label);
      for (const mark of area.marks) {
        const silent = mark.kind === "shade" || area.whole || (mark.kind === "band" && !mark.name);
        const read = silent || !this.isVisible(mark) ? null : this.readMark(mark, this.cursor);
        if (!read) continue;
        shownX = read.x;
        const same = label.name.toLowerCase().startsWith(mark.name.toLowerCase());
        texts.push(`${same ? label.name : mark.name} ${read.text}${label.unit}`);
        if (Number.isFinite(read.y)) drawn.push(this.spot(scale, read.x, read.y, mark.css));
      }
      if (this.cursor >= scale.view[0] && this.cursor <= scale.view[1]) {
        drawn.unshift(`<path class="plot-cursor" d="M${at(scale.px(this.cursor))},${at(scale.top)}V${at(scale.bottom)}"/>`);
      }
    }
    const pixel = (this.view[1] - this.view[0]) / this.data.areas[0].box[2];  // x has the decimals that it can show
    const x = withMinus(shownX.toFixed(limit(1 - Math.floor(Math.log10(pixel)), 0, 9)));
    return {drawn, texts: [`${name} ${x}${unit}`, ...texts]};
  }

  readMark({kind, x, y, low, high, rising}, here) {
    if (!x.length || !rising) return null;
    const i = findNearest(x, here), last = x.length - 1, room = last ? 0.51 * (x[last] - x[0]) / last : 0;
    if (here < x[0] - room || here > x[last] + room) return null;
    if (kind !== "band") return {x: x[i], y: y[i], text: formatNumber(y[i])};
    return {x: x[i], y: NaN, text: `${formatNumber(low[i])} to ${formatNumber(high[i])}`};
  }

  // The point next to the pointer, or of a linked chart the points next to the same x.
  readNearest() {
    const point = this.nearest || this.findPoint(this.cursor);
    if (!point) return {drawn: [], texts: []};
    const {mark, i, area} = point, x = splitLabel(this.data.x), y = splitLabel(area.label);
    const texts = [`${x.name} ${formatNumber(mark.x[i])}${x.unit}`, `${mark.name || y.name} ${formatNumber(mark.y[i])}${y.unit}`];
    return {drawn: [this.spot(this.scaleOf(area), mark.x[i], mark.y[i], mark.css)], texts};
  }

  // The point next to x, or to a pixel in one area.
  findPoint(x, area = null, py = 0) {
    let best = null, least = Infinity;
    for (const one of area ? [area] : this.data.areas) {
      const scale = this.scaleOf(one), px = scale.px(x);
      for (const mark of one.marks) {
        if (!mark.y || !this.isVisible(mark)) continue;
        for (let i = 0; i < mark.x.length; i++) {
          if (!(mark.y[i] >= scale.y[0] && mark.y[i] <= scale.y[1])) continue;
          const apart = (scale.px(mark.x[i]) - px) ** 2 + (area ? (scale.py(mark.y[i]) - py) ** 2 : 0);
          if (apart < least) { least = apart; best = {mark, i, area: one}; }
        }
      }
    }
    return best;
  }

  spot(scale, x, y, css) {
    const px = scale.px(x), py = scale.py(y);
    if (px < scale.left - 1 || px > scale.right + 1 || py < scale.top - 1 || py > scale.bottom + 1) return "";
    return `<path class="${escapeText(css.replace(/\b(dots|thin|area|spot|small)\b/g, ""))} plot-spot" d="M${at(px)},${at(py)}h0"/>`;
  }

  // Move the cursor by samples of the first line; with `end` to the first or the last one in view.
  stepCursor(by, end = null) {
    const marks = this.data.areas.filter(area => !area.whole).flatMap(area => area.marks).filter(mark => mark.x && mark.x.length);
    const mark = marks.find(one => one.rising && this.isVisible(one)) || marks[0];
    if (!mark) return;
    const x = mark.stops ??= mark.rising ? mark.x : Float64Array.from(mark.x).sort();
    const first = findIndex(x, this.view[0]), last = Math.max(first, findIndex(x, this.view[1]) - 1);
    if (end !== null) return this.setCursor(x[end < 0 ? first : last]);
    const step = Math.sign(by) * Math.max(1, Math.round(Math.abs(by) * (last - first) / this.data.areas[0].box[2]));
    const next = this.cursor === null ? (first + last) >> 1 : findNearest(x, this.cursor) + step;
    const value = x[limit(next, 0, x.length - 1)];
    if (value < this.view[0] || value > this.view[1]) this.move(Math.sign(by) * MOVE);
    this.setCursor(value);
  }

  // A pointer's place in the figure's own pixels, and the area there with its scale.
  place(event) {
    const {x, y} = new DOMPoint(event.clientX, event.clientY).matrixTransform(this.svg.getScreenCTM().inverse());
    const area = this.data.areas.find(({box: [left, top, width, height]}) =>
      x >= left - 4 && x <= left + width + 4 && y >= top - 4 && y <= top + height + 4);
    return {x, y, area, scale: area && this.scaleOf(area)};
  }

  listen() {
    const on = (kind, act, options) => this.frame.addEventListener(kind, act, options);
    on("wheel", event => {
      const {x, y, area, scale} = this.place(event);
      if (!event.ctrlKey && document.activeElement !== this.frame || !area || area.whole) return;  // the page scrolls
      event.preventDefault();
      this.zoom(event.deltaY > 0 ? ZOOM : 1 / ZOOM, scale.x(x), area, scale.value(y));
    }, {passive: false});
    on("pointerdown", event => this.onDown(event));
    on("pointermove", event => this.onMove(event));
    on("pointerup", event => this.onUp(event));
    on("pointercancel", () => this.endDrag());
    on("pointerleave", () => { if (!this.drag) this.setCursor(null); });
    on("dblclick", () => this.reset());
    on("keydown", event => this.onKey(event));
    on("blur", () => this.setCursor(null));
  }

  onDown(event) {
    const start = this.place(event), {area, scale} = start, touch = event.pointerType === "touch";
    if (event.button !== 0 || !area) return;
    this.frame.setPointerCapture(event.pointerId);
    const kind = area.whole ? "window" : event.shiftKey || touch ? "move" : "box";
    this.drag = {kind, area, scale, start, view: this.view};
    if (kind === "window") this.onMove(event);
  }

  onMove(event) {
    const now = this.place(event), drag = this.drag;
    if (!drag && (!now.area || now.area.whole)) return this.setCursor(null);
    if (!drag) return this.setCursor(now.scale.x(now.x), this.data.free ? this.findPoint(now.scale.x(now.x), now.area, now.y) : null);
    const {kind, scale, start, view} = drag, half = (view[1] - view[0]) / 2, centre = scale.x(now.x);
    if (kind === "window") this.show([centre - half, centre + half]);
    if (kind === "box") {
      const {x, y} = this.corners(now);
      this.overlay.innerHTML = box("plot-box", x[0], y[0], x[1], y[1]);
    }
    if (kind === "move" && Math.hypot(now.x - start.x, now.y - start.y) >= CLICK) {
      const by = scale.x(start.x) - centre, up = scale.value(start.y) - scale.value(now.y);
      this.show(view.map(end => end + by), this.choose(scale.y.map(end => end + up)));
    }
  }

  onUp(event) {
    if (!this.drag) return;
    const {kind, scale, start} = this.drag, now = this.place(event), {x, y} = this.corners(now);
    const chosen = this.choose([scale.value(y[1]), scale.value(y[0])]);
    this.endDrag();
    if (kind === "box" && Math.abs(now.x - start.x) >= CLICK) this.show(x.map(scale.x), chosen);
    else if (kind !== "window") this.onMove(event);
  }

  endDrag() {
    this.drag = null;
    this.drawCursor();
  }

  // A range of y for the area of the drag, if both axes are free.
  choose(y) { return this.data.free ? {area: this.data.areas.indexOf(this.drag.area), y} : null; }

  // The corners of the box between the start of a drag and a place: all heights unless both axes are free.
  corners(now) {
    const {scale: {left, right, top, bottom}, start} = this.drag, sorted = ends => ends.sort((a, b) => a - b);
    const high = this.data.free && Math.abs(now.y - start.y) >= CLICK;
    return {x: sorted([start.x, limit(now.x, left, right)]), y: high ? sorted([start.y, limit(now.y, top, bottom)]) : [top, bottom]};
  }

  onKey(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const steps = event.shiftKey ? 30 : 3;  // [px]
    const act = {
      ArrowLeft: () => this.stepCursor(-steps), ArrowRight: () => this.stepCursor(steps),
      Home: () => this.stepCursor(0, -1), End: () => this.stepCursor(0, 1),
      PageUp: () => this.move(-MOVE), PageDown: () => this.move(MOVE),
      "+": () => this.zoom(1 / ZOOM), "=": () => this.zoom(1 / ZOOM), "-": () => this.zoom(ZOOM), "−": () => this.zoom(ZOOM),
      a: () => this.showAll(), A: () => this.showAll(), 0: () => this.reset(), Escape: () => this.setCursor(null),
    }[event.key];
    if (!act) return;
    event.preventDefault();
    act();
  }
}

for (const root of document.querySelectorAll(".plot")) plots.push(new InteractivePlot(root));
// Lines of commands break between words, so an option is not torn at its hyphens.
for (const code of document.querySelectorAll(".command code")) {
  code.replaceChildren(...code.textContent.split(/(\s+)/).map(part => part.trim() ? makeElement("span", {textContent: part}) : part));
}
