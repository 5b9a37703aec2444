const form = at("filters");
const fields = form.elements;
const list = at("signs");
const cards = Array.from(list.children);
const byId = new Map(cards.map(card => [card.id, card]));
const dots = new Map(Array.from(document.querySelectorAll("[data-for]"), dot => [dot.dataset.for, dot]));
const map = document.querySelector(".map");
const about = JSON.parse(at("about").textContent);
const store = "wayside review " + about.log + " " + about.result, told = "reviewed";
const defaults = { find: "", color: "", shape: "", code: "", status: "", review: "", confidence: "0", sort: "station" };
let said = new Map();
let missing = [];

// Filters, kept in the address

function number(card, name, unknown) {
  return card.dataset[name] === "" ? unknown : Number(card.dataset[name]);
}

const orders = {
  station: (a, b) => number(a, "station", Infinity) - number(b, "station", Infinity),
  best: (a, b) => number(b, "confidence", -1) - number(a, "confidence", -1),
  worst: (a, b) => number(a, "confidence", 2) - number(b, "confidence", 2),
};

function fits(card) {
  const least = Number(fields.confidence.value);
  return fields.find.value.toLowerCase().split(" ").every(word => card.dataset.find.includes(word))
    && ["color", "shape", "code", "status"].every(name => !fields[name].value || fields[name].value === card.dataset[name])
    && (!fields.review.value || fields.review.value === (card.dataset.review || "none"))
    && (least === 0 || number(card, "confidence", -1) >= least);
}

function chosen() {
  const changed = Object.keys(defaults).filter(name => fields[name].value !== defaults[name]);
  return changed.length ? "#" + new URLSearchParams(changed.map(name => [name, fields[name].value])) : "";
}

function sort() {
  list.append(...cards.sort(orders[fields.sort.value]));
}

function show() {
  const links = [];
  for (const card of cards) {
    card.hidden = !fits(card);
    dots.get(card.id)?.toggleAttribute("hidden", card.hidden);
    const link = card.querySelector("a");
    const page = link.getAttribute("href").split("#")[0];
    link.href = page + chosen();
    if (!card.hidden) links.push([card.id, page]);
  }
  try {  // what previous and next on a sheet mean
    sessionStorage.setItem("wayside " + new URL(".", location.href), JSON.stringify(links));
  } catch { /* not kept */ }
  fields.least.value = Number(fields.confidence.value).toFixed(2);
  at("count").textContent = links.length + " of " + cards.length + " shown";
  at("empty").hidden = links.length > 0;
}

function fromAddress() {
  if (location.hash && !location.hash.includes("=")) return show();
  const words = new URLSearchParams(location.hash.slice(1));
  for (const [name, value] of Object.entries(defaults)) {
    fields[name].value = words.get(name) ?? value;
    if (fields[name].value === "" && fields[name].tagName === "SELECT") fields[name].value = value;
  }
  sort();
  show();
}

function toAddress() {
  sort();
  show();
  history.replaceState(null, "", chosen() || location.href.split("#")[0]);
}

form.addEventListener("input", toAddress);
form.addEventListener("reset", () => setTimeout(toAddress));
form.addEventListener("submit", event => event.preventDefault());
addEventListener("hashchange", fromAddress);
addEventListener("pageshow", fromAddress);

// The review: what is said of each card, and the signs that are missing

function rows() {
  const found = Array.from(byId.keys()).filter(id => said.has(id)).map(id => ({ sign_id: id, ...said.get(id) }));
  return found.concat(missing.map(one => ({ sign_id: null, review: "missing", ...one })));
}

function remember() {
  keep({ reviews: rows() });
  draw();
}

function known(name, value) {
  const choices = at("looks").content.querySelector("[name=" + name + "]").options;
  return Array.from(choices).some(option => option.value === value && value) ? value : null;
}

function take({ reviews }) {
  said = new Map();
  missing = [];
  for (const one of reviews || []) {
    const look = { color: known("color", one.color), shape: known("shape", one.shape), note: String(one.note || "") };
    if (one.review === "missing" && Number.isFinite(Number(one.x)) && Number.isFinite(Number(one.y))) {
      missing.push({ ...look, x: Number(one.x), y: Number(one.y) });
    } else if (byId.has(one.sign_id) && ["accepted", "rejected", "edited"].includes(one.review)) {
      said.set(one.sign_id, { review: one.review, ...look });
    }
  }
}

function say(card, review) {
  const before = said.get(card.id);
  const again = before && before.review === review;
  const look = name => review === "edited" ? known(name, card.dataset[name]) : null;
  if (again && review !== "edited") said.delete(card.id);
  else if (!again) said.set(card.id, { review, color: look("color"), shape: look("shape"), note: before ? before.note : "" });
  remember();
  if (card.hidden) {  // by the filter: go on with the next one
    cards.slice(cards.indexOf(card)).concat(cards).find(other => !other.hidden)?.querySelector("a").focus();
  } else if (review === "edited") card.querySelector(".say select").focus();
}

function looks(values) {
  const part = document.createElement("span");
  part.className = "looks";
  part.append(at("looks").content.cloneNode(true));
  for (const field of part.querySelectorAll("[name]")) {
    field.value = values[field.name] || "";
    field.addEventListener("change", () => {
      values[field.name] = field.value || (field.name === "note" ? "" : null);
      remember();
    });
  }
  return part;
}

list.addEventListener("click", event => {
  const button = event.target.closest(".say > button");
  if (button) say(button.closest("li"), button.dataset.review);
});
list.addEventListener("keydown", event => {
  if (/^(INPUT|SELECT)$/.test(event.target.tagName) || event.ctrlKey || event.metaKey || event.altKey) return;
  const review = { a: "accepted", r: "rejected", e: "edited" }[event.key.toLowerCase()];
  if (review) { event.preventDefault(); say(event.target.closest("li"), review); }
});

function draw() {
  for (const card of cards) {
    const one = said.get(card.id);
    card.dataset.review = one ? one.review : "";
    const bar = card.querySelector(".say");
    for (const made of bar.querySelectorAll("button")) made.setAttribute("aria-pressed", String(card.dataset.review === made.dataset.review));
    const open = bar.querySelector(".looks");
    const edited = card.dataset.review === "edited";
    if (open && !edited) open.remove();
    if (!open && edited) bar.append(looks(one));
  }
  at("missing").replaceChildren(...missing.map((one, i) => {
    const entry = document.createElement("li");
    const remove = document.createElement("button");
    remove.type = "button";
    remove.textContent = "Remove";
    remove.addEventListener("click", () => { missing.splice(i, 1); remember(); });
    entry.append("missing at x " + one.x.toFixed(1) + " m, y " + one.y.toFixed(1) + " m ", looks(one));
    entry.lastChild.append(remove);
    return entry;
  }));
  drawMissing();
  at("reviewed").textContent = said.size + " of " + cards.length + " reviewed, " + missing.length + " missing";
  show();
}

function drawMissing() {
  if (!map) return;
  map.querySelectorAll(".missing").forEach(dot => dot.remove());
  const { turn, scale, left, top } = about.map;
  for (const { x, y } of missing) {
    const dot = document.createElementNS(map.namespaceURI, "circle");
    dot.setAttribute("class", "missing");
    dot.setAttribute("cx", (x * turn[0][0] + y * turn[1][0] - left) * scale);
    dot.setAttribute("cy", (top - x * turn[0][1] - y * turn[1][1]) * scale);
    dot.setAttribute("r", 9);
    map.append(dot);
  }
}

function place(pageX, pageY) {
  const point = new DOMPoint(pageX, pageY).matrixTransform(map.getScreenCTM().inverse());
  const { turn, scale, left, top } = about.map;
  const u = point.x / scale + left, v = top - point.y / scale;
  const [x, y] = turn.map(row => Math.round((u * row[0] + v * row[1]) * 100) / 100);
  missing.push({ x, y, color: null, shape: null, note: "" });
  adding(false);
  remember();
}

function adding(on) {
  at("add").setAttribute("aria-pressed", String(on));
  map.classList.toggle("adding", on);
  if (on) map.scrollIntoView({ block: "nearest" });
}

at("add").hidden = !map;
at("add").addEventListener("click", () => adding(!map.classList.contains("adding")));
map?.addEventListener("click", event => {
  if (map.classList.contains("adding")) { event.preventDefault(); place(event.clientX, event.clientY); }
});

// Files

const formula = /^'*[=+\-@\t\r]/;  // pipeline/files/csv_text.py

function asJson() {
  const whole = { wayside_review: 1, log: about.log, result: about.result, reviewer: at("reviewer").value.trim(), reviews: rows() };
  return JSON.stringify(whole, null, 1) + "\n";
}

function asCsv() {
  const shared = { result: about.result, reviewer: at("reviewer").value.trim() };
  const cell = value => {
    const text = typeof value === "string" && formula.test(value) ? "'" + value : String(value ?? "");
    return /[",\n\r]/.test(text) ? '"' + text.replaceAll('"', '""') + '"' : text;
  };
  const lines = rows().map(row => about.columns.map(name => cell({ ...row, ...shared }[name])).join(","));
  return [about.columns.join(","), ...lines].join("\n") + "\n";
}

function fromCsv(text) {
  const table = [[]];
  for (const [, quoted, plain, end] of text.replace(/^\uFEFF/, "").matchAll(/(?:"((?:[^"]|"")*)"|([^",\r\n]*))(,|\r?\n|$)/g)) {
    const value = quoted === undefined ? plain : quoted.replaceAll('""', '"');
    table[table.length - 1].push(value.startsWith("'") && formula.test(value) ? value.slice(1) : value);
    if (end !== ",") table.push([]);
  }
  const [names, ...found] = table;
  return found.filter(row => row.length === names.length).map(row => Object.fromEntries(names.map((name, i) => [name, row[i]])));
}

function read(name, text) {
  const whole = name.endsWith(".csv") ? { reviews: fromCsv(text) } : JSON.parse(text);
  const results = [whole.result, ...whole.reviews.map(one => one.result)].filter(Boolean);
  if (results.some(name => name !== about.result)) throw new Error("it is of another result");
  take(whole);
  at("reviewer").value = whole.reviewer || whole.reviews[0]?.reviewer || at("reviewer").value;
  remember();
}

at("csv").addEventListener("click", () => save("review.csv", asCsv(), "text/csv"));
at("json").addEventListener("click", () => save("review.json", asJson(), "application/json"));
recall();
at("fold").addEventListener("click", () => at("fold").setAttribute("aria-expanded", String(!form.classList.toggle("folded"))));
form.hidden = at("review").hidden = false;
if (map) zoomable(map, about.map);
fromAddress();
draw();
