// The page's own script: the chart asks for the window that it shows, what is chosen for its commands, a job for its lines.
const byId = id => document.getElementById(id), form = byId("desk"), chart = byId("chart");
const state = () => new URLSearchParams([...new FormData(form)].filter(([key, value]) => value && typeof value === "string"));
const colour = name => getComputedStyle(document.body).getPropertyValue(name).trim();
let whole = [0, 1], shown = 0;

async function refresh(...ids) {  // shows parts of the page as the server makes them now
  try {
    const answer = await fetch(`/?${state()}`), text = await answer.text();
    if (!answer.ok) throw new Error(text);
    for (const id of ids) byId(id).replaceWith(new DOMParser().parseFromString(text, "text/html").getElementById(id));
  } catch (error) { byId("note").textContent = `${error.message}: is ces serve still running?`; }
}

function choose() {
  history.replaceState(null, "", `/?${state()}`);
  refresh("commands");
}

function chosenRange() {
  if (!form.from.value && !form.to.value) return [];
  const [x0, x1] = [form.from.value || whole[0], form.to.value || whole[1]];
  return [{type: "rect", yref: "paper", x0, x1, y0: 0, y1: 1, fillcolor: colour("--link"), opacity: 0.16, layer: "below", line: {width: 0}}];
}

async function draw(from, to) {  // with as much again on both sides, so that moving shows no edge
  const number = ++shown, width = to - from, ask = new URLSearchParams({open: chart.dataset.open, pixels: 3 * chart.clientWidth});
  if (from !== undefined) { ask.set("from", from - width); ask.set("to", to + width); }
  const answer = await fetch(`/traces?${ask}`), found = answer.ok ? await answer.json() : {problem: await answer.text()};
  if (number !== shown) return;
  byId("note").textContent = found.problem ?? (found.reading ? `reading: ${found.reading}` : "");
  if (!found.traces) return found.reading && setTimeout(draw, 300, from, to);
  whole = found.whole;
  const count = found.traces.length, ink = colour("--ink"), grid = colour("--grid"), layout = {
    shapes: chosenRange(), selections: [], dragmode: chart.layout?.dragmode ?? "select", selectdirection: "h", showlegend: false,
    margin: {l: 76, r: 8, t: 8, b: 40}, paper_bgcolor: "transparent", plot_bgcolor: "transparent", font: {color: ink}, modebar: {bgcolor: "transparent", color: colour("--soft"), activecolor: ink},
    xaxis: {range: [from ?? whole[0], to ?? whole[1]], title: {text: "time [s]", standoff: 4}, gridcolor: grid, zeroline: false, anchor: count > 1 ? `y${count}` : "y"},
  };
  const data = found.traces.map((trace, k) => {
    const axis = k ? k + 1 : "", domain = [1 - (k + 0.92) / count, 1 - k / count], title = {text: `${trace.name} [${trace.unit}]`};
    layout[`yaxis${axis}`] = {domain, title, fixedrange: true, gridcolor: grid, zerolinecolor: colour("--zero")};
    return {x: trace.x, y: trace.y, yaxis: `y${axis}`, mode: "lines", line: {width: 1, color: colour(`--series-${k % 8}`)}, hoverinfo: "x+y"};
  });
  const isFirst = !chart.layout, buttons = ["select2d", "lasso2d", "autoScale2d", "toImage", "zoomIn2d", "zoomOut2d"];
  await Plotly.react(chart, data, layout, {scrollZoom: true, displaylogo: false, responsive: true, modeBarButtonsToRemove: buttons});
  if (!isFirst) return;
  chart.on("plotly_selected", event => event?.range && setRange(...event.range.x));
  chart.on("plotly_deselect", () => draw());  // a double click
  chart.on("plotly_relayout", event => {
    if (event["xaxis.autorange"]) draw();
    else if (Object.keys(event).some(key => key.startsWith("xaxis.range"))) draw(...chart.layout.xaxis.range);
  });
}

function setRange(from, to) {
  const [low, high] = [Math.max(0, from), Math.min(whole[1], to)], digits = high - low > 100 ? 1 : high - low > 1 ? 2 : 4;
  [form.from.value, form.to.value] = from === undefined ? ["", ""] : [low.toFixed(digits), high.toFixed(digits)];
  if (chart?.layout) Plotly.relayout(chart, {shapes: chosenRange(), selections: []});
  choose();
}

history.replaceState(null, "", `/?${state()}${location.hash}`);  // without the token
if (chart) draw();
form.addEventListener("input", ({target}) => {
  if (target.type === "file") return send(target.files);
  if (chart?.layout) Plotly.relayout(chart, {shapes: chosenRange()});
  choose();
});
byId("all").addEventListener("click", () => setRange());

async function send(files) {  // one after the other; the last is opened
  let name = "";
  for (const file of files) {
    byId("sending").textContent = `sending ${file.name}, ${(file.size / 1e6).toFixed(1)} MB …`;
    try {
      const answer = await fetch(`/upload?name=${encodeURIComponent(file.name)}`, {method: "POST", body: file});
      if (!answer.ok) throw new Error(await answer.text());
      ({name} = await answer.json());
    } catch (error) { byId("sending").textContent = `${file.name}: ${error.message}`; return; }
  }
  if (name) location.search = name.endsWith(".json") ? state() : new URLSearchParams({open: name, job: state().get("job") ?? ""});
}

for (const kind of ["dragover", "dragleave", "drop"]) document.addEventListener(kind, event => {
  event.preventDefault();
  document.querySelector(".drop").classList.toggle("over", kind === "dragover");
  if (kind === "drop") send(event.dataTransfer.files);
});

document.addEventListener("click", ({target}) => target.id === "copy" && navigator.clipboard.writeText(byId("command").textContent));
async function follow() {
  byId("lines")?.scrollTo(0, 1e6);
  if (byId("job")?.dataset.state !== "running") return;
  await new Promise(done => setTimeout(done, 1000));
  await refresh("commands", "lists", "job");
  follow();
}
follow();
