// What tests ask of a page in a real browser: is anything cut off, do texts collide, can everything be read.
({
  // Elements that are cut off, or wider than the page; not what is inside an element that scrolls.
  findClipped() {
    const edge = document.documentElement.clientWidth;
    const scrolls = e => e && (["auto", "scroll"].includes(getComputedStyle(e).overflowX) || scrolls(e.parentElement));
    const isCut = e => e.scrollWidth > e.clientWidth + 1 && getComputedStyle(e).overflowX === "hidden";
    const isTooWide = e => e.tagName === "TABLE"  // it lies over what is beside it
      && e.getBoundingClientRect().right > e.parentElement.getBoundingClientRect().right + 1;
    return [...document.body.querySelectorAll("*")]
      .filter(e => !e.closest("svg") && e.getClientRects().length && !scrolls(e.parentElement))
      .filter(e => e.getBoundingClientRect().right > edge + 1 || isCut(e) || isTooWide(e))
      .map(e => `${e.tagName}.${e.className} ends at ${e.getBoundingClientRect().right} of ${edge}`);
  },

  // Pairs of texts of one figure whose boxes overlap by more than a pixel (boxes are higher than their letters).
  findCollisions() {
    const out = [];
    for (const svg of document.querySelectorAll("svg")) {
      const texts = [...svg.querySelectorAll("text")].filter(t => t.textContent.trim() && t.getClientRects().length);
      const boxes = texts.map(t => ({text: t.textContent, box: t.getBoundingClientRect()}));
      boxes.forEach((a, i) => boxes.slice(i + 1).forEach(b => {
        const across = Math.min(a.box.right, b.box.right) - Math.max(a.box.left, b.box.left);
        const down = Math.min(a.box.bottom, b.box.bottom) - Math.max(a.box.top, b.box.top);
        if (across > 1 && down > 0.25 * Math.min(a.box.height, b.box.height)) {
          out.push(`${svg.querySelector("title").textContent}: ${a.text} | ${b.text}`);
        }
      }));
    }
    return out;
  },

  // Charts that keys do not reach, or that have no name, no description or no table of their values.
  findUnnamed() {
    const out = [];
    for (const svg of document.querySelectorAll("svg[role=img]")) {
      const frame = svg.closest(".plot-frame, .value-frame"), text = name => svg.querySelector(`:scope > ${name}`)?.textContent.trim();
      const wrong = [];
      if (!text("title") || !text("desc")) wrong.push("has no title or description");
      if (!frame || frame.tabIndex !== 0 || !frame.getAttribute("aria-label")) wrong.push("is not reached by keys");
      const around = svg.closest("figure") || svg.closest(".plot, section");
      if (!around.querySelector("table") && !svg.querySelector(".value")) wrong.push("has no table");
      out.push(...wrong.map(what => `${text("title")}: ${what}`));
    }
    return out;
  },

  // Texts whose contrast with what is behind them is below 4.5, or 3 for large ones, and lines below 3 (WCAG 2.2, AA).
  findLowContrast() {
    const parse = text => {
      const n = text.match(/[\d.]+/g).map(Number);
      const scale = text.startsWith("color(srgb") ? 255 : 1;  // a mixed colour is given in shares
      return {colour: n.slice(0, 3).map(v => scale * v), alpha: n[3] ?? 1};
    };
    const linear = v => v / 255 <= 0.04045 ? v / 255 / 12.92 : ((v / 255 + 0.055) / 1.055) ** 2.4;
    const luminance = ([r, g, b]) => 0.2126 * linear(r) + 0.7152 * linear(g) + 0.0722 * linear(b);
    const mix = (over, alpha, under) => over.map((v, i) => alpha * v + (1 - alpha) * under[i]);
    const behind = e => {
      if (!e) return [255, 255, 255];
      const {colour, alpha} = parse(getComputedStyle(e).backgroundColor);
      return alpha === 1 ? colour : mix(colour, alpha, behind(e.parentElement));
    };
    const hasText = e => [...e.childNodes].some(n => n.nodeType === 3 && n.data.trim());
    const isShown = e => e.checkVisibility({checkOpacity: true, checkVisibilityCSS: true});
    const out = new Set();
    for (const e of document.querySelectorAll("body *")) {
      if (!hasText(e) || !isShown(e)) continue;
      const style = getComputedStyle(e), drawn = e.namespaceURI.endsWith("svg");
      const back = behind(drawn ? e.closest("svg").parentElement : e), ink = parse(drawn ? style.fill : style.color);
      const [a, b] = [luminance(mix(ink.colour, ink.alpha, back)), luminance(back)];
      const contrast = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05), size = parseFloat(style.fontSize);
      const large = size >= 24 || size >= 18.5 && style.fontWeight >= 700;
      if (contrast < (large ? 3 : 4.5)) out.add(`${e.tagName}.${e.getAttribute("class")} ${contrast.toFixed(2)}: ${e.textContent.trim().slice(0, 40)}`);
    }
    for (const e of document.querySelectorAll(".plot-swatch path:not(.area)")) {  // lines and dots: 3 is enough
      const style = getComputedStyle(e), ink = parse(style.stroke), back = behind(e.closest("svg").parentElement);
      const [a, b] = [luminance(mix(ink.colour, ink.alpha * style.strokeOpacity, back)), luminance(back)];
      const contrast = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
      if (contrast < 3) out.add(`line ${e.getAttribute("class")} ${contrast.toFixed(2)}`);
    }
    return [...out];
  },
})
