// The live view of running observers: batches of estimates come in, the charts of the last ten seconds go on.
"use strict";
(() => {
  const WINDOW_S = 10, STALE_S = 2;
  const DRAW_MS = 100, SAY_MS = 250;  // between drawings; between numbers, which are to be read
  const SILENT_S = 3;             // of a status: they come each second
  const BACK_S = 0.5;             // of a clock that was set back
  const GAP_S = 0.05, GAP_STEPS = 10;  // a pause over which no line is drawn: in seconds and in estimates
  const LEVELS = ["ok", "warning", "error", "stale"];
  const state = document.getElementById("state"), place = document.getElementById("observers");
  const health = document.getElementById("health"), statuses = document.getElementById("statuses");
  const observers = new Map();  // by topic
  const known = new Map();      // statuses by name

  class LiveObserver {
    constructor(element, topic) {
      this.root = element;
      this.topic = topic;
      this.points = [];
      this.arrivals = [];
      this.step = Infinity;  // seconds between estimates
      this.plot = element.querySelector(".plot").interactivePlot;
      this.value = element.querySelector(".now");
    }

    // Times are seconds before the newest stamp; differences of nanosecond stamps need whole numbers (BigInt).
    add(batch) {
      const now = performance.now();
      this.zero ??= BigInt(batch.time_ns[0]);
      const times = batch.time_ns.map(stamp => Number(BigInt(stamp) - this.zero) * 1e-9), gap = this.findGap(times, batch.count);
      times.forEach((time, k) => {
        const newest = this.newest();
        if (time < newest - BACK_S) this.points = [];  // a bag that begins again
        else if (time <= newest) return;
        else if (time > newest + gap) this.points.push({time: newest, force: NaN, lower: NaN, upper: NaN, speed: NaN, position: NaN});
        this.points.push({time, force: batch.force[k], lower: batch.lower[k] ?? NaN, upper: batch.upper[k] ?? NaN,
          speed: batch.speed[k], position: 1000 * batch.position[k]});
      });
      const end = this.points[this.points.length - 1].time;
      this.points = this.points.filter(point => point.time >= end - WINDOW_S);
      this.arrivals.push([now, batch.count]);
      while (now - this.arrivals[0][0] > 2000) this.arrivals.shift();
      this.changed = true;
    }

    newest() { return this.points.length ? this.points[this.points.length - 1].time : -Infinity; }

    // What counts as a pause. The step is the smallest of late: a pause inside a batch is none.
    findGap(times, count) {
      const step = count > 1 ? (times[times.length - 1] - times[0]) / (count - 1) : times[0] - this.newest();
      if (step > 0) this.step = Math.min(step, 1.1 * this.step);
      return Math.max(GAP_S, GAP_STEPS * this.step);
    }

    draw() {
      if (!this.changed) return;
      this.changed = false;
      const points = this.points, end = points[points.length - 1].time, x = points.map(point => point.time - end);
      const column = key => points.map(point => point[key]);
      const [force, lower, upper, speed, position] = ["force", "lower", "upper", "speed", "position"].map(column);
      this.plot.replaceData([
        {y: findRange(force, lower, upper), marks: [{x, low: lower, high: upper}, {x, y: force}]},
        {y: findRange(speed), marks: [{x, y: speed}]},
        {y: findRange(position), marks: [{x, y: position}]},
      ], [-WINDOW_S, 0]);
    }

    describe(point) {
      const age = this.arrivals.length ? (performance.now() - this.arrivals[this.arrivals.length - 1][0]) / 1000 : Infinity;
      const span = (this.arrivals[this.arrivals.length - 1][0] - this.arrivals[0][0]) / 1000;
      const count = this.arrivals.slice(1).reduce((sum, [, n]) => sum + n, 0);
      const rate = span > 0.5 ? `, ${Math.round(count / span)} estimates a second` : "";
      const band = Number.isFinite(point.lower) ? ` (band ${Math.round(point.lower)} to ${Math.round(point.upper)} N)` : "";
      const text = age > STALE_S ? `no estimate for ${age.toFixed(0)} s` : `${Math.round(point.force)} N${band}${rate}`;
      this.value.textContent = text.replace(/-/g, "\u2212");
      this.value.classList.toggle("late", age > STALE_S);
    }
  }

  function findRange(...columns) {
    let low = Infinity, high = -Infinity;
    for (const value of columns.flat()) if (Number.isFinite(value)) { low = Math.min(low, value); high = Math.max(high, value); }
    if (!(low <= high)) return [-1, 1];
    const room = 0.06 * (high - low) || 1;
    return [low - room, high + room];
  }

  function showTopics(topics) {
    for (const {topic, chart} of topics) {
      if (observers.has(topic)) continue;
      const section = document.createElement("section"), heading = document.createElement("h2"), now = document.createElement("p");
      section.className = "block observer";
      heading.textContent = topic.replace(/\/estimate$/, "");
      now.className = "now";
      now.textContent = "no estimate yet";
      const figure = document.createElement("figure");
      figure.innerHTML = chart;
      section.append(heading, now, figure);
      place.append(section);
      globalThis.cesPlots.attachAll(figure);
      observers.set(topic, new LiveObserver(section, topic));
    }
    const count = topics.length;
    state.textContent = count ? `listening to the estimates of ${count} ${count === 1 ? "damper" : "dampers"}`
      : `listening; no observer publishes an estimate ${observers.size ? "now" : "yet"}`;
  }

  function showStatus(status) {
    known.set(status.name, {...status, heard: performance.now()});
    health.hidden = false;
    showStatuses();
  }

  function showStatuses() {
    const rows = [...known.values()].sort((a, b) => a.name.localeCompare(b.name)).map(one => {
      const age = (performance.now() - one.heard) / 1000, isSilent = age > SILENT_S;
      const level = isSilent ? "stale" : LEVELS[one.level] ?? "stale", block = document.createElement("details"), line = document.createElement("summary");
      const badge = document.createElement("span"), table = document.createElement("dl");
      badge.className = `level ${level}`;
      badge.textContent = level;
      line.append(badge, ` ${one.name}: ${isSilent ? `silent for ${age.toFixed(0)} s; before: ` : ""}${one.message}`);
      table.className = "facts small";
      for (const [key, value] of Object.entries(one.values)) {
        const row = document.createElement("div"), dt = document.createElement("dt"), dd = document.createElement("dd");
        dt.textContent = key;
        dd.textContent = value;
        row.append(dt, dd);
        table.append(row);
      }
      block.append(line, table);
      block.dataset.name = one.name;
      return block;
    });
    const open = new Set([...statuses.querySelectorAll("details[open]")].map(one => one.dataset.name));
    for (const row of rows) row.open = open.has(row.dataset.name);
    if (!statuses.contains(document.activeElement)) statuses.replaceChildren(...rows);
  }

  setInterval(() => {
    if (document.hidden) return;
    for (const observer of observers.values()) observer.draw();
  }, DRAW_MS);

  setInterval(() => {
    if (document.hidden) return;
    for (const observer of observers.values()) {
      if (observer.points.length) observer.describe(observer.points[observer.points.length - 1]);
    }
  }, SAY_MS);

  setInterval(() => { if (!document.hidden) showStatuses(); }, 1000);

  const isNarrow = matchMedia("(max-width: 560px)").matches;
  globalThis.cesServe.follow(state.dataset.listen + (isNarrow ? "?narrow" : ""), {
    topics: showTopics,
    observer: (message, stop) => {
      if (message.missing || message.ended) { stop(); state.textContent = message.missing || message.ended; }
      if (message.batch) observers.get(message.topic)?.add(message.batch);
      if (message.status) showStatus(message.status);
    },
  });
})();
