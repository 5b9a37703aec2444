"use strict";
const at = id => document.getElementById(id);

function save(name, text, type) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([text], { type }));
  link.download = name;
  document.body.append(link);
  link.click();
  link.remove();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

function loadWith(load) {
  at("load").addEventListener("click", () => at("file").click());
  at("file").addEventListener("change", event => load(event.target.files[0]));
}

function recalled(store) {
  try { return JSON.parse(localStorage.getItem(store)); } catch { return null; }  // none, or not allowed
}
