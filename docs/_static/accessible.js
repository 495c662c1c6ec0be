// Labels for screen readers that the theme and docutils do not set, places at which long names may
// break, frames in which wide figures scroll, and a button that copies a block of code, commands
// without their prompt.
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
  for (const part of document.querySelectorAll("code.literal .pre")) {
    const [text] = part.childNodes;
    if (part.childNodes.length === 1 && text.nodeType === Node.TEXT_NODE) {
      part.innerHTML = part.innerHTML.replace(/(?<!&\w*)([_/.:]+)(?=\w)/g, "$1<wbr>");
    }
  }
  for (const block of document.querySelectorAll(".highlight-python pre, .highlight-console pre")) {
    const button = document.createElement("button");
    button.className = "copy";
    button.textContent = "Copy";
    button.addEventListener("click", async () => {
      const lines = block.textContent.trimEnd().split("\n");
      await navigator.clipboard.writeText(lines.map((line) => line.replace(/^\$ /, "")).join("\n"));
      button.textContent = "Copied";
    });
    block.parentElement.append(button);
  }
  const watch = new ResizeObserver((entries) => {
    for (const { target } of entries) {
      const frame = target.closest(".figure-frame");
      frame.classList.toggle("cut", target.offsetWidth > frame.clientWidth + 1);
    }
  });
  for (const image of document.querySelectorAll(".bd-article img:not(.sphx-glr-thumbcontainer img)")) {
    const frame = document.createElement("span");
    const link = document.createElement("a"); // to the figure alone, which a phone can enlarge
    frame.className = "figure-frame";
    link.href = image.src;
    image.replaceWith(frame);
    link.append(image);
    frame.append(link);
    watch.observe(image);
    const shape = () => {
      frame.style.setProperty("--shape", image.naturalWidth / image.naturalHeight);
      frame.style.setProperty("--wide", `${image.naturalWidth}px`);
    };
    image.complete ? shape() : image.addEventListener("load", shape);
  }
});
