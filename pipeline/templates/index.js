const form = document.getElementById("filters");
const fields = form.elements;
const list = document.getElementById("signs");
const cards = Array.from(list.children);
const byId = new Map(cards.map(card => [card.id, card]));
const dots = new Map(Array.from(document.querySelectorAll("[data-for]"), dot => [dot.dataset.for, dot]));
const about = JSON.parse(document.getElementById("about").textContent);

function number(card, name, missing) {
  return card.dataset[name] === "" ? missing : Number(card.dataset[name]);
}

const orders = {
  station: (a, b) => number(a, "station", Infinity) - number(b, "station", Infinity),
  best: (a, b) => number(b, "confidence", -1) - number(a, "confidence", -1),
  worst: (a, b) => number(a, "confidence", 2) - number(b, "confidence", 2),
};

function fits(card, wanted, least) {
  return card.dataset.id.includes(wanted)
    && ["color", "shape", "code", "status"].every(name => !fields[name].value || fields[name].value === card.dataset[name])
    && (!fields.review.value || fields.review.value === (card.dataset.review || "none"))
    && (least === 0 || number(card, "confidence", -1) >= least);
}

function show() {
  const wanted = fields.id.value.trim().toLowerCase();
  const least = Number(fields.confidence.value);
  let shown = 0;
  for (const card of cards) {
    card.hidden = !fits(card, wanted, least);
    const dot = dots.get(card.id);
    if (dot) dot.toggleAttribute("hidden", card.hidden);
    shown += card.hidden ? 0 : 1;
    const link = card.querySelector("a");
    link.href = link.getAttribute("href").split("#")[0] + chosen();
  }
  try {  // what previous and next on a sheet mean; a sort comes before
    const kept = cards.filter(card => !card.hidden).map(card => [card.id, card.querySelector("a").getAttribute("href").split("#")[0]]);
    sessionStorage.setItem("wayside " + new URL(".", location.href), JSON.stringify(kept));
  } catch { /* not kept */ }
  fields.least.value = least.toFixed(2);
  at("count").textContent = shown + " of " + cards.length + " shown";
  at("empty").hidden = shown > 0;
}

function sort() {
  list.append(...cards.sort(orders[fields.sort.value]));
}

const defaults = { id: "", color: "", shape: "", code: "", status: "", review: "", confidence: "0", sort: "station" };

function chosen() {
  const changed = new URLSearchParams();
  for (const [name, value] of Object.entries(defaults)) if (fields[name].value !== value) changed.set(name, fields[name].value);
  return changed.size ? "#" + changed : "";
}

function fromAddress() {
  const words = location.hash.includes("=") ? new URLSearchParams(location.hash.slice(1)) : new URLSearchParams();
  for (const [name, value] of Object.entries(defaults)) {
    fields[name].value = words.get(name) ?? value;
    if (fields[name].value === "" && fields[name].tagName === "SELECT") fields[name].value = value;
  }
  sort();
  show();
}

function changed(event) {
  if (event.target.name === "sort") sort();
  show();
  history.replaceState(null, "", chosen() || location.href.split("#")[0]);
}

form.addEventListener("input", changed);
form.addEventListener("reset", () => setTimeout(() => { sort(); show(); history.replaceState(null, "", location.href.split("#")[0]); }));
form.addEventListener("submit", event => event.preventDefault());
addEventListener("hashchange", () => { if (location.hash.includes("=") || !location.hash) fromAddress(); });
addEventListener("pageshow", () => { if (!location.hash || location.hash.includes("=")) fromAddress(); else show(); });

const store = "wayside review " + about.log + " " + about.result;
let said = new Map();
let missing = [];

function remember() {
  try {
    localStorage.setItem(store, JSON.stringify({ reviewer: at("reviewer").value, reviews: rows() }));
  } catch { /* not kept */ }
  draw();
}

function rows() {
  const found = [];
  for (const card of Array.from(byId.values())) if (said.has(card.id)) found.push({ sign_id: card.id, ...said.get(card.id) });
  return found.concat(missing.map(one => ({ sign_id: null, review: "missing", ...one })));
}

function take(found) {
  said = new Map();
  missing = [];
  for (const one of found || []) {
    const look = { color: known("color", one.color), shape: known("shape", one.shape), note: String(one.note || "") };
    if (one.review === "missing" && Number.isFinite(Number(one.x)) && Number.isFinite(Number(one.y))) {
      missing.push({ ...look, x: Number(one.x), y: Number(one.y) });
    } else if (byId.has(one.sign_id) && ["accepted", "rejected", "edited"].includes(one.review)) {
      said.set(one.sign_id, { review: one.review, ...look });
    }
  }
}

function known(name, value) {
  const choices = at("looks").content.querySelector("[name=" + name + "]").options;
  return Array.from(choices).some(option => option.value === value && value) ? value : null;
}

function say(card, review) {
  const before = said.get(card.id);
  const own = name => card.dataset[name] === "unknown" ? null : card.dataset[name];
  if (before && before.review === review && review !== "edited") said.delete(card.id);
  else if (review === "edited") said.set(card.id, before && before.review === "edited" ? before
    : { review, color: own("color"), shape: own("shape"), note: before ? before.note : "" });
  else said.set(card.id, { review, color: null, shape: null, note: before ? before.note : "" });
  remember();
  if (card.hidden) {  // by the filter: go on with the next one
    const next = cards.slice(cards.indexOf(card)).concat(cards).find(other => !other.hidden);
    if (next) next.querySelector("a").focus();
  } else if (review === "edited") card.querySelector(".say select").focus();
}

function looks(values, update) {
  const part = document.createElement("span");
  part.className = "looks";
  part.append(at("looks").content.cloneNode(true));
  for (const field of part.querySelectorAll("[name]")) {
    field.value = values[field.name] || "";
    field.addEventListener("change", () => update(field.name, field.value || (field.name === "note" ? "" : null)));
  }
  return part;
}

function button(words, act) {
  const made = document.createElement("button");
  made.type = "button";
  made.textContent = words;
  made.addEventListener("click", act);
  return made;
}

for (const card of cards) {
  const bar = document.createElement("div");
  bar.className = "say";
  for (const [words, review] of [["Accept", "accepted"], ["Reject", "rejected"], ["Edit", "edited"]]) {
    const made = button(words, () => say(card, review));
    made.dataset.review = review;
    made.setAttribute("aria-label", words + " " + card.id);
    bar.append(made);
  }
  card.append(bar);
  card.addEventListener("keydown", event => {
    if (/^(INPUT|SELECT)$/.test(event.target.tagName) || event.ctrlKey || event.metaKey || event.altKey) return;
    const review = { a: "accepted", r: "rejected", e: "edited" }[event.key.toLowerCase()];
    if (review) { event.preventDefault(); say(card, review); }
  });
}

function draw() {
  for (const card of cards) {
    const one = said.get(card.id);
    card.dataset.review = one ? one.review : "";
    const bar = card.querySelector(".say");
    for (const made of bar.querySelectorAll("button")) made.setAttribute("aria-pressed", String(!!one && made.dataset.review === one.review));
    const open = bar.querySelector(".looks");
    if (open && !(one && one.review === "edited")) open.remove();
    if (!open && one && one.review === "edited") bar.append(looks(one, (name, value) => { one[name] = value; remember(); }));
  }
  const places = missing.map((one, i) => {
    const entry = document.createElement("li");
    entry.append("missing at x " + one.x.toFixed(1) + " m, y " + one.y.toFixed(1) + " m ");
    const part = looks(one, (name, value) => { one[name] = value; remember(); });
    part.append(button("Remove", () => { missing.splice(i, 1); remember(); }));
    entry.append(part);
    return entry;
  });
  at("missing").replaceChildren(...places);
  drawMissing();
  const count = said.size;
  at("reviewed").textContent = count + " of " + cards.length + " reviewed, " + missing.length + " missing";
  show();
}

const map = document.querySelector(".map");

function drawMissing() {
  if (!map) return;
  map.querySelectorAll(".missing").forEach(dot => dot.remove());
  const w = about.map;
  for (const one of missing) {
    const u = one.x * w.turn[0][0] + one.y * w.turn[1][0], v = one.x * w.turn[0][1] + one.y * w.turn[1][1];
    const dot = document.createElementNS(map.namespaceURI, "circle");
    dot.setAttribute("class", "missing");
    dot.setAttribute("cx", (u - w.left) * w.scale);
    dot.setAttribute("cy", (w.top - v) * w.scale);
    dot.setAttribute("r", 9);
    map.append(dot);
  }
}

function place(pageX, pageY) {
  const point = new DOMPoint(pageX, pageY).matrixTransform(map.getScreenCTM().inverse());
  const w = about.map;
  const u = point.x / w.scale + w.left, v = w.top - point.y / w.scale;
  const x = u * w.turn[0][0] + v * w.turn[0][1], y = u * w.turn[1][0] + v * w.turn[1][1];
  missing.push({ x: Math.round(x * 100) / 100, y: Math.round(y * 100) / 100, color: null, shape: null, note: "" });
  adding(false);
  remember();
}

function adding(on) {
  at("add").setAttribute("aria-pressed", String(on));
  if (map) map.classList.toggle("adding", on);
}

function isAdding() {
  return at("add").getAttribute("aria-pressed") === "true";
}

if (map) map.addEventListener("click", event => {
  if (isAdding()) { event.preventDefault(); place(event.clientX, event.clientY); }
});
at("add").hidden = !map;
at("add").addEventListener("click", () => adding(!isAdding()));
at("reviewer").addEventListener("change", remember);

function asJson() {
  const whole = { wayside_review: 1, log: about.log, result: about.result, reviewer: at("reviewer").value.trim(), reviews: rows() };
  return JSON.stringify(whole, null, 1) + "\n";
}

const formula = /^'*[=+\-@\t\r]/;  // pipeline/csv_text.py

function asCsv() {
  const cell = value => /[",\n\r]/.test(value) ? '"' + value.replaceAll('"', '""') + '"' : value;
  const shared = { result: about.result, reviewer: at("reviewer").value.trim() };
  const text = value => typeof value === "string" && formula.test(value) ? "'" + value : String(value ?? "");
  const lines = rows().map(row => about.columns.map(name => cell(text({ ...row, ...shared }[name]))).join(","));
  return [about.columns.join(","), ...lines].join("\n") + "\n";
}

function fromCsv(text) {
  const table = [[]];
  for (const [, quoted, plain, end] of text.replace(/^\uFEFF/, "").matchAll(/(?:"((?:[^"]|"")*)"|([^",\r\n]*))(,|\r?\n|$)/g)) {
    table[table.length - 1].push(quoted === undefined ? plain : quoted.replaceAll('""', '"'));
    if (end !== ",") table.push([]);
  }
  const whole = value => value.startsWith("'") && formula.test(value) ? value.slice(1) : value;
  const names = table[0];
  return table.slice(1).filter(row => row.length === names.length).map(row => Object.fromEntries(names.map((name, i) => [name, whole(row[i])])));
}

async function load(file) {
  if (!file) return;
  try {
    const text = await file.text();
    const whole = file.name.endsWith(".csv") ? { reviews: fromCsv(text) } : JSON.parse(text);
    const results = [whole.result, ...whole.reviews.map(one => one.result)].filter(Boolean);
    if (results.some(name => name !== about.result)) throw new Error("it is of another result");
    take(whole.reviews);
    at("reviewer").value = whole.reviewer || (whole.reviews[0] || {}).reviewer || at("reviewer").value;
    remember();
  } catch (error) {
    at("reviewed").textContent = "not loaded: " + error.message;
  }
}

at("csv").addEventListener("click", () => save("review.csv", asCsv(), "text/csv"));
at("json").addEventListener("click", () => save("review.json", asJson(), "application/json"));
at("load").addEventListener("click", () => at("file").click());
at("file").addEventListener("change", event => load(event.target.files[0]));
try {
  const kept = JSON.parse(localStorage.getItem(store));
  if (kept) { take(kept.reviews); at("reviewer").value = kept.reviewer || ""; }
} catch { /* none, or not allowed */ }
at("fold").addEventListener("click", () => at("fold").setAttribute("aria-expanded", String(!form.classList.toggle("folded"))));
form.hidden = at("review").hidden = false;
fromAddress();
draw();
