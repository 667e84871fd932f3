// What the keyboard and a screen reader need: regions that scroll take the focus, landmarks have names.
window.addEventListener("load", () => {
  for (const table of document.querySelectorAll("table.docutils")) {  // on narrow screens, rows of text become blocks
    const heads = [...table.querySelectorAll("thead th")].map((head) => head.textContent.trim());
    const rows = [...table.querySelectorAll("tbody tr")];
    const isText = (cell) => cell.cellIndex > 0 && /[a-z ]{20}/.test(cell.textContent);
    if (heads.length < 3 || !rows.some((row) => [...row.cells].some(isText))) continue;
    table.classList.add("stacks");
    table.classList.toggle("meaning", heads.at(-1) === "meaning");
    for (const row of rows) {
      for (const cell of row.cells) {
        const isEmpty = !cell.textContent.trim() && !cell.querySelector("img");
        cell.setAttribute(isEmpty ? "data-empty" : "data-head", heads[cell.cellIndex]);
      }
    }
  }
  const measure = () => {
    for (const region of document.querySelectorAll("pre, .table-wrapper, .math")) {
      const scrolls = region.scrollWidth > region.clientWidth;
      if (scrolls) region.tabIndex = 0;
      if (region.matches(".table-wrapper")) region.classList.toggle("scrolls", scrolls);
    }
  };
  measure();
  window.addEventListener("resize", measure);
  for (const caption of document.querySelectorAll("p.caption[role=heading]")) {
    caption.setAttribute("aria-level", "2");
  }
  if (!document.querySelector("h1")) {  // the page of the search
    document.querySelector("article")?.insertAdjacentHTML("afterbegin", "<h1>Search</h1>");
  }
  document.querySelector(".sidebar-drawer")?.setAttribute("aria-label", "pages");
  document.querySelector(".toc-drawer")?.setAttribute("aria-label", "this page");
});
