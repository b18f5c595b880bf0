// Ties the page together: what is shown, which map, which point.

const byId = (id) => document.getElementById(id);
const other = (side) => (side === "source" ? "target" : "source");
const shown = { colouring: "position", map: 0, function: 2, stage: "after", pinned: null };
const views = {};
/** On the longest side of the target. */
const CHECKER_SQUARES = 24;

const mapValues = (direction) => arrayValues(`map-${shown.map}-${direction}`);

/** The vertex on the other shape that the shown map gives, or -1. */
const matchOf = (side, vertex) => mapValues(side === "source" ? "target-of-source" : "source-of-target")[vertex];

/** Colours of vertices taken from the other shape by a map. */
function carried(colours, map) {
  const result = new Uint8Array(3 * map.length);
  map.forEach((vertex, i) => {
    for (let channel = 0; channel < 3; channel += 1) {
      result[3 * i + channel] = vertex < 0 ? facts.unmatched[channel] : colours[3 * vertex + channel];
    }
  });
  return result;
}

/** Colours with those of vertices that the shown map gives no match greyed. */
function greyed(colours, map) {
  if (!map.includes(-1)) return colours;
  const result = Uint8Array.from(colours);
  map.forEach((vertex, i) => { if (vertex < 0) result.set(facts.unmatched, 3 * i); });
  return result;
}

/** Colours of byte values on a ramp. */
function levelled(levels, ramp) {
  const table = rampTable(ramp);
  const result = new Uint8Array(3 * levels.length);
  levels.forEach((level, i) => result.set(table.subarray(3 * level, 3 * level + 3), 3 * i));
  return result;
}

/** Squares on the target as seen from the front, and where the map lays them on the source; two coordinates a vertex. */
function checkerPlaces() {
  const { positions } = views.target;
  const size = facts.target.span / CHECKER_SQUARES;
  const target = Float32Array.from({ length: (2 * positions.length) / 3 }, (_, i) => positions[3 * (i >> 1) + (i & 1)] / size);
  const map = mapValues("target-of-source");
  const source = Float32Array.from({ length: 2 * map.length }, (_, i) => target[2 * Math.max(map[i >> 1], 0) + (i & 1)]);
  return { source, target };
}

function distortionColours() {
  const values = arrayValues("distortion");
  const [low, high] = [distortionRank.quantile(0.02), distortionRank.quantile(0.98)];
  const place = (value) => Math.min(1, Math.max(0, (value - low) / (high - low || 1)));
  const levels = Uint8Array.from(values, (value) => Math.round(255 * place(value)));
  const source = levelled(levels, "amount");
  return { source, target: carried(source, arrayValues("map-0-source-of-target")), low, high };
}

const distortionRank = {
  prepare() { this.sorted = Float32Array.from(arrayValues("distortion")).sort(); },
  quantile(share) { return this.sorted[Math.min(this.sorted.length - 1, Math.floor(share * this.sorted.length))]; },
  /** Share of the vertices with less distortion. */
  below(value) {
    let [low, high] = [0, this.sorted.length];
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.sorted[middle] < value) low = middle + 1; else high = middle;
    }
    return low / this.sorted.length;
  },
};

function functionColours(side) {
  const { values, shape } = loadedArrays.get(`${side}-${shown.stage}`);
  const row = values.subarray((shown.function - 1) * shape[1], shown.function * shape[1]);
  return levelled(row, "signed");
}

function paint() {
  let source;
  let target;
  let legend = null;
  const checkered = shown.colouring === "checkered";
  if (checkered || shown.colouring === "position") {
    const places = arrayValues("colours");
    source = carried(places, mapValues("target-of-source"));
    target = greyed(places, mapValues("source-of-target"));
  } else if (shown.colouring === "distortion") {
    const colours = distortionColours();
    source = greyed(colours.source, mapValues("target-of-source"));
    target = greyed(colours.target, mapValues("source-of-target"));
    legend = ["amount", `${readable(colours.low)} and less`, `${readable(colours.high)} and more`];
  } else if (shown.colouring === "function") {
    [source, target] = [functionColours("source"), functionColours("target")];
    legend = ["signed", "negative", "positive"];
  } else {
    const plain = (side) => new Uint8Array(3 * facts[side].vertices).fill(205);
    [source, target] = [plain("source"), plain("target")];
  }
  const places = checkered ? checkerPlaces() : {};
  views.source.check(places.source);
  views.target.check(places.target);
  views.source.paint(source);
  views.target.paint(target);
  showLegend(legend);
  showAgreement();
}

function showLegend(legend) {
  const box = byId("legend");
  box.hidden = legend === null;
  if (legend === null) return;
  const [ramp, low, high] = legend;
  const canvas = make("canvas", { width: 256, height: 1, "aria-hidden": "true" });
  const context = canvas.getContext("2d");
  const pixels = context.createImageData(256, 1);
  for (let i = 0; i < 256; i += 1) pixels.data.set([...rampColour(ramp, i / 255), 255], 4 * i);
  context.putImageData(pixels, 0, 0);
  box.replaceChildren(low, canvas, high);
  if (shown.colouring === "distortion") box.append(make("span", { class: "quiet" }, "local distortion of the chosen map"));
}

function showAgreement() {
  byId("function-controls").hidden = shown.colouring !== "function";
  const { available, shown: count, agreement } = facts.functions;
  const value = (stage) => fixed(agreement[stage][shown.function - 1]);
  const rest = count < available ? `; the page holds the first ${count} of ${available}` : "";
  byId("agreement").textContent = `agreement across the chosen map: ${value("before")} before, ${value("after")} after${rest}`;
}

/** A chosen pair: the vertex pointed at and its match, by side; -1 where there is none. */
const pairAt = (side, vertex) => ({ from: side, [side]: vertex, [other(side)]: matchOf(side, vertex) });

function describePair(pair) {
  const number = (side, vertex) => (vertex < 0 ? "no match" : `vertex ${arrayValues(`${side}-numbers`)[vertex]}`);
  const box = byId("readout");
  const to = other(pair.from);
  box.dataset.source = pair.source < 0 ? "" : arrayValues("source-numbers")[pair.source];
  box.dataset.target = pair.target < 0 ? "" : arrayValues("target-numbers")[pair.target];
  const line = make("p", {}, `${pair.from} `, make("b", {}, number(pair.from, pair[pair.from])), ` → ${to} `,
    make("b", {}, number(to, pair[to])));
  const details = [];
  if (pair.source >= 0) {
    const distortion = arrayValues("distortion")[pair.source];
    const worse = Math.round(100 * distortionRank.below(distortion));
    details.push(`local distortion ${readable(distortion)} √area (more than at ${worse} % of the vertices)`);
  }
  if (pair[to] >= 0) {
    const back = matchOf(to, pair[to]);
    if (back >= 0) details.push(`there and back: ${readable(lengthBetween(pair.from, back, pair[pair.from]))} √area away`);
  }
  box.replaceChildren(line, make("p", { class: "quiet" }, details.join(" · ")));
}

function lengthBetween(side, a, b) {
  const { positions } = views[side];
  return Math.hypot(...[0, 1, 2].map((axis) => positions[3 * a + axis] - positions[3 * b + axis]));
}

function mark(kind, pair) {
  for (const side of ["source", "target"]) views[side].setMark(kind, pair ? pair[side] : -1);
}

function hover(side, vertex) {
  const pair = vertex < 0 ? null : pairAt(side, vertex);
  mark("hovered", pair);
  if (pair) describePair(pair);
  else if (shown.pinned) describePair(shown.pinned);
  else forget();
}

function pin(side, vertex) {
  shown.pinned = vertex < 0 ? null : pairAt(side, vertex);
  mark("pinned", shown.pinned);
  mark("hovered", null);
  byId("unpin").disabled = shown.pinned === null;
  if (shown.pinned) describePair(shown.pinned); else forget();
}

function forget() {
  const box = byId("readout");
  delete box.dataset.source;
  delete box.dataset.target;
  box.textContent = "No point chosen.";
}

function chooseMap(rank) {
  shown.map = rank;
  byId("map").value = String(rank);
  if (shown.pinned) pin(shown.pinned.from, shown.pinned[shown.pinned.from]);
  showLandmarks();
  paint();
}

function chooseFunction(text) {
  const number = Math.round(Number(text));
  if (!Number.isFinite(number)) return;
  shown.function = Math.min(facts.functions.shown, Math.max(1, number));
  byId("function-slider").value = String(shown.function);
  byId("function").value = String(shown.function);
  paint();
}

function lookUp(event) {
  event.preventDefault();
  const wanted = Number(byId("lookup-number").value);
  const vertex = byId("lookup-number").value === "" ? -1 : arrayValues("source-numbers").indexOf(wanted);
  pin("source", vertex);
  if (vertex < 0) byId("readout").textContent = `The source has no vertex ${byId("lookup-number").value} on its surface.`;
}

function connectControls() {
  const colouring = byId("colouring");
  if (!facts.functions.shown) colouring.querySelector('[value="function"]').remove();
  colouring.addEventListener("change", () => { shown.colouring = colouring.value; paint(); });
  facts.maps.forEach((map, rank) => byId("map").append(make("option", { value: rank }, map.label)));
  byId("map-control").hidden = facts.maps.length === 1;
  byId("map").addEventListener("change", (event) => chooseMap(Number(event.target.value)));
  for (const id of ["function", "function-slider"]) {
    byId(id).max = String(facts.functions.shown);
    byId(id).addEventListener("input", (event) => { if (event.target.value !== "") chooseFunction(event.target.value); });
  }
  for (const radio of document.querySelectorAll('input[name="aligned"]')) {
    radio.addEventListener("change", () => { shown.stage = radio.value; paint(); });
  }
  byId("together").addEventListener("change", (event) => { if (event.target.checked) views.target.follow(views.source.pose); });
  byId("front").addEventListener("click", () => Object.values(views).forEach((view) => view.frontView()));
  byId("controls").addEventListener("submit", (event) => event.preventDefault());
  byId("lookup").addEventListener("submit", lookUp);
  byId("unpin").addEventListener("click", () => pin("source", -1));
  byId("lookup-number").max = String(arrayValues("source-numbers").at(-1));
}

function openViews() {
  const halves = ["source", "target"].map((side) => {
    const positions = arrayValues(`${side}-positions`);
    const most = [0, 0, 0];
    for (let i = 0; i < positions.length; i += 1) most[i % 3] = Math.max(most[i % 3], positions[i]);
    return most.map((value) => (value / 65535) * facts[side].span / 2);
  });
  const frame = [0, 1, 2].map((axis) => Math.max(halves[0][axis], halves[1][axis]));
  for (const side of ["source", "target"]) {
    const view = new ShapeView(byId(`canvas-${side}`), side, frame);
    view.turned = () => { if (byId("together").checked) views[other(side)]?.follow(view.pose); };
    view.hovered = (vertex) => hover(side, vertex);
    view.clicked = (vertex) => (landmarks.active ? markLandmark(side, vertex) : pin(side, vertex));
    view.cleared = () => (landmarks.active ? forgetOpenLandmark() : pin(side, -1));
    views[side] = view;
    view.canvas.setAttribute("aria-label", `${side} ${facts[side].name}`);
    byId(`caption-${side}`).textContent = `${facts[side].name} · ${grouped(facts[side].vertices)} vertices`;
  }
}

function showFailure(message) {
  byId("failure").textContent = message;
  byId("failure").hidden = false;
  byId("fallback").hidden = false;
  byId("stage").hidden = true;
  byId("match-hint").hidden = true;
}

async function start() {
  fillHead();
  fillHistory();
  fillError();
  fillMade();
  try {
    await loadArrays();
  } catch (error) {
    showFailure(`The arrays of this page cannot be read (${error.message}); the file may be damaged, or the browser older than 2023.`);
    return;
  }
  distortionRank.prepare();
  fillTrust(arrayValues("distortion"));
  fillMatrices();
  fillAlternatives(chooseMap);
  try {
    openViews();
  } catch (error) {
    showFailure(`This browser offers no WebGL, which the 3D view needs (${error.message}). A picture stands in for it; everything below still works.`);
    return;
  }
  connectControls();
  connectLandmarks();
  chooseFunction(2);
  document.documentElement.dataset.ready = "yes";
}

start();
