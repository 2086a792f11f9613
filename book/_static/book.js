// What the pages of the book do by themselves: formulas are set, films can be stopped, words light up their part of a figure,
// a search finds text in a folder.
"use strict";
document.addEventListener("DOMContentLoaded", () => {
  for (const place of document.querySelectorAll(".math")) {
    const number = place.querySelector(".eqno"), text = place.lastChild.textContent.trim();
    const block = place.tagName === "DIV", tex = text.replace(/^\\[[(]|\\[\])]$/g, "");
    const formula = document.createElement("span");
    katex.render(tex, formula, { displayMode: block, throwOnError: false, macros: { "\\hdots": "\\dots" } });
    place.replaceChildren(...(number ? [number] : []), formula);
    if (block) place.tabIndex = 0; // a wide one is scrolled to by the keys
  }
  for (const fold of document.querySelectorAll(".bd-sidebar-primary summary")) fold.ariaLabel = "its parts";
  for (const film of document.querySelectorAll("main img[src$='.gif']")) pausable(film);
  for (const word of document.querySelectorAll("[data-light]")) lamp(word);
});

function pausable(film) { // a still of where it stands lies on the film while it is stopped
  const still = document.createElement("canvas"), button = document.createElement("button"), box = document.createElement("span");
  const stop = (on) => {
    if (on) {
      [still.width, still.height] = [film.naturalWidth, film.naturalHeight];
      still.getContext("2d").drawImage(film, 0, 0);
    }
    still.hidden = !on;
    button.textContent = on ? "play" : "pause";
  };
  box.className = "topokit-gif";
  button.type = "button";
  button.onclick = () => stop(still.hidden);
  still.setAttribute("aria-hidden", "true");
  film.replaceWith(box);
  box.append(film, still, button);
  const quiet = matchMedia("(prefers-reduced-motion: reduce)").matches;
  if (film.complete) stop(quiet);
  else film.onload = () => stop(quiet);
}

function lamp(word) { // in the last figure before it, while it is pointed at or has the focus; data-set is what a press sets there
  const figures = [...document.querySelectorAll("iframe[srcdoc]")];
  const figure = figures.filter((f) => f.compareDocumentPosition(word) & Node.DOCUMENT_POSITION_FOLLOWING).pop() ?? figures[0];
  const shine = (on, set) => figure?.contentWindow.postMessage({ light: on ? word.dataset.light : null, set }, "*");
  for (const [name, value] of [["role", "button"], ["tabindex", 0], ["title", "shows it in the figure"]]) word.setAttribute(name, value);
  word.onpointerenter = word.onfocus = () => shine(true);
  word.onclick = () => shine(true, word.dataset.set);
  word.onkeydown = (e) => ["Enter", " "].includes(e.key) && (e.preventDefault(), word.onclick());
  word.onpointerleave = word.onblur = () => shine(false);
}
