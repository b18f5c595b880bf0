// Line charts as SVG and matrices as pixels.

const SVG = "http://www.w3.org/2000/svg";

function makeSvg(tag, attributes, text) {
  const element = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  if (text !== undefined) element.textContent = text;
  return element;
}

/** Round numbers that divide [low, high] into three to six parts. */
function ticks(low, high) {
  const rough = (high - low) / 5.5 || 1;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((factor) => factor * power).find((candidate) => candidate >= rough);
  const found = [];
  for (let tick = Math.ceil(low / step - 1e-9) * step; tick <= high + 1e-9 * step; tick += step) found.push(tick);
  return found;
}

/**
 * A figure with one line.
 * @param {{x: number[], y: (number|null)[], caption: string, summary: string, width?: number, height?: number,
 *   xRange?: number[], yRange?: number[], marks?: number[], xLabel?: string}} chart
 */
function lineChart({ x, y, caption, summary, width = 300, height = 150, xRange, yRange, marks = [], xLabel }) {
  const known = y.filter((value) => value !== null);
  const [left, right, top, bottom] = [46, 8, 8, xLabel ? 34 : 20];
  const [xLow, xHigh] = xRange ?? [x[0], x[x.length - 1]];
  let [yLow, yHigh] = yRange ?? [Math.min(...known), Math.max(...known)];
  if (yLow === yHigh) [yLow, yHigh] = [yLow - Math.abs(yLow || 1) * 0.05, yHigh + Math.abs(yHigh || 1) * 0.05];
  const across = (value) => left + ((value - xLow) / (xHigh - xLow || 1)) * (width - left - right);
  const upward = (value) => height - bottom - ((value - yLow) / (yHigh - yLow)) * (height - top - bottom);
  const svg = makeSvg("svg", { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": summary });
  for (const tick of ticks(yLow, yHigh)) {
    svg.append(makeSvg("line", { class: "axis", x1: left, x2: width - right, y1: upward(tick), y2: upward(tick) }));
    svg.append(makeSvg("text", { x: left - 5, y: upward(tick) + 4, "text-anchor": "end" }, readable(tick)));
  }
  for (const tick of ticks(xLow, xHigh)) {
    svg.append(makeSvg("text", { x: across(tick), y: height - bottom + 14, "text-anchor": "middle" }, readable(tick)));
  }
  for (const mark of marks) {
    svg.append(makeSvg("line", { class: "round", x1: across(mark), x2: across(mark), y1: top, y2: height - bottom }));
  }
  if (xLabel) svg.append(makeSvg("text", { x: (left + width - right) / 2, y: height - 4, "text-anchor": "middle" }, xLabel));
  const points = x.flatMap((value, i) => (y[i] === null ? [] : [`${across(value).toFixed(1)},${upward(y[i]).toFixed(1)}`]));
  svg.append(makeSvg("polyline", { class: "line", points: points.join(" ") }));
  if (points.length === 1) {
    const [cx, cy] = points[0].split(",");
    svg.append(makeSvg("circle", { class: "dot", cx, cy, r: 3 }));
  }
  return make("figure", { class: "chart" }, svg, make("figcaption", {}, caption));
}

/** A picture of a matrix, blue below and red above zero, that tells the entry under the pointer. */
function matrixFigure({ name, title, explanation, array, rowMeaning, columnMeaning }) {
  const { values, shape } = loadedArrays.get(array);
  const [rows, columns] = shape;
  const canvas = make("canvas", { width: columns, height: rows, role: "img" });
  const largest = values.reduce((most, value) => Math.max(most, Math.abs(value)), 0) || 1;
  canvas.setAttribute("aria-label", `${title}: ${rows} rows, ${columns} columns, largest entry ${readable(largest)}`);
  const table = rampTable("signed");
  const context = canvas.getContext("2d");
  const pixels = context.createImageData(columns, rows);
  for (let i = 0; i < values.length; i += 1) {
    // The square root lets entries of a few per cent of the largest still be seen.
    const shown = Math.sign(values[i]) * Math.sqrt(Math.abs(values[i]) / largest);
    const level = 3 * Math.round(127.5 + 127.5 * shown);
    pixels.data.set([table[level], table[level + 1], table[level + 2], 255], 4 * i);
  }
  context.putImageData(pixels, 0, 0);
  const idle = `${rows} × ${columns}; largest entry ${readable(largest)}. Colours show the signed square root.`;
  const output = make("output", {}, idle);
  canvas.addEventListener("pointermove", (event) => {
    const row = Math.min(rows - 1, Math.max(0, Math.floor((event.offsetY / canvas.clientHeight) * rows)));
    const column = Math.min(columns - 1, Math.max(0, Math.floor((event.offsetX / canvas.clientWidth) * columns)));
    const value = readable(values[row * columns + column]);
    output.textContent = `${name} at ${rowMeaning} ${row + 1}, ${columnMeaning} ${column + 1}: ${value}`;
  });
  canvas.addEventListener("pointerleave", () => { output.textContent = idle; });
  return make("figure", { class: "matrix" }, make("h3", {}, title), make("p", { class: "quiet" }, explanation), canvas, output);
}
