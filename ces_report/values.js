// Figures whose axes nothing is gained by zooming: maps, bars of regions, intervals. Each value of such a figure is an
// element with a <title>, which a browser without this script shows as a tooltip; here pointer, finger and arrow keys
// read the values.

const SIDES = 3;  // a step to the side counts so many times as much as one ahead, when the next value is looked for
const STEPS = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1]};

function readValues(svg) {
  const name = svg.querySelector("title").textContent, text = svg.querySelector("desc").textContent;
  const help = "The arrow keys read the values; Home and End go to the first and the last one.";
  const frame = makeElement("div", {className: "value-frame", tabIndex: 0},
    {role: "application", "aria-roledescription": "chart with values", "aria-label": `${name}. ${text} ${help}`});
  const label = makeElement("output", {className: "value-label"}, {"aria-live": "polite"}), values = [...svg.querySelectorAll(".value")];
  const texts = new Map(values.map(value => [value, value.querySelector(":scope > title").textContent]));
  for (const value of values) value.querySelector(":scope > title").remove();  // a second label at the pointer
  svg.replaceWith(frame);
  frame.append(svg, label);
  let chosen = null;

  function choose(value) {
    if (value === chosen) return;
    if (chosen) chosen.classList.remove("chosen");
    chosen = value;
    label.textContent = value ? texts.get(value) : "";
    if (!value) return;
    value.classList.add("chosen");
    // The label stands above its value, below where there is no room, and never outside the figure's sides.
    const [box, around, own] = [value, frame, label].map(element => element.getBoundingClientRect());
    const left = box.left - around.left + box.width / 2 - own.width / 2, above = box.top - around.top - own.height - 6;
    label.style.left = `${Math.max(0, Math.min(left, around.width - own.width))}px`;
    label.style.top = `${above >= -around.top ? above : box.bottom - around.top + 6}px`;
  }

  // The next value in a direction: the nearest one ahead, where what lies aside counts as farther.
  function findNext(right, down) {
    const centre = value => (box => [box.x + box.width / 2, box.y + box.height / 2])(value.getBBox());
    const [x, y] = centre(chosen);
    let best = chosen, least = Infinity;
    for (const value of values) {
      const [a, b] = centre(value), ahead = (a - x) * right + (b - y) * down;
      const apart = ahead + SIDES * Math.abs((a - x) * down + (b - y) * right);
      if (ahead > 0.5 && apart < least) { least = apart; best = value; }
    }
    return best;
  }

  const point = event => choose(event.target.closest(".value"));
  frame.addEventListener("pointermove", point);
  frame.addEventListener("pointerdown", point);
  frame.addEventListener("pointerleave", event => { if (event.pointerType !== "touch") choose(null); });
  frame.addEventListener("blur", () => choose(null));
  frame.addEventListener("keydown", event => {
    const found = {Home: values[0], End: values.at(-1), Escape: null}[event.key];
    if (event.ctrlKey || event.metaKey || event.altKey || !values.length || !(event.key in STEPS || found !== undefined)) return;
    event.preventDefault();
    choose(found !== undefined ? found : chosen ? findNext(...STEPS[event.key]) : values[0]);
  });
}

for (const svg of document.querySelectorAll("svg.values")) readValues(svg);
