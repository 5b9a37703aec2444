"use strict";
const at = id => document.getElementById(id);

function made(tag, properties, ...inside) {
  const one = Object.assign(document.createElement(tag), properties);
  one.append(...inside);
  return one;
}

function save(name, text, type) {
  const link = made("a", { href: URL.createObjectURL(new Blob([text], { type })), download: name });
  document.body.append(link);
  link.click();
  link.remove();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

function keep(content) {  // in this browser; a page names its `store`
  try { localStorage.setItem(store, JSON.stringify({ ...content, reviewer: at("reviewer").value })); } catch { /* not kept */ }
}

function recall() {
  try {
    const kept = JSON.parse(localStorage.getItem(store));
    if (kept) { take(kept); at("reviewer").value = kept.reviewer || ""; }
  } catch { /* none, or not allowed */ }
}

async function load(file) {  // a page has `read` for what a file holds, and says at `told` what is wrong with it
  if (!file) return;
  try { read(file.name, await file.text()); } catch (error) { at(told).textContent = "not loaded: " + error.message; }
}

at("load").addEventListener("click", () => at("file").click());
at("file").addEventListener("change", event => load(event.target.files[0]));
at("reviewer").addEventListener("change", () => remember());
