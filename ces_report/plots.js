// Charts to work with. Each figure of the page is a finished SVG beside its data (JSON); nothing is drawn here until the
// reader zooms, moves, hides a line or asks for values. Loads nothing, stores nothing, needs no library.
"use strict";
(() => {
  const MISSING16 = 65535, MISSING32 = 4294967295;
  const ZOOM = 1.25, MOVE = 0.2;  // factor of one step of zoom; share of the view of one step sideways
  const CLICK = 5;                // [px] below which a drag is a click
  const MAX_ZOOM = 1e6;
  const HELP = "Drag to zoom, double-click to reset.";
  const MORE = "Shift and drag: move. Click, then wheel: zoom. Keys: arrows read values, + and − zoom, Page Up and Page " +
    "Down move, Home and End go to the first and the last value, A shows all, 0 resets.";
  const plots = [];

  // ---- data -------------------------------------------------------------------------------------------------------

  function decode(code) {
    const out = new Float64Array(code.n);
    if (code.even) {
      const [start, step] = code.even;
      for (let i = 0; i < code.n; i++) out[i] = start === null ? NaN : start + i * step;
      return out;
    }
    const text = atob(code.data), bytes = new Uint8Array(text.length);
    for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
    const raw = new DataView(bytes.buffer), wide = code.bits === 32;
    for (let i = 0; i < code.n; i++) {
      const whole = wide ? raw.getUint32(4 * i, true) : raw.getUint16(2 * i, true);
      out[i] = whole === (wide ? MISSING32 : MISSING16) ? NaN : code.low + whole * code.unit;
    }
    return out;
  }

  function isRising(x) {
    for (let i = 1; i < x.length; i++) if (x[i] < x[i - 1]) return false;
    return true;
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
    const i = findIndex(x, value);
    if (i === 0) return 0;
    if (i === x.length) return i - 1;
    return value - x[i - 1] < x[i] - value ? i - 1 : i;
  }

  // The rising values of x at which the cursor of the keys stops: points, or the middles of bars.
  function findStops(mark) {
    if (mark.kind === "bars") return mark.x.slice(1).map((right, i) => (mark.x[i] + right) / 2);
    return mark.rising ? mark.x : Float64Array.from(mark.x).sort();
  }

  // ---- text -------------------------------------------------------------------------------------------------------

  const escapeText = text => text.replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;");
  const withMinus = text => text.replace(/-/g, "\u2212");

  function formatNumber(value) {
    if (!Number.isFinite(value)) return "–";
    const size = Math.abs(value);
    if (size !== 0 && (size < 1e-4 || size >= 1e7)) return withMinus(value.toExponential(3));
    const decimals = size === 0 ? 0 : Math.max(0, Math.min(8, 3 - Math.floor(Math.log10(size))));
    return withMinus(value.toFixed(decimals));
  }

  // "Force [N]" is the name Force and the unit N.
  function splitLabel(label) {
    const found = /^(.*?)\s*\[([^\]]*)\]/.exec(label);
    return found ? {name: found[1], unit: found[2]} : {name: label, unit: ""};
  }

  // Up to `count` round values inside low to high, with their labels.
  function findTicks(low, high, count) {
    const rough = (high - low) / count, decade = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].map(s => s * decade).find(s => s >= rough * (1 - 1e-9));
    const decimals = Math.max(0, Math.min(12, -Math.floor(Math.log10(step) + 1e-9))), out = [];
    for (let i = Math.ceil(low / step - 1e-9); i <= Math.floor(high / step + 1e-9); i++) {
      const text = (i * step).toFixed(decimals);
      out.push({value: i * step, text: withMinus(Number(text) === 0 ? text.replace("-", "") : text)});
    }
    return out;
  }

  // Ticks of an axis around zero: at 0, if its label fits, and at the largest round value on both sides.
  function findThreeTicks(high, height) {
    const decade = 10 ** Math.floor(Math.log10(high)), step = [5, 2, 1].map(s => s * decade).find(s => s <= high);
    const decimals = Math.max(0, -Math.floor(Math.log10(step) + 1e-9)), text = step.toFixed(decimals);
    const fits = height / 2 * step / high >= 17;
    return [{value: -step, text: withMinus("-" + text)}, {value: 0, text: fits ? "0" : ""}, {value: step, text}];
  }

  // ---- drawing ----------------------------------------------------------------------------------------------------

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

  // The samples of a rising x that the view touches, one more on each side.
  function findVisible(mark, view) {
    if (!mark.rising) return [0, mark.x.length];
    return [Math.max(0, findIndex(mark.x, view[0]) - 1), Math.min(mark.x.length, findIndex(mark.x, view[1]) + 1)];
  }

  // A polyline. With more than two points in a pixel column, the column's extremes are drawn, so no peak is lost.
  function linePath(mark, scale) {
    const [first, last] = findVisible(mark, scale.view), {x, y} = mark, out = [];
    let pen = "M";
    const add = (px, value) => { out.push(pen, at(px), ",", at(scale.py(value))); pen = "L"; };
    if (!mark.rising || last - first < 3 * scale.width) {
      for (let i = first; i < last; i++) {
        if (!Number.isFinite(y[i])) { pen = "M"; continue; }
        if (mark.breaks.has(i)) pen = "M";
        add(scale.px(x[i]), y[i]);
      }
      return out.join("");
    }
    let column = null, low = -1, high = -1;
    const close = () => {
      if (low >= 0) for (const i of low < high ? [low, high] : [high, low]) add(column + 0.5, y[i]);
      low = high = -1;
    };
    for (let i = first; i < last; i++) {
      const missing = !Number.isFinite(y[i]), here = Math.floor(scale.px(x[i]));
      if (missing || here !== column || mark.breaks.has(i)) close();
      column = here;
      if (missing || mark.breaks.has(i)) pen = "M";
      if (missing) continue;
      if (low < 0 || y[i] < y[low]) low = i;
      if (high < 0 || y[i] > y[high]) high = i;
    }
    close();
    return out.join("");
  }

  function dotsPath(mark, scale) {
    const out = [], {x, y} = mark;
    for (let i = 0; i < x.length; i++) {
      if (Number.isFinite(y[i]) && x[i] >= scale.view[0] && x[i] <= scale.view[1]) {
        out.push("M", at(scale.px(x[i])), ",", at(scale.py(y[i])), "h0");
      }
    }
    return out.join("");
  }

  // The area between two lines, in pieces without missing values; extremes in each pixel column.
  function bandPath(mark, scale) {
    const [first, last] = findVisible(mark, scale.view), out = [];
    let piece = [];
    const close = () => {
      if (piece.length) {
        const edge = (points, k) => points.map(p => at(p[0]) + "," + at(p[k]));
        out.push("M" + [...edge(piece, 1), ...edge([...piece].reverse(), 2)].join("L") + "Z");
      }
      piece = [];
    };
    for (let i = first; i < last; i++) {
      if (!Number.isFinite(mark.low[i] + mark.high[i])) { close(); continue; }
      const px = scale.px(mark.x[i]), top = scale.py(mark.high[i]), bottom = scale.py(mark.low[i]);
      const newest = piece[piece.length - 1];
      if (newest && px - newest[0] < 0.7) {
        newest[1] = Math.min(newest[1], top); newest[2] = Math.max(newest[2], bottom);
      } else piece.push([px, top, bottom]);
    }
    close();
    return out.join("");
  }

  const box = (css, left, top, right, bottom) =>
    `<rect class="${css}" x="${at(left)}" y="${at(top)}" width="${at(Math.max(right - left, 0))}" height="${at(Math.max(bottom - top, 0))}"/>`;

  function drawMark(mark, scale) {
    const css = escapeText(mark.css);
    if (mark.kind === "shade") {
      return mark.spans.map(([a, b]) => box(css, scale.px(a), scale.top, scale.px(b), scale.bottom)).join("");
    }
    if (mark.kind === "bars") {
      return Array.from(mark.y, (value, i) => Number.isFinite(value) && value !== 0
        ? box(css, scale.px(mark.x[i]), scale.py(Math.max(value, 0)), scale.px(mark.x[i + 1]), scale.py(Math.min(value, 0))) : "").join("");
    }
    const draw = {line: linePath, dots: dotsPath, band: bandPath}[mark.kind];
    return `<path class="${css}${mark.kind === "band" ? " area" : ""}" d="${draw(mark, scale)}"/>`;
  }

  function drawAxes(area, scale, xTicks) {
    const out = [], text = (css, x, y, what) => out.push(`<text class="${css}" x="${at(x)}" y="${at(y)}">${escapeText(what)}</text>`);
    const css = value => Math.abs(value) < 1e-12 ? "zero" : "grid";
    for (const tick of findTicks(scale.view[0], scale.view[1], xTicks)) {
      const x = scale.px(tick.value);
      out.push(`<path class="${css(tick.value)}" d="M${at(x)},${at(scale.top)}V${at(scale.bottom)}"/>`);
      if (area.xLabel) text("tick mid", x, scale.bottom + 19, tick.text);
    }
    const three = area.zero && !area.chosen;
    for (const tick of three ? findThreeTicks(scale.y[1], scale.height) : findTicks(scale.y[0], scale.y[1], area.yTicks)) {
      const y = scale.py(tick.value);
      out.push(`<path class="${css(tick.value)}" d="M${at(scale.left)},${at(y)}H${at(scale.right)}"/>`);
      text("tick end", scale.left - 7, y + 4, tick.text);
    }
    text("name", area.nameX, scale.top - 11, area.label);
    if (area.xLabel) text("name end", scale.right, scale.bottom + 36, area.xLabel);
    return out.join("");
  }

  // ---- one chart --------------------------------------------------------------------------------------------------

  class InteractivePlot {
    constructor(root) {
      this.root = root;
      this.svg = root.querySelector(":scope > svg");
      this.groups = [...this.svg.querySelectorAll(":scope > g.area")];
      this.group = root.dataset.group || null;
      this.hidden = new Set();
      this.cursor = null;
      this.data = null;
      this.addControls();
      this.listen();
      root.interactivePlot = this;
    }

    // New data for a figure that grows: for each area an object of y (its range) and marks, arrays for each mark. What the
    // reader has zoomed or hidden stays.
    replaceData(areas, full) {
      const data = this.load(), first = this.isFirstView();
      areas.forEach(({y, marks}, n) => {
        const area = data.areas[n];
        area.first = y;
        marks.forEach((arrays, m) => Object.assign(area.marks[m], arrays, {rising: isRising(arrays.x), stops: null}));
      });
      data.full = this.first = full;
      this.view = first ? full : this.limit(this.view);
      this.redraw();
    }

    // The data are decoded when they are needed first.
    load() {
      if (this.data) return this.data;
      const data = JSON.parse(this.root.querySelector(":scope > script").textContent);
      const arrays = data.arrays.map(decode);
      for (const area of data.areas) {
        for (const mark of area.marks) {
          for (const key of ["x", "y", "low", "high"]) if (key in mark) mark[key] = arrays[mark[key]];
          if (mark.x) mark.rising = isRising(mark.x);
          mark.breaks = new Set(mark.breaks || []);
        }
        area.first = area.y;
      }
      this.first = data.view;
      this.view = data.view;
      return this.data = data;
    }

    addControls() {
      const bar = document.createElement("div"), title = this.svg.querySelector("title").textContent;
      bar.className = "plot-controls";
      const actions = [["+", "Zoom in", () => this.zoom(1 / ZOOM ** 2)], ["−", "Zoom out", () => this.zoom(ZOOM ** 2)],
        ["All", "Show all data", () => this.showAll()], ["Reset", "Back to the first view", () => this.reset()],
        ["?", "How to use this chart", () => this.showHelp(`${HELP} ${MORE}`)]];
      for (const [text, label, act] of actions) {
        const button = document.createElement("button");
        Object.assign(button, {type: "button", textContent: text, title: label});
        button.setAttribute("aria-label", `${label}: ${title}`);
        button.addEventListener("click", act);
        bar.append(button);
      }
      this.root.prepend(bar);
      for (const entry of this.root.querySelectorAll(":scope > .plot-legend > li")) this.addToggle(entry);
      this.frame = document.createElement("div");
      this.frame.className = "plot-frame";
      Object.assign(this.frame, {tabIndex: 0});
      for (const [key, value] of [["role", "application"], ["aria-roledescription", "interactive chart"], ["aria-label", `${title}. ${HELP} ${MORE}`]]) {
        this.frame.setAttribute(key, value);
      }
      this.svg.replaceWith(this.frame);
      this.frame.append(this.svg);
      this.overlay = document.createElementNS("http://www.w3.org/2000/svg", "g");
      this.overlay.setAttribute("class", "plot-overlay");
      this.svg.append(this.overlay);
      this.readout = document.createElement("output");
      this.readout.className = "plot-readout";
      this.frame.after(this.readout);
      this.showHelp();
      this.root.classList.add("live");
    }

    addToggle(entry) {
      const button = document.createElement("button");
      button.type = "button";
      button.title = "Show or hide";
      button.setAttribute("aria-pressed", "true");
      button.append(...entry.childNodes);
      entry.append(button);
      button.addEventListener("click", () => {
        const name = entry.dataset.name, shown = this.hidden.delete(name);
        if (!shown) this.hidden.add(name);
        button.setAttribute("aria-pressed", String(shown));
        this.redraw();
      });
    }

    // ---- what is shown ----

    isVisible(mark) { return !this.hidden.has(mark.name); }

    isFirstView() {
      return this.view[0] === this.first[0] && this.view[1] === this.first[1];
    }

    // The range of y: chosen by the reader, as at first, or what is visible with some room.
    fitY(area, view) {
      if (area.chosen) return area.chosen;
      if (area.whole || area.fixed || this.data.free || this.isFirstView()) return area.first;
      let low = Infinity, high = -Infinity;
      for (const mark of area.marks) {
        if (mark.kind === "bars") return area.first;
        if (!mark.y || !this.isVisible(mark)) continue;
        const [first, last] = findVisible(mark, view);
        for (let i = first; i < last; i++) {
          if (mark.y[i] < low) low = mark.y[i];
          if (mark.y[i] > high) high = mark.y[i];
        }
      }
      if (!(low <= high)) return area.first;
      if (area.zero) { high = Math.max(Math.abs(low), Math.abs(high)); low = -high; }
      const room = 0.05 * (high - low) || Math.max(1e-9, 1e-3 * Math.abs(high));
      return [low - room, high + room];
    }

    scaleOf(area) {
      const view = area.whole ? this.data.full : this.view;
      return makeScale(area, view, this.fitY(area, view));
    }

    redraw() {
      const data = this.load();
      data.areas.forEach((area, n) => {
        const scale = area.scale = this.scaleOf(area);
        const marks = area.marks.filter(mark => this.isVisible(mark)).map(mark => drawMark(mark, scale));
        if (area.whole) marks.push(box("window", scale.px(this.view[0]), scale.top, scale.px(this.view[1]), scale.bottom));
        const clip = this.groups[n].querySelector(":scope > g[clip-path]").getAttribute("clip-path");
        this.groups[n].innerHTML = `${drawAxes(area, scale, data.xTicks)}<g clip-path="${clip}">${marks.join("")}</g>`;
      });
      this.drawCursor();
    }

    // Show a range of x (and of y in area number n) in this chart and all of its group.
    show(view, chosen = null) {
      this.load();
      const limited = this.limit(view);
      for (const plot of this.linked()) {
        plot.load();
        plot.view = limited;
        if (chosen && plot.data.areas[chosen.area]) plot.data.areas[chosen.area].chosen = chosen.y;
        plot.redraw();
      }
    }

    linked() { return this.group ? plots.filter(plot => plot.group === this.group) : [this]; }

    // The range within the data (of all linked charts), not too narrow.
    limit([low, high]) {
      const all = this.linked().map(plot => plot.load().full);
      const start = Math.min(...all.map(full => full[0])), stop = Math.max(...all.map(full => full[1]));
      const width = Math.min(Math.max(high - low, (stop - start) / MAX_ZOOM), stop - start);
      const middle = (low + high) / 2;
      const left = Math.min(Math.max(middle - width / 2, start), stop - width);
      return [left, left + width];
    }

    reset() {
      for (const plot of this.linked()) {
        plot.load();
        plot.view = plot.first;
        for (const area of plot.data.areas) area.chosen = null;
        plot.redraw();
      }
    }

    showAll() {
      this.load();
      for (const plot of this.linked()) for (const area of plot.load().areas) area.chosen = null;
      this.show(this.data.full);
    }

    // Zoom about x (and, with free axes, about y in an area).
    zoom(factor, x = null, area = null, y = null) {
      this.load();
      const [low, high] = this.view;
      if (x === null) x = this.cursor === null || this.cursor < low || this.cursor > high ? (low + high) / 2 : this.cursor;
      const view = [x - (x - low) * factor, x + (high - x) * factor];
      if (!this.data.free) return this.show(view);
      const areas = this.data.areas, n = area === null ? 0 : areas.indexOf(area), range = this.scaleOf(areas[n]).y;
      const about = y === null ? (range[0] + range[1]) / 2 : y;
      this.show(view, {area: n, y: range.map(end => about + (end - about) * factor)});
    }

    move(share) {
      this.load();
      const by = share * (this.view[1] - this.view[0]);
      this.show([this.view[0] + by, this.view[1] + by]);
    }

    // ---- reading values ----

    showHelp(text = HELP) { this.readout.textContent = text; this.readout.classList.add("idle"); }

    setCursor(x, nearest = null, spoken = false) {
      this.load();
      for (const plot of this.linked()) {
        plot.load();
        plot.cursor = x;
        plot.nearest = plot === this ? nearest : null;
        plot.spoken = spoken && plot === this;
        plot.drawCursor();
      }
    }

    clearCursor() { for (const plot of this.linked()) { plot.cursor = null; plot.nearest = null; if (plot.data) plot.drawCursor(); } }

    drawCursor() {
      this.overlay.replaceChildren();
      if (this.cursor === null) return this.showHelp();
      const found = this.data.free ? this.readNearest() : this.readLines();
      this.overlay.innerHTML = found.drawn.join("");
      this.readout.setAttribute("aria-live", this.spoken ? "polite" : "off");
      this.readout.textContent = found.texts.join("   ");
      this.readout.classList.remove("idle");
    }

    // All lines at the sample next to the cursor.
    readLines() {
      const {name, unit} = splitLabel(this.data.x), drawn = [], texts = [];
      let shownX = this.cursor;
      for (const area of this.data.areas) {
        const scale = area.scale || this.scaleOf(area);
        const label = splitLabel(area.label);
        for (const mark of area.marks) {
          if (!this.isVisible(mark) || mark.kind === "shade" || area.whole) continue;
          if (mark.kind === "band" && !mark.name) continue;
          const read = this.readMark(mark, this.cursor);
          if (!read) continue;
          if (mark.kind !== "bars") shownX = read.x;
          const same = label.name.toLowerCase().startsWith(mark.name.toLowerCase());
          texts.push(`${same ? label.name : mark.name || label.name} ${read.text}${label.unit && " " + label.unit}`);
          if (Number.isFinite(read.y)) drawn.push(this.spot(scale, read.x, read.y, mark.css));
        }
        if (this.cursor >= scale.view[0] && this.cursor <= scale.view[1]) {
          drawn.unshift(`<path class="plot-cursor" d="M${at(scale.px(this.cursor))},${at(scale.top)}V${at(scale.bottom)}"/>`);
        }
      }
      return {drawn, texts: [`${name} ${this.formatX(shownX)}${unit && " " + unit}`, ...texts]};
    }

    readMark(mark, x) {
      if (!mark.x.length || !mark.rising) return null;
      if (mark.kind === "bars") {
        const i = findIndex(mark.x, x) - 1;
        return i < 0 || i >= mark.y.length ? null : {x: (mark.x[i] + mark.x[i + 1]) / 2, y: mark.y[i], text: formatNumber(mark.y[i])};
      }
      const i = findNearest(mark.x, x), last = mark.x.length - 1;
      const room = last ? 0.51 * (mark.x[last] - mark.x[0]) / last : 0;
      if (x < mark.x[0] - room || x > mark.x[last] + room) return null;
      if (mark.kind !== "band") return {x: mark.x[i], y: mark.y[i], text: formatNumber(mark.y[i])};
      return {x: mark.x[i], y: NaN, text: `${formatNumber(mark.low[i])} to ${formatNumber(mark.high[i])}`};
    }

    // The point next to the pointer, or of a linked chart the points next to the same x.
    readNearest() {
      const point = this.nearest || this.findPoint(this.cursor);
      if (!point) return {drawn: [], texts: []};
      const {mark, i, area} = point, x = splitLabel(this.data.x), y = splitLabel(area.label);
      const texts = [`${x.name} ${formatNumber(mark.x[i])} ${x.unit}`, `${mark.name || y.name} ${formatNumber(mark.y[i])} ${y.unit}`];
      return {drawn: [this.spot(area.scale || this.scaleOf(area), mark.x[i], mark.y[i], mark.css)], texts};
    }

    // The point next to x, or to a pixel in one area.
    findPoint(x, area = null, py = 0) {
      let best = null, least = Infinity;
      for (const one of area ? [area] : this.data.areas) {
        const scale = this.scaleOf(one), px = scale.px(x);
        for (const mark of one.marks) {
          if (!mark.y || mark.kind === "bars" || !this.isVisible(mark)) continue;
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

    // As many decimals of x as a pixel can show.
    formatX(x) {
      const pixel = (this.view[1] - this.view[0]) / this.data.areas[0].box[2];
      return withMinus(x.toFixed(Math.max(0, Math.min(9, 1 - Math.floor(Math.log10(pixel))))));
    }

    // Move the cursor by samples of the first line; with `end` to the first or the last one in view.
    stepCursor(by, end = null) {
      this.load();
      const marks = this.data.areas.filter(area => !area.whole).flatMap(area => area.marks);
      const mark = marks.find(one => one.x && one.x.length && one.rising && this.isVisible(one)) || marks.find(one => one.x && one.x.length);
      if (!mark) return;
      const x = mark.stops = mark.stops || findStops(mark);
      const first = findIndex(x, this.view[0]), last = Math.max(first, findIndex(x, this.view[1]) - 1);
      if (end !== null) return this.setCursor(x[end < 0 ? first : last], null, true);
      const step = Math.sign(by) * Math.max(1, Math.round(Math.abs(by) * (last - first) / this.data.areas[0].box[2]));
      const from = this.cursor === null ? (first + last) >> 1 : findNearest(x, this.cursor);
      const next = x[Math.min(Math.max(from + (this.cursor === null ? 0 : step), 0), x.length - 1)];
      if (next < this.view[0] || next > this.view[1]) this.move(Math.sign(by) * MOVE);
      this.setCursor(next, null, true);
    }

    // ---- pointer and keys ----

    // A pointer's place in the figure's own pixels.
    place(event) {
      const point = new DOMPoint(event.clientX, event.clientY).matrixTransform(this.svg.getScreenCTM().inverse());
      return {x: point.x, y: point.y};
    }

    areaAt(place) {
      return this.data.areas.find(area => {
        const [left, top, width, height] = area.box;
        return place.x >= left - 4 && place.x <= left + width + 4 && place.y >= top - 4 && place.y <= top + height + 4;
      });
    }

    listen() {
      const frame = this.frame;
      frame.addEventListener("wheel", event => this.onWheel(event), {passive: false});
      frame.addEventListener("pointerdown", event => this.onDown(event));
      frame.addEventListener("pointermove", event => this.onMove(event));
      frame.addEventListener("pointerup", event => this.onUp(event));
      frame.addEventListener("pointercancel", event => { this.touches.delete(event.pointerId); this.endDrag(); });
      frame.addEventListener("pointerleave", () => { if (!this.drag) this.clearCursor(); });
      frame.addEventListener("dblclick", () => this.reset());
      frame.addEventListener("keydown", event => this.onKey(event));
      frame.addEventListener("blur", () => this.clearCursor());
      this.touches = new Map();
    }

    onWheel(event) {
      if (!event.ctrlKey && document.activeElement !== this.frame) return;  // the page scrolls
      this.load();
      const place = this.place(event), area = this.areaAt(place);
      if (!area || area.whole) return;
      event.preventDefault();
      const scale = this.scaleOf(area);
      this.zoom(event.deltaY > 0 ? ZOOM : 1 / ZOOM, scale.x(place.x), area, scale.value(place.y));
    }

    onDown(event) {
      if (event.button !== 0) return;
      this.load();
      const place = this.place(event), area = this.areaAt(place);
      if (!area) return;
      this.frame.setPointerCapture(event.pointerId);
      if (event.pointerType === "touch") this.touches.set(event.pointerId, place);
      const scale = this.scaleOf(area);
      const kind = area.whole ? "window" : event.shiftKey || event.pointerType === "touch" ? "move" : "box";
      this.drag = {kind, area, scale, start: place, view: this.view};
      if (this.touches.size === 2) this.drag = {kind: "pinch", area, scale, view: this.view, start: this.span()};
      if (kind === "window") this.centre(scale.x(place.x));
    }

    onMove(event) {
      this.load();
      const place = this.place(event), drag = this.drag;
      if (this.touches.has(event.pointerId)) this.touches.set(event.pointerId, place);
      if (!drag) return this.hover(place);
      if (drag.kind === "window") return this.centre(drag.scale.x(place.x));
      if (drag.kind === "box") return this.drawBox(place);
      if (drag.kind === "pinch") return this.pinch();
      const by = drag.scale.x(drag.start.x) - drag.scale.x(place.x);
      const up = drag.scale.value(drag.start.y) - drag.scale.value(place.y);
      const chosen = this.data.free ? {area: this.data.areas.indexOf(drag.area), y: drag.scale.y.map(end => end + up)} : null;
      if (Math.hypot(place.x - drag.start.x, place.y - drag.start.y) >= CLICK) this.show(drag.view.map(end => end + by), chosen);
    }

    onUp(event) {
      const drag = this.drag, place = drag && this.place(event);
      this.touches.delete(event.pointerId);
      this.endDrag();
      if (!drag) return;
      if (drag.kind === "box" && Math.abs(place.x - drag.start.x) >= CLICK) return this.zoomTo(drag, place);
      if (drag.kind !== "window") this.hover(place);
    }

    endDrag() { this.drag = null; this.overlay.replaceChildren(); if (this.data) this.drawCursor(); }

    hover(place) {
      const area = this.areaAt(place);
      if (!area || area.whole) return this.clearCursor();
      const x = this.scaleOf(area).x(place.x);
      this.setCursor(x, this.data.free ? this.findPoint(x, area, place.y) : null);
    }

    // The corners of the box between the start of a drag and a place: all heights unless both axes are free.
    corners(drag, place) {
      const {left, right, top, bottom} = drag.scale, inside = (value, low, high) => Math.min(Math.max(value, low), high);
      const x = [drag.start.x, inside(place.x, left, right)].sort((a, b) => a - b);
      const high = this.data.free && Math.abs(place.y - drag.start.y) >= CLICK;
      return {x, y: high ? [drag.start.y, inside(place.y, top, bottom)].sort((a, b) => a - b) : [top, bottom]};
    }

    drawBox(place) {
      const {x, y} = this.corners(this.drag, place);
      this.overlay.innerHTML = box("plot-box", x[0], y[0], x[1], y[1]);
    }

    zoomTo(drag, place) {
      const {x, y} = this.corners(drag, place), scale = drag.scale;
      const chosen = this.data.free ? {area: this.data.areas.indexOf(drag.area), y: [scale.value(y[1]), scale.value(y[0])]} : null;
      this.show(x.map(scale.x), chosen);
    }

    centre(x) {
      const half = (this.drag.view[1] - this.drag.view[0]) / 2;
      this.show([x - half, x + half]);
    }

    span() {
      const [a, b] = [...this.touches.values()];
      return {x: (a.x + b.x) / 2, apart: Math.max(Math.hypot(a.x - b.x, a.y - b.y), 10)};
    }

    pinch() {
      if (this.touches.size !== 2) return;
      const {start, scale, view} = this.drag, now = this.span(), x = scale.x(start.x), factor = start.apart / now.apart;
      const by = scale.x(start.x) - scale.x(now.x);
      this.show([x - (x - view[0]) * factor + by * factor, x + (view[1] - x) * factor + by * factor]);
    }

    onKey(event) {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      const steps = event.shiftKey ? 30 : 3;  // [px]
      const act = {
        ArrowLeft: () => this.stepCursor(-steps), ArrowRight: () => this.stepCursor(steps),
        Home: () => this.stepCursor(0, -1), End: () => this.stepCursor(0, 1),
        PageUp: () => this.move(-MOVE), PageDown: () => this.move(MOVE),
        "+": () => this.zoom(1 / ZOOM), "=": () => this.zoom(1 / ZOOM), "-": () => this.zoom(ZOOM), "−": () => this.zoom(ZOOM),
        a: () => this.showAll(), A: () => this.showAll(), 0: () => this.reset(), Escape: () => this.clearCursor(),
      }[event.key];
      if (!act) return;
      event.preventDefault();
      act();
    }
  }

  // ---- commands that can be copied ----------------------------------------------------------------------------------

  // Lines break between words, so an option is not torn at its hyphens.
  function keepWords(code) {
    const wrap = word => Object.assign(document.createElement("span"), {textContent: word});
    code.replaceChildren(...code.textContent.split(/(\s+)/).map(part => part.trim() ? wrap(part) : part));
  }

  function addCopyButton(block) {
    keepWords(block.querySelector("code"));
    const button = document.createElement("button");
    Object.assign(button, {type: "button", textContent: "Copy", className: "copy"});
    button.setAttribute("aria-label", "Copy the command");
    button.addEventListener("click", async () => {
      const code = block.querySelector("code");
      try {
        await navigator.clipboard.writeText(code.textContent);
        button.textContent = "Copied";
      } catch (refused) {  // not allowed for files in some browsers: the text is selected instead
        getSelection().selectAllChildren(code);
        button.textContent = "Selected";
      }
      setTimeout(() => { button.textContent = "Copy"; }, 2000);
    });
    block.append(button);
  }

  // Charts and commands in an element of the page, now or when it is added later.
  function attachAll(element) {
    for (const root of element.querySelectorAll(".plot:not(.live)")) plots.push(new InteractivePlot(root));
    for (const block of element.querySelectorAll(".command:not(:has(.copy))")) addCopyButton(block);
  }

  globalThis.cesPlots = {attachAll};
  attachAll(document);
})();
