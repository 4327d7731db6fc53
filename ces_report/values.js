// Figures whose axes nothing is gained by zooming: maps, bars of regions, intervals. Each value of such a figure is an
// element with a <title>, which a browser without this script shows as a tooltip; here pointer, finger and arrow keys
// read the values.
"use strict";

(() => {
  const SIDES = 3;  // a step to the side counts so many times as much as one ahead, when the next value is looked for
  const STEPS = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1]};
  const HELP = "The arrow keys read the values; Home and End go to the first and the last one.";

  class ValueFigure {
    constructor(svg) {
      this.svg = svg;
      this.values = [...svg.querySelectorAll(".value")].map(element => this.take(element));
      this.chosen = null;
      this.frame = document.createElement("div");
      this.frame.className = "value-frame";
      this.frame.tabIndex = 0;
      const name = svg.querySelector("title").textContent, text = svg.querySelector("desc").textContent;
      for (const [key, value] of [["role", "application"], ["aria-roledescription", "chart with values"], ["aria-label", `${name}. ${text} ${HELP}`]]) {
        this.frame.setAttribute(key, value);
      }
      svg.replaceWith(this.frame);
      this.label = document.createElement("output");
      this.label.className = "value-label";
      this.frame.append(svg, this.label);
      this.listen();
    }

    // The text of a value; without its <title>, which would be a second label at the pointer.
    take(element) {
      const title = element.querySelector(":scope > title"), text = title.textContent;
      title.remove();
      return {element, text};
    }

    listen() {
      this.frame.addEventListener("pointermove", event => this.choose(this.find(event.target)));
      this.frame.addEventListener("pointerdown", event => this.choose(this.find(event.target)));
      this.frame.addEventListener("pointerleave", event => { if (event.pointerType !== "touch") this.choose(null); });
      this.frame.addEventListener("keydown", event => this.onKey(event));
      this.frame.addEventListener("blur", () => this.choose(null));
    }

    find(target) { return this.values.find(value => value.element.contains(target)) || null; }

    onKey(event) {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      const last = this.values.length - 1;
      const act = event.key in STEPS ? () => this.step(...STEPS[event.key])
        : {Home: () => this.values[0], End: () => this.values[last], Escape: () => null}[event.key];
      if (!act || !this.values.length) return;
      event.preventDefault();
      this.choose(act(), true);
    }

    // The next value in a direction: the nearest one ahead, where what lies aside counts as farther.
    step(right, down) {
      if (!this.chosen) return this.values[0];
      const centre = value => {
        const box = value.element.getBBox();
        return [box.x + box.width / 2, box.y + box.height / 2];
      };
      const [x, y] = centre(this.chosen);
      let best = this.chosen, least = Infinity;
      for (const value of this.values) {
        const [a, b] = centre(value), ahead = (a - x) * right + (b - y) * down;
        const apart = ahead + SIDES * Math.abs((a - x) * down + (b - y) * right);
        if (ahead > 0.5 && apart < least) { least = apart; best = value; }
      }
      return best;
    }

    choose(value, spoken = false) {
      if (value === this.chosen) return;
      if (this.chosen) this.chosen.element.classList.remove("chosen");
      this.chosen = value;
      this.label.setAttribute("aria-live", spoken ? "polite" : "off");
      this.label.textContent = value ? value.text : "";
      if (!value) return;
      value.element.classList.add("chosen");
      this.place(value.element.getBoundingClientRect());
    }

    // The label stands above its value, below where there is no room, and never outside the figure's sides.
    place(box) {
      const frame = this.frame.getBoundingClientRect(), label = this.label.getBoundingClientRect();
      const left = box.left - frame.left + box.width / 2 - label.width / 2, above = box.top - frame.top - label.height - 6;
      this.label.style.left = `${Math.max(0, Math.min(left, frame.width - label.width))}px`;
      this.label.style.top = `${above >= -frame.top ? above : box.bottom - frame.top + 6}px`;
    }
  }

  function attachAll(element) {
    for (const svg of element.querySelectorAll("svg.values")) if (!svg.closest(".value-frame")) new ValueFigure(svg);
  }

  globalThis.cesValues = {attachAll};
  attachAll(document);
})();
