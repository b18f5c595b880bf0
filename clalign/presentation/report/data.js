"use strict";
// Facts and arrays out of the page, numbers as text, colours of values.

const facts = JSON.parse(document.getElementById("facts").textContent);
const ARRAY_TYPES = { Uint8Array, Uint16Array, Uint32Array, Int32Array, Float32Array };
const loadedArrays = new Map();

/** Decode every array of the page (base64 of deflated little-endian numbers) into `loadedArrays`. */
async function loadArrays() {
  for (const element of document.querySelectorAll('script[id^="array-"]')) {
    const packed = Uint8Array.from(atob(element.textContent), (letter) => letter.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    const bytes = await new Response(stream).arrayBuffer();
    const values = new ARRAY_TYPES[element.dataset.type](bytes);
    const shape = element.dataset.shape.split(",").map(Number);
    loadedArrays.set(element.id.slice("array-".length), { values, shape });
    element.remove();
  }
}

const arrayValues = (name) => loadedArrays.get(name).values;

/** A number for people: three significant digits, no exponent for usual sizes, an en dash for none. */
function readable(value, digits = 3) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size >= 1e5 || size < 1e-3) return value.toExponential(digits - 1).replace("e-", "e−").replace("e+", "e");
  return Number(value.toPrecision(digits)).toString().replace("-", "−");
}

/** Two decimals, for numbers of a known size. */
const fixed = (value) => (Number.isFinite(value) ? value.toFixed(2).replace("-", "−") : "–");

const grouped = (count) => Number(count).toLocaleString("en-GB");

/** The colour (0 to 255 a channel) of `place` in [0, 1] on one of the ramps "signed" and "amount". */
function rampColour(name, place) {
  const stops = facts.ramps[name];
  const at = Math.min(Math.max(place, 0), 1) * (stops.length - 1);
  const lower = Math.min(Math.floor(at), stops.length - 2);
  return stops[lower].map((value, channel) => value + (at - lower) * (stops[lower + 1][channel] - value));
}

/** 256 colours of a ramp, for byte values. */
function rampTable(name) {
  const table = new Uint8Array(3 * 256);
  for (let level = 0; level < 256; level += 1) table.set(rampColour(name, level / 255).map(Math.round), 3 * level);
  return table;
}

/** Make an element: `make("td", { class: "number" }, "12")`; text never becomes markup. */
function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}

/** A table from a head and rows of text, numbers or elements; columns named in `numeric` are right-aligned. */
function makeTable(head, rows, numeric = []) {
  const kind = (column) => (numeric.includes(column) ? { class: "number" } : { class: "wrap" });
  const body = rows.map((row) => make("tr", {}, ...row.map((cell, column) => make("td", kind(column), cell))));
  const table = make("table", {}, make("tbody", {}, ...body));
  if (head) {
    const cells = head.map((cell, column) => make("th", { ...kind(column), scope: "col" }, cell));
    table.prepend(make("thead", {}, make("tr", {}, ...cells)));
  }
  return make("div", { class: "scroll" }, table);
}
