"use strict";
// The index of many flights: a click on a column header sorts by it (again: reversed), the input field filters.

const body = document.querySelector("#flights tbody"), rows = [...body.rows];
let sorted = -1, upwards = true;

document.querySelectorAll("#flights th button").forEach((button, column) => button.addEventListener("click", () => {
  upwards = sorted === column ? !upwards : true;
  sorted = column;
  const key = (row) => row.cells[column].textContent;
  const order = new Intl.Collator(undefined, { numeric: true });
  rows.sort((one, other) => order.compare(key(one), key(other)) * (upwards ? 1 : -1));
  body.append(...rows);
  document.querySelectorAll("#flights th").forEach((head, i) => {
    if (i === column) head.setAttribute("aria-sort", upwards ? "ascending" : "descending"); else head.removeAttribute("aria-sort");
  });
}));

document.getElementById("filter").addEventListener("input", (event) => {
  const words = event.target.value.toLowerCase().split(/\s+/).filter(Boolean);
  for (const row of rows) row.hidden = !words.every((word) => row.textContent.toLowerCase().includes(word));
  const shown = rows.filter((row) => !row.hidden).length;
  document.getElementById("shown").textContent = words.length ? `${shown} of ${rows.length}` : "";
});
