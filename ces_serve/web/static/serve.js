// What the pages do: filter while typing, keys, choosing models, work that arrives as events, and views that follow.
"use strict";
(() => {
  const DELAY_MS = 120;           // of the filter after a key
  const chosen = new Set();       // models chosen on this page, also those that the filter hides

  // ---- events of the server; none while the page is hidden, so that tabs do not hold connections -------------------

  function follow(url, handlers, {once = false} = {}) {
    let source = null;
    const close = () => { if (source) source.close(); source = null; };
    const open = () => {
      if (source) return;
      source = new EventSource(url);
      for (const [name, act] of Object.entries(handlers)) {
        source.addEventListener(name, event => act(JSON.parse(event.data), stop));
      }
      if (once) source.onerror = () => { if (source && source.readyState === EventSource.CLOSED) handlers.failed?.("the server refused", stop); };
    };
    const change = () => { if (document.hidden && !once) close(); else open(); };
    const stop = () => { document.removeEventListener("visibilitychange", change); close(); };
    document.addEventListener("visibilitychange", change);
    addEventListener("pagehide", close);
    addEventListener("pageshow", event => { if (event.persisted && !once) change(); });
    change();
    return stop;
  }

  // Replaces what an element holds; open details and the keyboard's place in charts are kept by their order.
  function fill(element, html) {
    const open = [...element.querySelectorAll("details")].map(one => one.open);
    element.innerHTML = html;
    element.querySelectorAll("details").forEach((one, n) => { one.open = Boolean(open[n]); });
    globalThis.cesPlots?.attachAll(element);
    globalThis.cesValues?.attachAll(element);
    restoreChoice(element);
  }

  // ---- lists --------------------------------------------------------------------------------------------------------

  const input = document.getElementById("filter"), results = document.getElementById("results");
  let newest = 0;

  async function load(url, {keep = true} = {}) {
    const number = ++newest;
    const answer = await fetch(url, {headers: {Accept: "text/html"}}).catch(() => null);
    if (!answer || !answer.ok || number !== newest) return;
    const page = new DOMParser().parseFromString(await answer.text(), "text/html");
    if (number !== newest) return;
    const focused = results.contains(document.activeElement) ? document.activeElement.getAttribute("href") : null;
    const fresh = page.getElementById("results");
    results.innerHTML = fresh.innerHTML;
    results.dataset.state = fresh.dataset.state;
    document.querySelector(".topbar nav").innerHTML = page.querySelector(".topbar nav").innerHTML;
    restoreChoice(results);
    if (focused) results.querySelector(`a[href="${CSS.escape(focused)}"]`)?.focus();
    if (keep) history.replaceState(null, "", url);
  }

  function filterUrl() {
    const url = new URL(location.href);
    url.searchParams.delete("page");
    if (input.value) url.searchParams.set("q", input.value); else url.searchParams.delete("q");
    return url.pathname + url.search;
  }

  if (input && results) {
    let timer = 0;
    input.addEventListener("input", () => { clearTimeout(timer); timer = setTimeout(() => load(filterUrl()), DELAY_MS); });
    input.form.addEventListener("submit", event => { event.preventDefault(); load(filterUrl()); });
    follow(results.dataset.watch, {
      listed: state => { if (state !== results.dataset.state) load(location.pathname + location.search, {keep: false}); },
    });
  }

  document.addEventListener("keydown", event => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const typing = event.target.matches("input:not([type=checkbox]), textarea, select");
    if (event.key === "/" && input && !typing) { event.preventDefault(); input.focus(); input.select(); }
    if (!results || !["ArrowDown", "ArrowUp"].includes(event.key)) return;
    const links = [...results.querySelectorAll("td.item a")], at = links.indexOf(document.activeElement);
    if (at < 0 && event.target !== input) return;
    event.preventDefault();
    const next = at + (event.key === "ArrowDown" ? 1 : -1);
    if (next < 0) input.focus(); else links[Math.min(next, links.length - 1)]?.focus();
  });

  // ---- choosing models ----------------------------------------------------------------------------------------------

  const chooser = document.getElementById("chooser"), form = document.getElementById("choose");

  function showChoice() {
    if (!chooser) return;
    const count = chosen.size;
    document.getElementById("chosen").textContent = count < 2
      ? (count ? "1 model chosen; choose one more" : "Choose two or more models to compare") : `${count} models chosen`;
    chooser.querySelector("button").disabled = count < 2;
  }

  function restoreChoice(element) {
    for (const box of element.querySelectorAll("td.pick input")) box.checked = chosen.has(box.value);
  }

  if (form && chooser) {
    for (const box of form.querySelectorAll("td.pick input:checked")) chosen.add(box.value);
    form.addEventListener("change", event => {
      if (!event.target.matches("td.pick input")) return;
      if (event.target.checked) chosen.add(event.target.value); else chosen.delete(event.target.value);
      showChoice();
    });
    form.addEventListener("submit", () => {  // chosen ones that the filter hides are sent, too
      const shown = new Set([...form.querySelectorAll("td.pick input:checked")].map(box => box.value));
      for (const value of chosen) {
        if (shown.has(value)) continue;
        const hidden = document.createElement("input");
        Object.assign(hidden, {type: "hidden", name: "model", value});
        form.append(hidden);
      }
    });
    showChoice();
  }

  // ---- choices that are filtered where they are; what is chosen stays in sight --------------------------------------

  for (const field of document.querySelectorAll("[data-filters]")) {
    const rows = document.getElementById(field.dataset.filters).children;
    field.addEventListener("input", () => {
      const words = field.value.toLowerCase().split(/\s+/);
      for (const row of rows) {
        const text = row.textContent.toLowerCase();
        row.hidden = !row.querySelector("input").checked && !words.every(word => text.includes(word));
      }
    });
    field.addEventListener("keydown", event => { if (event.key === "Enter") event.preventDefault(); });
  }

  // ---- work in progress ---------------------------------------------------------------------------------------------

  for (const place of document.querySelectorAll("[data-work]")) {
    follow(place.dataset.work, {
      progress: text => { place.querySelector(".progress").textContent = text; },
      result: (html, stop) => { stop(); fill(place, html); },
      failed: (text, stop) => {
        stop();
        const line = document.createElement("p");
        Object.assign(line, {className: "warning", textContent: text});
        place.replaceChildren(line);
      },
      done: (address, stop) => { stop(); location.replace(address); },
    }, {once: true});
  }

  for (const place of document.querySelectorAll("[data-follow]")) {
    follow(place.dataset.follow, {
      content: html => { if (!place.querySelector(".plot-frame:focus, .plot-frame:hover")) fill(place, html); },
      ended: (html, stop) => {
        stop();
        document.querySelector(".kind").textContent = "ended";
        document.querySelector(".following").remove();
        for (const cell of place.querySelectorAll("td")) if (cell.textContent === "running") cell.textContent = "was running";
        place.querySelector(".headline")?.remove();  // how far it was when it was last seen
        place.insertAdjacentHTML("afterbegin", html);
      },
    });
  }

  globalThis.cesServe = {follow};
})();
