// What the keyboard and a screen reader need: regions that scroll take the focus, landmarks have names.
window.addEventListener("load", () => {
  for (const region of document.querySelectorAll("pre, .table-wrapper, .math")) {
    if (region.scrollWidth > region.clientWidth) region.tabIndex = 0;
  }
  for (const caption of document.querySelectorAll("p.caption[role=heading]")) {
    caption.setAttribute("aria-level", "2");
  }
  if (!document.querySelector("h1")) {  // the page of the search
    document.querySelector("article")?.insertAdjacentHTML("afterbegin", "<h1>Search</h1>");
  }
  document.querySelector(".sidebar-drawer")?.setAttribute("aria-label", "pages");
  document.querySelector(".toc-drawer")?.setAttribute("aria-label", "this page");
});
