// Labels for screen readers that the theme and docutils do not set, and the shapes of figures.
document.addEventListener("DOMContentLoaded", () => {
  for (const summary of document.querySelectorAll(".bd-sidebar summary")) {
    const link = summary.parentElement.parentElement.querySelector("a");
    summary.setAttribute("aria-label", `Pages of ${link ? link.textContent.trim() : "this section"}`);
  }
  for (const button of document.querySelectorAll(".search-button-field")) {
    button.setAttribute("aria-label", button.textContent.replace(/\s+/g, " ").trim());
  }
  for (const link of document.querySelectorAll(".sphx-glr-thumbcontainer a.internal")) {
    link.setAttribute("aria-label", link.textContent.trim()); // its text is not shown
  }
  for (const list of document.querySelectorAll(".citation-list, .citation")) {
    list.removeAttribute("role"); // references of one docstring, linked both ways
  }
  for (const image of document.querySelectorAll(".bd-article img:not(.sphx-glr-thumbcontainer img)")) {
    const frame = document.createElement("span");
    frame.className = "figure-frame";
    image.replaceWith(frame);
    frame.append(image);
    const shape = () => {
      image.style.setProperty("--shape", image.naturalWidth / image.naturalHeight);
      image.style.setProperty("--wide", `${image.naturalWidth}px`);
    };
    image.complete ? shape() : image.addEventListener("load", shape);
  }
});
