// The parts of the page below the 3D view.

const HISTORY_NAMES = {
  total: "total (weighted sum)", align: "alignment (Eq. 21)", unsup: "distances (Eq. 22)", cycle: "cycle (Eq. 31)",
  unitarity: "unitarity of R (Eq. 23)",
};

function fillHead() {
  const keys = [
    ["confidence", `${fixed(facts.confidence)} of 1`],
    ["orientation kept", fixed(facts.orientation)],
    ["vertices", `${grouped(facts.source.vertices)} → ${grouped(facts.target.vertices)}`],
    ["time", `${readable(totalTime())} s`],
  ];
  if (facts.evaluation) keys.splice(2, 0, ["mean error × 100", readable(100 * facts.evaluation.mean)]);
  const list = document.getElementById("key-facts");
  for (const [name, value] of keys) list.append(make("div", {}, make("dt", {}, name), make("dd", {}, value)));
  const warnings = facts.warnings;
  if (warnings.length) {
    const box = document.getElementById("warnings");
    box.hidden = false;
    box.append(make("b", {}, warnings.length === 1 ? "One warning" : `${warnings.length} warnings`));
    box.append(make("ul", {}, ...warnings.map((text) => make("li", {}, text))));
  }
}

const totalTime = () => facts.timings.total ?? Object.values(facts.timings).reduce((sum, value) => sum + (value ?? 0), 0);

function fillTrust(distortion) {
  const body = document.getElementById("trust-body");
  const sorted = Float32Array.from(distortion).sort();
  const quantile = (share) => readable(sorted[Math.min(sorted.length - 1, Math.floor(share * sorted.length))]);
  body.append(makeTable(null, [
    ["Confidence", fixed(facts.confidence), "0 to 1: by how much the chosen map beats the best different one."],
    ["Orientation", fixed(facts.orientation), "1: kept everywhere; −1: mirrored everywhere. Near 0 the map is doubtful."],
    ["Local distortion", `median ${quantile(0.5)}, 95 % below ${quantile(0.95)}`,
      "Mean change, in √area, of the geodesic distances from a vertex to points all over the shape; “local distortion” above shows where."],
    ...Object.entries(facts.losses).map(([name, value]) => [`Loss: ${HISTORY_NAMES[name] ?? name}`, readable(value, 4), ""]),
  ]));
  const notes = ["source", "target"].flatMap((side) => facts[side].notes.map((note) => `${facts[side].name}: ${note}`));
  if (notes.length) {
    body.append(make("h3", {}, "What was put right in the meshes"));
    body.append(make("ul", {}, ...notes.map((note) => make("li", {}, note))));
  }
}

/** The table of all maps with a button each; `choose(rank)` shows one. */
function fillAlternatives(choose) {
  const body = document.getElementById("alternatives-body");
  fillEquals(body);
  if (facts.maps.length === 1) {
    const asked = facts.options.search.alternatives > 0;
    body.append(make("p", { class: "hint" }, asked ? "The search found no map that differs from the chosen one."
      : "None were kept. The option search.alternatives (on the command line --alternatives N) keeps the N best maps "
      + "that differ from the chosen one."));
    return;
  }
  const rows = facts.maps.map((map, rank) => {
    const button = make("button", { type: "button", "aria-label": `Show ${map.label}` }, "Show");
    button.addEventListener("click", () => {
      choose(rank);
      document.getElementById("match").scrollIntoView({ behavior: "smooth" });
    });
    const name = map.relation ? make("span", {}, make("b", {}, map.label), make("br"), map.relation) : map.label;
    const buttons = make("span", { class: "buttons" }, button);
    if (rank) {
      const take = make("button", { type: "button", "aria-label": `Take ${map.label}` }, "This one");
      take.addEventListener("click", () => showWayTo(rank));
      buttons.append(" ", take);
    }
    return [name, readable(map.score), fixed(map.orientation), readable(map.distance), buttons];
  });
  const head = ["Map, and what it does that the chosen one does not", "Score (less is better)", "Orientation", "Mean distance to the chosen map", ""];
  body.append(makeTable(head, rows, [1, 2, 3]), make("div", { id: "way-to-map", role: "status", "aria-live": "polite" }));
}

/** Say which maps are as good as the chosen one. */
function fillEquals(body) {
  const equals = facts.equally_good;
  if (!equals.length) return;
  const many = equals.length === 1 ? "Another map is" : `${equals.length} other maps are`;
  body.append(make("p", {}, `${many} about as good as the chosen one, as between the symmetries of a shape. Which is meant, only you can say: `
    + "look at the colours, then take it below, or click a landmark above."));
  body.append(make("ul", { id: "equals" }, ...equals.map((each) => (
    make("li", {}, each.relation, each.alternative === null ? "" : ` (alternative ${each.alternative})`)))));
  const missing = equals.filter((each) => each.alternative === null).length;
  if (missing) body.append(commandBox(matchCommand(facts.options.search.orientation, "--alternatives", String(equals.length + facts.maps.length - 1))));
}

/** Write the commands that make an alternative the result, and that use it as it is. */
function showWayTo(rank) {
  const wanted = facts.options.search.orientation;
  const against = wanted !== "any" && (facts.maps[rank].orientation < 0) !== (wanted === "reversing");
  const orientation = against ? (wanted === "reversing" ? "preserving" : "reversing") : wanted;
  const folder = resultFolder();
  document.getElementById("way-to-map").replaceChildren(
    make("h3", {}, `Alternative ${rank} as the result`),
    make("p", { class: "hint" }, "Match again from this map:"),
    commandBox(matchCommand(orientation, "--start", folder, "--start-map", String(rank), "--out", `${folder}-map-${rank}`)),
    make("p", { class: "hint" }, "Or use it as it is; transfer, export, evaluate and register take --map:"),
    commandBox(["clalign", "transfer", folder, "labels", "FILE", "--out", "OUT", "--map", String(rank)].map(shellWord).join(" ")),
  );
}

function fillHistory() {
  const body = document.getElementById("history-body");
  const { outer_iteration: iteration, ...lines } = facts.history;
  if (!iteration.length || !Object.keys(lines).length) {
    body.append(make("p", { class: "hint" }, "The alignment made no outer iteration, so there is nothing to draw."));
    return;
  }
  const x = iteration.map((_, evaluation) => evaluation + 1);
  const marks = x.filter((_, i) => i > 0 && iteration[i] !== iteration[i - 1]).map((value) => value - 0.5);
  const charts = Object.entries(lines).map(([name, y]) => {
    const known = y.filter((value) => value !== null);
    const summary = `${name}: from ${readable(known[0], 4)} to ${readable(known[known.length - 1], 4)}`;
    return lineChart({ x, y, marks, caption: HISTORY_NAMES[name] ?? name, summary });
  });
  body.append(make("p", { class: "hint" }, `${x.length} evaluations in ${new Set(iteration).size} outer iterations; a dashed line `
    + "begins a new one: the map inside the losses is renewed and λ takes its next value, so the curves may jump there."));
  body.append(make("div", { class: "charts" }, ...charts));
}

function fillMatrices() {
  document.getElementById("matrices-body").append(
    matrixFigure({
      name: "R", title: "R, the rotation between the eigenfunctions", array: "rotation", rowMeaning: "row", columnMeaning: "column",
      explanation: "Near-diagonal and nearly orthogonal for a good match. Entries outside the band are zero by construction.",
    }),
    matrixFigure({
      name: "C", title: "C, the functional map", array: "functional-map", rowMeaning: "target function", columnMeaning: "source function",
      explanation: "Takes Laplace–Beltrami coefficients on the source to coefficients on the target. A funnel along the diagonal is what a near-isometry gives.",
    }),
  );
}

function fillError() {
  const found = facts.evaluation;
  if (!found) return;
  document.getElementById("error").hidden = false;
  const percent = found.share.map((share) => 100 * share);
  const rows = [
    ["Mean", `${readable(100 * found.mean)} × 0.01 √area`],
    ["Median", `${readable(100 * found.median)} × 0.01 √area`],
    ["Exactly the true vertex", `${readable(100 * found.exact)} %`],
    ["Area under the curve", readable(found.area_under_curve)],
    ["Points measured", `${grouped(found.points)} (${found.distances})`],
  ];
  if (found.mirrored_mean !== null) rows.splice(2, 0, ["Mean to the mirrored truth", `${readable(100 * found.mirrored_mean)} × 0.01 √area`]);
  document.getElementById("error-body").append(make("div", { class: "columns" },
    lineChart({
      x: found.threshold, y: percent, width: 480, height: 260, xRange: [0, 0.25], yRange: [0, 100],
      xLabel: "geodesic error in units of √area", caption: "Share of points (%) with at most that error",
      summary: `error curve; mean ${readable(found.mean)}, median ${readable(found.median)}`,
    }),
    makeTable(null, rows)));
}

function fillMade() {
  const longest = Math.max(...Object.values(facts.timings).map((value) => value ?? 0), 1e-9);
  const timings = Object.entries(facts.timings).map(([stage, seconds]) => {
    const bar = make("span", { class: "bar", style: `width: ${(8 * (seconds ?? 0)) / longest}rem` });
    return [stage, fixed(seconds), bar];
  });
  const options = Object.entries(facts.options).flatMap(([group, values]) => (
    values !== null && typeof values === "object"
      ? Object.entries(values).map(([name, value]) => [`${group}.${name}`, String(value) || "(empty)"])
      : [[group, String(values)]]));
  const describe = (side) => {
    const mesh = facts[side];
    return `${mesh.file ?? mesh.name}: ${grouped(mesh.vertices)} vertices, ${grouped(mesh.faces)} faces, unit length ${readable(mesh.scale, 4)} in the file`;
  };
  const made = document.getElementById("made-body");
  made.append(
    makeTable(null, [["Source", describe("source")], ["Target", describe("target")], ["Device", facts.device]]),
    make("div", { class: "columns" },
      make("div", {}, make("h3", {}, "Timings"), makeTable(["Stage", "Seconds", ""], timings, [1])),
      make("div", {}, make("h3", {}, "Versions"), makeTable(null, Object.entries(facts.versions)))),
    make("details", {}, make("summary", {}, `All ${options.length} options`), makeTable(["Option", "Value"], options)),
  );
}
