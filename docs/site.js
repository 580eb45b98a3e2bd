"use strict";
// Names for the parts of the theme that have none, so that a screen reader can distinguish them.

function nameParts() {
  document.querySelector(".md-search")?.setAttribute("aria-label", "Search");
  document.querySelector(".md-search__options")?.setAttribute("aria-label", "Search options");
  document.querySelectorAll(".md-option[aria-hidden]").forEach((one) => { one.tabIndex = -1; }); // the system chooses the colours
  document.querySelectorAll(".md-typeset__scrollwrap").forEach((one) => { one.tabIndex = 0; }); // scrolled by keys
  document.querySelectorAll(".md-code__nav").forEach((one, n) => one.setAttribute("aria-label", `Code block ${n + 1}`));
}

// A picture is a link to itself in full size.
document.querySelectorAll("article img").forEach((picture) => {
  const link = document.createElement("a");
  link.href = picture.src;
  picture.replaceWith(link);
  link.append(picture);
});

nameParts();
new MutationObserver(nameParts).observe(document.body, { childList: true, subtree: true }); // the theme adds them later
