// A chapter as slides, where its address ends in "?slides": what is seen, one thing at a time; the text between is its notes.
"use strict";
const SHOWN = "figure, .math, .proof, .cell, table, ul, ol, .admonition:not(.exercise)";

function slidesOf(section) { // each: the headings above it, what it shows, the notes before it
  const slides = [];
  const walk = (part, heads) => {
    let notes = [];
    for (const block of part.children) {
      if (block.matches("section")) walk(block, heads);
      else if (block.matches("h1, h2, h3")) heads = [block];
      else if (block.matches(".exercise, .topokit-takes, details")) continue;
      else if (block.matches(SHOWN) && worthASlide(block)) {
        const lead = block.matches("ul, ol") && notes.at(-1)?.textContent.length < 80 ? [notes.pop()] : []; // "Afterwards you can"
        slides.push({ heads: [...heads, ...lead], block, notes });
        notes = [];
      } else notes.push(block);
    }
  };
  walk(section, []);
  return slides;
}

function worthASlide(block) { // of a cell what it shows: pictures, tables, and what a few lines print
  if (block.matches(".proof") && !block.matches(".theorem, .definition, .lemma, .proposition, .corollary, .remark, .example")) return false;
  if (block.matches(".tag_hide-cell")) return false; // a solution
  if (!block.matches(".cell") || block.querySelector(".cell_output :is(iframe, .topokit-plot, img, table)")) return true;
  const code = block.querySelector(".cell_input pre"), lines = code === null ? 0 : code.textContent.split("\n").length;
  return block.querySelector(".cell_output") !== null && !block.querySelector("details") && lines <= 13;
}

function present() {
  const slides = slidesOf(document.querySelector("article.bd-article > section, article.bd-article")), root = document.documentElement;
  const bar = document.createElement("div"), told = document.createElement("output");
  let at = Math.min(Math.max(0, parseInt(location.hash.slice(2), 10) - 1 || 0), slides.length - 1);
  const show = (to) => {
    at = Math.min(Math.max(0, to), slides.length - 1);
    for (const old of document.querySelectorAll("[data-slide]")) delete old.dataset.slide;
    const { heads, block, notes } = slides[at];
    for (const part of [...heads, block]) part.dataset.slide = "shown";
    for (const part of notes) part.dataset.slide = "note";
    told.textContent = `${at + 1} / ${slides.length}`;
    history.replaceState(null, "", `?slides#s${at + 1}`);
    scrollTo(0, 0);
  };
  const leave = () => { location.href = location.pathname; };
  const button = (label, act) => {
    const made = document.createElement("button");
    [made.type, made.textContent, made.onclick] = ["button", label, act];
    bar.append(made);
  };
  const notes = () => root.classList.toggle("with-notes");
  button("back", () => show(at - 1));
  button("next", () => show(at + 1));
  button("notes", notes);
  button("leave", leave);
  bar.append(told);
  bar.className = "topokit-turn";
  document.body.append(bar);
  root.classList.add("as-slides");
  const keys = { ArrowRight: () => show(at + 1), PageDown: () => show(at + 1), ArrowLeft: () => show(at - 1), PageUp: () => show(at - 1), n: notes, Escape: leave };
  document.addEventListener("keydown", (event) => {
    if (event.target.closest("input, select, textarea") || !(event.key in keys)) return;
    event.preventDefault();
    keys[event.key]();
  });
  show(at);
}

if (new URLSearchParams(location.search).has("slides")) document.addEventListener("DOMContentLoaded", present);
