const form = at("filters");
const fields = form.elements;
const list = at("signs");
const cards = Array.from(list.children);
const byId = new Map(cards.map(card => [card.id, card]));
const dots = new Map(Array.from(document.querySelectorAll("[data-for]"), dot => [dot.dataset.for, dot]));
const map = document.querySelector(".map");
const about = JSON.parse(at("about").textContent);
const prefix = "wayside review " + about.log + " ", store = prefix + about.result + " " + about.seed, told = "reviewed";
const defaults = { find: "", color: "", shape: "", code: "", status: "", review: "", confidence: "0", sort: "station" };
let said = new Map();
let missing = [];
let decided = new Set();  // by their words
let before = [], state = "";  // of undo

// Filters, kept in the address

const number = (card, name, unknown) => card.dataset[name] === "" ? unknown : Number(card.dataset[name]);
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

const sort = () => list.append(...cards.sort(orders[fields.sort.value]));

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

// The review: what is said of each card, the signs that are missing, and what is decided of earlier reviews

const look = one => ({ code: one.code ?? null, legend: one.legend ?? null, color: one.color ?? null, shape: one.shape ?? null });
const open = () => about.undecided.filter(one =>  // what is said on a card is decided, too
  !decided.has(one.words) && !one.options.some(({ row }) => row && said.has(row.sign_id)));
const snapshot = () => JSON.stringify([[...said], missing, [...decided]]);

function rows() {
  const reviewer = at("reviewer").value.trim();
  const found = Array.from(byId.keys()).filter(id => said.has(id)).map(id => ({ ...about.rows[id], ...said.get(id) }));
  const added = missing.map(one => ({ ...one, sign_id: null, review: "missing", result: about.result }));
  const mine = found.concat(added).map(one => ({ ...one, reviewer: one.reviewer || reviewer }));
  return mine.concat(open().flatMap(one => one.entries));
}

function remember() {
  if (snapshot() !== state) before = [...before, state].slice(-100);
  settle();
}

function settle() {
  state = snapshot();
  keep({ reviews: rows(), decided: [...decided] });
  draw();
}

function undo() {
  const [cards, added, words] = JSON.parse(before.pop() || state);
  [said, missing, decided] = [new Map(cards), added, new Set(words)];
  settle();
}

function known(name, value) {
  const field = at("looks").content.querySelector("[name=" + name + "]");
  const fits = field.tagName !== "SELECT" || Array.from(field.options).some(option => option.value === value);
  return value === "unknown" || (value && fits) ? String(value) : null;
}

function take(kept) {
  const reviews = kept.reviews || [], ids = reviews.map(one => one.sign_id);
  [said, missing, decided] = [new Map(), [], new Set(kept.decided || [])];
  for (const one of reviews) {
    if (one.result && one.result !== about.result) continue;  // to decide, as the page says
    const about_it = look({});
    for (const name of Object.keys(about_it)) about_it[name] = known(name, one[name]);
    for (const name of ["note", "reviewer"]) about_it[name] = String(one[name] || "");
    const [x, y] = [Number(one.x), Number(one.y)], id = one.sign_id;
    if (one.review === "missing" && Number.isFinite(x) && Number.isFinite(y)) missing.push({ ...about_it, ...anchor(x, y) });
    else if (byId.has(id) && ["accepted", "rejected", "edited"].includes(one.review) && ids.indexOf(id) === ids.lastIndexOf(id)) {
      said.set(id, { review: one.review, ...about_it });
    }
  }
}

function say(card, review) {
  const one = said.get(card.id);
  const again = one && one.review === review;
  if (again && review !== "edited") said.delete(card.id);
  else if (!again) said.set(card.id, { review, ...look(about.rows[card.id]), note: one ? one.note : "", reviewer: "" });
  remember();
  if (card.hidden) {  // by the filter: go on with the next one
    cards.slice(cards.indexOf(card)).concat(cards).find(other => !other.hidden)?.querySelector("a").focus();
  } else if (review === "edited") card.querySelector(".say input").focus();
}

function looks(values) {
  const part = made("span", { className: "looks", values }, at("looks").content.cloneNode(true));
  const fields = Array.from(part.querySelectorAll("[name]"));
  const fill = () => fields.forEach(field => { field.value = values[field.name] === "unknown" ? "" : values[field.name] || ""; });
  fill();
  part.addEventListener("change", ({ target }) => {
    values[target.name] = target.value.trim() || (target.name === "note" ? "" : "unknown");
    values.reviewer = "";
    const listed = target.name === "code" && Array.from(at("codes").options).find(option => option.value === target.value);
    if (listed) for (const name of ["color", "shape"]) values[name] = known(name, listed.dataset[name]) || values[name];
    fill();
    remember();
  });
  return part;
}

list.addEventListener("click", event => {
  const button = event.target.closest(".say > button");
  if (button) say(button.closest("li"), button.dataset.review);
});
const typing = event => /^(INPUT|SELECT)$/.test(event.target.tagName);
list.addEventListener("keydown", event => {
  if (typing(event) || event.ctrlKey || event.metaKey || event.altKey) return;
  const review = { a: "accepted", r: "rejected", e: "edited" }[event.key.toLowerCase()];
  if (review) { event.preventDefault(); say(event.target.closest("li"), review); }
});
addEventListener("keydown", event => {
  if ((event.ctrlKey || event.metaKey) && event.key === "z" && !typing(event)) { event.preventDefault(); undo(); }
});

const button = (words, onclick) => made("button", { type: "button", onclick }, words);

function draw() {
  for (const card of cards) {
    const one = said.get(card.id);
    card.dataset.review = one ? one.review : "";
    const bar = card.querySelector(".say");
    for (const one of bar.querySelectorAll("button")) one.setAttribute("aria-pressed", String(card.dataset.review === one.dataset.review));
    const form = bar.querySelector(".looks");
    const edited = card.dataset.review === "edited";
    if (form && (!edited || form.values !== one)) form.remove();
    if (edited && form?.values !== one) bar.append(looks(one));
  }
  at("missing").replaceChildren(...missing.map((one, i) => {
    const form = looks(one);
    form.append(button("Remove", () => { missing.splice(i, 1); remember(); }));
    return made("li", {}, "missing at x " + one.x.toFixed(1) + " m, y " + one.y.toFixed(1) + " m ", form);
  }));
  at("decide").hidden = !open().length;
  at("open").replaceChildren(...open().map(one => {
    const picture = one.picture ? made("img", { src: one.picture, alt: "as it was" }) : "";
    return made("li", {}, picture, one.words + " ", ...one.options.map(({ words, row }) => button(words, () => decide(one, row))));
  }));
  drawMissing();
  at("undo").disabled = !before.length;
  at("reviewed").textContent = said.size + " of " + cards.length + " reviewed, " + missing.length + " missing";
  show();
}

function decide(one, row) {
  decided.add(one.words);
  const { review, note, reviewer, x, y } = row || {};
  if (row && row.sign_id) said.set(row.sign_id, { review, ...look(row), note, reviewer });
  else if (row) missing.push({ ...look(row), note, reviewer, ...anchor(x, y) });
  remember();
}

// Places of missing signs: on the map, at a measure or station, or where the rays of several images meet

function drawMissing() {
  map?.querySelectorAll(".missing").forEach(dot => dot.remove());
  for (const { x, y } of map ? missing : []) {
    const dot = document.createElementNS(map.namespaceURI, "circle"), { turn, scale, left, top } = about.map;
    const cx = (x * turn[0][0] + y * turn[1][0] - left) * scale, cy = (top - x * turn[0][1] - y * turn[1][1]) * scale;
    for (const [name, value] of Object.entries({ class: "missing", cx, cy, r: 9 })) dot.setAttribute(name, value);
    map.append(dot);
  }
}

function anchor(x, y) {  // the place, also as seen from the nearest images: it is found again after another run
  const round = value => Math.round(value * 100) / 100;
  const away = one => Math.hypot(one.x - x, one.y - y);
  const seen = [...about.cameras].sort((a, b) => away(a) - away(b)).slice(0, 4).map(one => {
    const [u, v] = [one.turn[2], one.turn[5]], length = Math.hypot(u, v) || 1, dx = x - one.x, dy = y - one.y;
    return [one.image, round((dx * v - dy * u) / length), round((dx * u + dy * v) / length)];
  });
  return { x: round(x), y: round(y), seen };
}

function add(x, y) {
  missing.push({ ...look({}), note: "", reviewer: "", ...anchor(x, y) });
  remember();
}

function place(pageX, pageY) {
  const point = new DOMPoint(pageX, pageY).matrixTransform(map.getScreenCTM().inverse());
  const { turn, scale, left, top } = about.map;
  const u = point.x / scale + left, v = top - point.y / scale;
  adding(false);
  add(...turn.map(row => u * row[0] + v * row[1]));
}

function adding(on) {
  at("add").setAttribute("aria-pressed", String(on));
  map.classList.toggle("adding", on);
  if (on) map.scrollIntoView({ block: "nearest" });
}

function addAt(value, right) {
  const unit = Number(at("here").dataset.unit), of = one => one.measure ?? one.station_m / unit;
  const steps = about.cameras.slice(1).map((b, n) => {
    const a = about.cameras[n], dx = b.x - a.x, dy = b.y - a.y, length = Math.hypot(dx, dy), part = (value - of(a)) / (of(b) - of(a));
    return { a, dx, dy, length, part, beyond: Math.max(-part, part - 1, 0) * length };
  }).filter(one => one.beyond < 100);  // of what the last image shows, too
  if (!steps.length) throw new Error("the drive does not pass this place");
  const { a, dx, dy, length, part } = steps.reduce((one, other) => other.beyond < one.beyond ? other : one), away = right * unit / length;
  add(a.x + part * dx + away * dy, a.y + part * dy - away * dx);
}

function rayOf({ x, y, turn }, u, v) {  // across the ground, of a place in the image between 0 and 1
  const { width, height, fx, fy, cx, cy } = about.lens;
  const a = (u * width - 0.5 - cx) / fx, b = (v * height - 0.5 - cy) / fy;
  const dx = turn[0] * a + turn[1] * b + turn[2], dy = turn[3] * a + turn[4] * b + turn[5], length = Math.hypot(dx, dy);
  return { x, y, dx: dx / length, dy: dy / length };
}

function meet(rays) {  // least squares of the distances to all
  let [a, b, c, e, f] = [0, 0, 0, 0, 0];
  for (const { x, y, dx, dy } of rays) {
    a += dy * dy; b -= dx * dy; c += dx * dx;
    e += dy * (dy * x - dx * y); f -= dx * (dy * x - dx * y);
  }
  const whole = a * c - b * b, x = (c * e - b * f) / whole, y = (a * f - b * e) / whole;
  const ahead = rays.every(one => (x - one.x) * one.dx + (y - one.y) * one.dy > 0);
  if (!(whole > 1e-4) || !ahead) throw new Error("the rays do not meet: click the same sign in images farther apart");
  return [x, y];
}

let marks = new Map(), shown = 0;

function showImage(step) {
  shown = Math.min(Math.max(shown + step, 0), about.cameras.length - 1);
  at("view").src = waysideImages[shown];
  at("shown").textContent = "image " + (shown + 1) + " of " + about.cameras.length + ", " + marks.size + " marked";
  at("mark").hidden = !marks.has(shown);
  const { u, v } = marks.get(shown) || { u: 0, v: 0 };
  Object.assign(at("mark").style, { left: 100 * u + "%", top: 100 * v + "%" });
}

function mark(u, v) {
  marks.set(shown, { u, v });
  showImage(0);
  if (marks.size < 2) return;
  try {
    add(...meet(Array.from(marks, ([n, one]) => rayOf(about.cameras[n], one.u, one.v))));
    at("images").hidden = true;
  } catch (error) { at("shown").textContent = error.message; marks.delete(shown); }
}

function openImages() {
  marks = new Map();
  at("images").hidden = false;
  if (typeof waysideImages !== "undefined") return showImage(0);
  return new Promise(done => {
    const onload = () => done(showImage(0)), onerror = () => done(at("shown").textContent = "images.js is not next to this page");
    document.body.append(made("script", { src: "images.js", onload, onerror }));
  });
}

at("add").hidden = !map;
at("add").addEventListener("click", () => adding(!map.classList.contains("adding")));
map?.addEventListener("click", event => {
  if (map.classList.contains("adding")) { event.preventDefault(); place(event.clientX, event.clientY); }
});
at("here").addEventListener("submit", event => {
  event.preventDefault();
  try { addAt(Number(at("measure").value), Number(at("right").value)); } catch (error) { at(told).textContent = error.message; }
});
at("onimage").hidden = !about.lens;
at("onimage").addEventListener("click", openImages);
at("back").addEventListener("click", () => showImage(-1));
at("on").addEventListener("click", () => showImage(1));
at("close").addEventListener("click", () => { at("images").hidden = true; });
at("view").addEventListener("click", event => {
  const edge = at("view").getBoundingClientRect();
  mark((event.clientX - edge.left) / edge.width, (event.clientY - edge.top) / edge.height);
});
at("undo").addEventListener("click", undo);

// Files

const asJson = () => JSON.stringify({ wayside_review: 1, log: about.log, result: about.result, reviews: rows() }, null, 1) + "\n";

function read(name, text) {
  const whole = JSON.parse(text), results = [whole.result, ...whole.reviews.map(one => one.result)].filter(Boolean);
  if (results.length && !results.includes(about.result)) {
    throw new Error("it is from another result; save it to the folder of this one and run `wayside evidence` again");
  }
  take(whole);
  at("reviewer").value = whole.reviewer || at("reviewer").value;
  remember();
}

function others() {  // work on this drive that this browser keeps: of earlier results
  try { return Object.keys(localStorage).filter(key => key.startsWith(prefix) && key !== store); } catch { return []; }
}

at("others").hidden = !others().length;
at("others").addEventListener("click", () => others().forEach((key, i) => {
  const whole = { log: about.log, result: key.slice(prefix.length).split(" ")[0], ...JSON.parse(localStorage.getItem(key)) };
  save("review." + (i + 1) + ".json", JSON.stringify(whole), "application/json");
}));
at("json").addEventListener("click", () => save("review.json", asJson(), "application/json"));
take(about);
recall();
state = snapshot();
draw();
at("fold").addEventListener("click", () => at("fold").setAttribute("aria-expanded", String(!form.classList.toggle("folded"))));
form.hidden = at("review").hidden = false;
if (map) zoomable(map, about.map);
fromAddress();
