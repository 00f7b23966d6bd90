"use strict";
(() => {
  const table = document.getElementById("table");
  const body = table.tBodies[0];
  const rows = [...body.rows];
  const heads = [...table.tHead.rows[0].cells];
  const field = (name) => document.getElementById(name);

  const filter = () => {
    const words = field("search").value.toLowerCase().split(/\s+/).filter(Boolean);
    const state = field("state").value;
    const known = field("known").value;
    let shown = 0;
    for (const row of rows) {
      const text = row.textContent.toLowerCase();
      row.hidden =
        !words.every((word) => text.includes(word)) ||
        (state === "look" ? row.dataset.look === undefined : state !== "" && row.dataset.state !== state) ||
        (known !== "" && row.dataset.known !== known);
      shown += row.hidden ? 0 : 1;
    }
    field("shown").textContent = `${shown} of ${rows.length}`;
  };

  // A row without results has one wide cell in place of most: it has no value there and stays at the end.
  const value = (row, column) => {
    const cell = row.cells[column];
    if (!cell || (cell.colSpan > 1 && column > 1)) return null;
    if (column === 1) return row.dataset.state;
    if (cell.dataset.sort !== undefined) return Number(cell.dataset.sort);
    return cell.textContent.trim() || null;
  };

  const sort = (column, direction) => {
    const keyed = rows.map((row) => [value(row, column), Number(row.dataset.order), row]);
    keyed.sort(([a, i], [b, j]) => {
      if (a === null || b === null) return (a === null) - (b === null) || i - j;
      const found = typeof a === "number" && typeof b === "number" ? a - b : String(a).localeCompare(String(b), "en", { numeric: true });
      return direction * found || i - j;
    });
    body.append(...keyed.map(([, , row]) => row));
  };

  heads.forEach((head, column) => {
    head.querySelector("button").addEventListener("click", () => {
      const before = head.getAttribute("aria-sort");
      heads.forEach((one) => one.removeAttribute("aria-sort"));
      if (before === "descending") {
        body.append(...rows);
        return;
      }
      head.setAttribute("aria-sort", before === "ascending" ? "descending" : "ascending");
      sort(column, before === "ascending" ? -1 : 1);
    });
  });
  field("filters").addEventListener("input", filter);
  field("filters").addEventListener("submit", (event) => event.preventDefault());
  filter();
})();
