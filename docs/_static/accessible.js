// What the theme and docutils leave to be said to screen readers.
document.addEventListener("DOMContentLoaded", () => {
  for (const summary of document.querySelectorAll(".bd-sidebar summary")) {
    const link = summary.parentElement.parentElement.querySelector("a");
    summary.setAttribute("aria-label", `Pages of ${link ? link.textContent.trim() : "this section"}`);
  }
  for (const button of document.querySelectorAll(".search-button-field")) {
    button.removeAttribute("aria-label"); // its own text says more
  }
  for (const list of document.querySelectorAll(".citation-list, .citation")) {
    list.removeAttribute("role"); // references of one docstring, linked both ways
  }
});
