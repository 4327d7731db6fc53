// Tables that the reader can sort: each heading of a table of the class `sortable` becomes a button. Cells are sorted
// by their `data-value` if they have one, else by their text; cells without a value stay last.
"use strict";

(() => {
  const valueOf = (row, column) => {
    const cell = row.cells[column], text = cell.dataset.value ?? cell.textContent.trim();
    const number = Number(text);
    return text === "" || text === "–" ? null : Number.isNaN(number) ? text : number;
  };

  const compare = (a, b) => typeof a === "number" && typeof b === "number" ? a - b : String(a).localeCompare(String(b), "en", {numeric: true});

  function sortTable(table, column, rising) {
    const body = table.tBodies[0], rows = [...body.rows].map(row => ({row, value: valueOf(row, column)}));
    const known = rows.filter(one => one.value !== null).sort((a, b) => (rising ? 1 : -1) * compare(a.value, b.value));
    body.append(...[...known, ...rows.filter(one => one.value === null)].map(one => one.row));
    for (const [i, heading] of [...table.tHead.rows[0].cells].entries()) {
      heading.setAttribute("aria-sort", i === column ? (rising ? "ascending" : "descending") : "none");
    }
  }

  function makeSortable(table) {
    for (const [column, heading] of [...table.tHead.rows[0].cells].entries()) {
      const button = document.createElement("button");
      button.type = "button";
      button.append(...heading.childNodes);
      heading.append(button);
      heading.setAttribute("aria-sort", heading.getAttribute("aria-sort") || "none");
      button.addEventListener("click", () => sortTable(table, column, heading.getAttribute("aria-sort") !== "ascending"));
    }
  }

  for (const table of document.querySelectorAll("table.sortable")) makeSortable(table);
})();
