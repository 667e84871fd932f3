// A click on the head of a column sorts the table by it, and a second click turns the order round.
// A table that is wider than the page says that it scrolls.
"use strict";

const unknown = (key) => key === "" || key === "nan";

const by = (index, turned) => (first, second) => {
  const [a, b] = [first, second].map((row) => row.cells[index].dataset.key);
  const [x, y] = [a, b].map((key) => Number(key.replace("inf", "Infinity")));
  const order = unknown(a) || unknown(b) ? unknown(a) - unknown(b)
    : Number.isNaN(x) || Number.isNaN(y) ? a.localeCompare(b) : x - y;
  return turned ? -order : order;
};

for (const button of document.querySelectorAll("th button")) {
  button.addEventListener("click", () => {
    const head = button.parentElement;
    const body = head.closest("table").tBodies[0];
    const turned = head.getAttribute("aria-sort") === "ascending";
    for (const other of head.parentElement.cells) other.removeAttribute("aria-sort");
    head.setAttribute("aria-sort", turned ? "descending" : "ascending");
    body.append(...[...body.rows].sort(by(head.cellIndex, turned)));
  });
}

const width = new ResizeObserver((entries) => {
  for (const { target } of entries) {
    target.classList.toggle("scrolls", target.scrollWidth > target.clientWidth);
  }
});
for (const table of document.querySelectorAll(".table")) width.observe(table);
