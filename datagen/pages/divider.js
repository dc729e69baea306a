"use strict";
// Two pictures of each card under a divider, which is a slider; the two selects of the page choose which.
const sides = [...document.querySelectorAll(".choose select")];
function show() {
  for (const card of document.querySelectorAll(".case")) {
    const figures = [...card.querySelectorAll("figure")];
    const named = (name) => figures.find((figure) => figure.dataset.name === name);
    const shown = sides.map((side, i) => named(side.value) ?? figures[i]);
    const compare = card.querySelector(".compare");
    compare.hidden = false;
    shown.forEach((figure, i) => {
      const image = figure.querySelector("img");
      Object.assign(compare.querySelectorAll("img")[i], { src: image.src, alt: figure.dataset.name });
      compare.querySelectorAll("span")[i].textContent = figure.innerText.trim();
    });
    const [left, right] = shown.map((figure) => figure.dataset.name);
    compare.querySelector("input").ariaLabel = `Divider of ${card.querySelector("h3").firstChild.textContent.trim()}: ${left} on the left, ${right} on the right`;
  }
}
sides.forEach((side) => side.addEventListener("change", show));
document.addEventListener("input", ({ target }) => { if (target.type === "range") target.parentNode.style.setProperty("--at", target.value); });
show();
