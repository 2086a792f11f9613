// What the pages of the book do by themselves: formulas are set, films can be stopped, code can be copied, words light up their
// part of a figure, guesses are answered.
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
  for (const code of document.querySelectorAll(".bd-article div.highlight")) copyable(code);
  for (const film of document.querySelectorAll("main img[src$='.gif']")) pausable(film);
  for (const word of document.querySelectorAll("[data-shows]")) lighting(word);
  for (const form of document.querySelectorAll(".topokit-question")) answering(form);
});

function copyable(box) { // a button that copies the code, without the prompts of a shell
  const button = document.createElement("button"), text = box.querySelector("pre").textContent;
  if (!navigator.clipboard || box.closest(".cell_output")) return;
  [button.type, button.className, button.textContent, button.ariaLabel] = ["button", "topokit-copy", "copy", "copy this code"];
  button.onclick = () => navigator.clipboard.writeText(text.replace(/^\$ /gm, "").trimEnd()).then(() => {
    button.textContent = "copied";
    setTimeout(() => { button.textContent = "copy"; }, 1500);
  });
  box.classList.add("topokit-code");
  box.append(button);
}

function answering(form) { // says of a guess what chapter_tools.ask replies
  const asked = JSON.parse(form.dataset.question), words = (text) => String(text).toLowerCase().replace(/[^\p{L}\p{N}]/gu, "");
  const number = typeof asked.answer === "number", said = form.querySelector("output");
  const same = (guess, value) => number ? Math.abs(guess - value) <= asked.tolerance : words(guess) === words(value);
  form.onsubmit = (e) => {
    e.preventDefault();
    const guess = form.elements.guess.value, right = same(guess, asked.answer);
    const known = asked.wrong.find((each) => same(guess, each.guess))?.remark;
    const otherwise = number ? (guess < asked.answer ? asked.smaller : asked.larger) : "Have another look.";
    said.innerHTML = right ? "<strong>Right.</strong> " : "<strong>Not yet.</strong> ";
    said.append(right ? asked.why : known ?? otherwise);
  };
}

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

// <span data-shows="edge"> lights up what has this id in the nearest figure; "shape=hexagon" chooses it as well, "step=3" slides there.
function lighting(word) {
  const [id, value] = word.dataset.shows.split("="), top = (e) => e.getBoundingClientRect().top;
  const parts = () => [...document.querySelectorAll("iframe[srcdoc]")].map((frame) => frame.contentDocument?.getElementById(id)).filter((part) => part);
  const frameOf = (part) => part.ownerDocument.defaultView.frameElement;
  const nearest = () => parts().sort((a, b) => Math.abs(top(frameOf(a)) - top(word)) - Math.abs(top(frameOf(b)) - top(word)))[0];
  const light = (on) => {
    const part = nearest(); // none while the figure has not been loaded
    if (part) (part.closest("figure, label") ?? part).classList.toggle("lit", on);
    return part;
  };
  word.tabIndex = 0;
  word.role = "button";
  word.onmouseenter = word.onfocus = () => light(true);
  word.onmouseleave = word.onblur = () => light(false);
  word.onclick = () => {
    const part = light(true);
    if (!part) return;
    frameOf(part).scrollIntoView({ block: "nearest" });
    if (value === undefined) return;
    part.value = value;
    part.dispatchEvent(new Event(part.type === "range" ? "input" : "change"));
  };
  word.onkeydown = (e) => { // not an arrow that returns false: it would swallow the Tab key
    if (["Enter", " "].includes(e.key)) (e.preventDefault(), word.onclick());
  };
}
