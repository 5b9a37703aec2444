// A map that zooms: by wheel, two fingers or buttons about a point, and moves with the pointer; `about` is that of its page
function zoomable(map, about) {
  const whole = map.getAttribute("viewBox").split(" ").map(Number), tiles = map.querySelector(".tiles"), foot = map.querySelector(".foot");
  const buttons = map.parentNode.querySelector(".zoom"), base = buttons.querySelector("select");
  const down = new Map();
  let view = whole.slice(), moved = 0, unit = 1;
  const inside = (x, y) => new DOMPoint(x, y).matrixTransform(map.getScreenCTM().inverse());

  function show() {
    map.setAttribute("viewBox", view.join(" "));
    unit = 1 / map.getScreenCTM().a;  // of the map, a pixel of the screen
    map.style.setProperty("--unit", unit);
    map.classList.toggle("free", view[2] < whole[2]);
    const size = map.getBoundingClientRect(), corner = inside(size.left, size.bottom), far = inside(size.right, size.bottom);
    const most = 0.3 * size.width * unit / about.scale / about.unit, power = 10 ** Math.floor(Math.log10(most));
    const length = [5, 2, 1].find(step => step * power <= most) * power, bar = length * about.unit * about.scale / unit;
    foot.setAttribute("transform", "translate(" + corner.x + "," + corner.y + ") scale(" + unit + ")");
    foot.querySelector("path").setAttribute("d", "M16,-26v5H" + (16 + bar) + "v-5");
    const [words, north] = foot.querySelectorAll("text"), needle = foot.querySelector(".needle"), right = (far.x - corner.x) / unit - 16;
    words.textContent = Number(length.toPrecision(1)) + " " + about.units;
    for (const [text, x] of [[words, 26 + bar], [north, right - (needle ? 24 : 0)]]) { text.setAttribute("x", x); text.setAttribute("y", -16); }
    needle?.setAttribute("transform", "translate(" + (right - 8) + ",-22)");
    drawTiles(inside(size.left, size.top), far);
  }

  function drawTiles({ x: left, y: top }, { x: right, y: bottom }) {  // Web Mercator: tile column and row from degrees, and back
    tiles.replaceChildren();
    if (!base.value) return;
    const [east, north] = about.steps, level = Math.min(base.selectedOptions[0].dataset.most, Math.round(Math.log2(360 / 256 / east / unit))), count = 2 ** level;
    const column = x => (about.lon + x * east + 180) / 360 * count, x = column => (column / count * 360 - 180 - about.lon) / east;
    const row = y => (1 - Math.asinh(Math.tan((about.lat - y * north) * Math.PI / 180)) / Math.PI) / 2 * count;
    const y = row => (about.lat - Math.atan(Math.sinh(Math.PI * (1 - 2 * row / count))) * 180 / Math.PI) / north;
    for (let i = Math.floor(column(left)); i <= column(right); i++) for (let j = Math.floor(row(top)); j <= row(bottom); j++) {
      const tile = document.createElementNS(map.namespaceURI, "image");
      const href = base.value.replace("{z}", level).replace("{x}", i).replace("{y}", j);
      const place = { href, x: x(i), y: y(j), width: x(i + 1) - x(i), height: y(j + 1) - y(j), preserveAspectRatio: "none" };
      for (const [name, value] of Object.entries(place)) tile.setAttribute(name, value);
      tiles.append(tile);
    }
  }

  function zoom(factor, { x, y }) {
    const wide = Math.min(whole[2], Math.max(whole[2] / 500, view[2] * factor)), by = wide / view[2];
    view = by * view[2] >= whole[2] ? whole.slice() : [x + (view[0] - x) * by, y + (view[1] - y) * by, wide, view[3] * by];
    show();
  }

  map.addEventListener("wheel", event => {
    if (event.deltaY > 0 && view[2] >= whole[2]) return;  // the page scrolls on
    event.preventDefault();
    zoom(event.deltaY > 0 ? 1.25 : 0.8, inside(event.clientX, event.clientY));
  }, { passive: false });
  map.addEventListener("pointerdown", event => { if (!down.size) moved = 0; down.set(event.pointerId, event); });
  addEventListener("pointermove", event => {
    const before = down.get(event.pointerId);
    if (!before) return;
    const other = Array.from(down.values()).find(one => one.pointerId !== event.pointerId);
    moved += Math.hypot(event.clientX - before.clientX, event.clientY - before.clientY);
    down.set(event.pointerId, event);
    if (other) {
      const apart = one => Math.max(20, Math.hypot(one.clientX - other.clientX, one.clientY - other.clientY));
      zoom(apart(before) / apart(event), inside((event.clientX + other.clientX) / 2, (event.clientY + other.clientY) / 2));
    } else if (view[2] < whole[2]) {
      view[0] -= (event.clientX - before.clientX) * unit;
      view[1] -= (event.clientY - before.clientY) * unit;
      show();
    }
  });
  for (const end of ["pointerup", "pointercancel"]) addEventListener(end, event => down.delete(event.pointerId));
  map.addEventListener("click", event => {  // of a drag: no click on what lies below
    if (moved > 8) { event.preventDefault(); event.stopImmediatePropagation(); }
  }, true);
  map.addEventListener("dragstart", event => event.preventDefault());
  for (const button of buttons.querySelectorAll("button")) button.addEventListener("click", () => {
    const size = map.getBoundingClientRect(), factor = Number(button.dataset.zoom) || Infinity;
    zoom(factor, inside(size.left + size.width / 2, size.top + size.height / 2));
  });
  base.addEventListener("change", show);
  addEventListener("resize", show);
  buttons.hidden = false;
  base.hidden = !about.steps;
  show();
}
