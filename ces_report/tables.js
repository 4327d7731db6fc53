// Tables that the reader can sort: each heading of a table of the class `sortable` becomes a button. Cells are sorted
// by their `data-value` if they have one, else by their text; cells without a value stay last. Each body is sorted by
// itself, below its row of the class `group`.

function valueOf(row, column) {
  const cell = row.cells[column], text = cell.dataset.value ?? cell.textContent.trim(), number = Number(text);
  return text === "" || text === "–" ? null : Number.isNaN(number) ? text : number;
}

const compareValues = (a, b) =>
  typeof a === "number" && typeof b === "number" ? a - b : String(a).localeCompare(String(b), "en", {numeric: true});

for (const table of document.querySelectorAll("table.sortable")) {
  const headings = [...table.tHead.rows[0].cells];
  for (const [column, heading] of headings.entries()) {
    const button = makeElement("button", {type: "button"});
    button.append(...heading.childNodes);
    heading.append(button);
    heading.setAttribute("aria-sort", heading.getAttribute("aria-sort") || "none");
    button.addEventListener("click", () => {
      const rising = heading.getAttribute("aria-sort") !== "ascending";
      for (const body of table.tBodies) {
        const rows = [...body.querySelectorAll("tr:not(.group)")].map(row => ({row, value: valueOf(row, column)}));
        const known = rows.filter(one => one.value !== null);
        known.sort((a, b) => (rising ? 1 : -1) * compareValues(a.value, b.value));
        body.append(...known.map(one => one.row), ...rows.filter(one => one.value === null).map(one => one.row));
      }
      for (const one of headings) one.setAttribute("aria-sort", one !== heading ? "none" : rising ? "ascending" : "descending");
    });
  }
}
