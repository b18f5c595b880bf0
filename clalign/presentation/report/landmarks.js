// Landmarks: pairs of points that a user clicks, listed, saved, and used by a command.

const LANDMARK_COLOURS = [0xd4145a, 0x1d6a8c, 0x2e8b57, 0xb8860b, 0x7b3fa0, 0xc0561f, 0x3a5fcd, 0x5a5a5a];
const landmarks = { pairs: [], open: { source: -1, target: -1 }, active: false };

const fileNumber = (side, vertex) => arrayValues(`${side}-numbers`)[vertex];

/** Take a click on a vertex while landmarks are being marked; the second shape completes a pair. */
function markLandmark(side, vertex) {
  if (vertex < 0) return;
  landmarks.open[side] = vertex;
  const { source, target } = landmarks.open;
  if (source >= 0 && target >= 0) {
    landmarks.pairs.push({ source, target });
    landmarks.open = { source: -1, target: -1 };
  }
  showLandmarks();
}

function forgetOpenLandmark() {
  landmarks.open = { source: -1, target: -1 };
  showLandmarks();
}

function landmarkFile() {
  const rows = landmarks.pairs.map(({ source, target }, i) => `p${i + 1},${fileNumber("source", source)},${fileNumber("target", target)}`);
  return ["name,source,target", ...rows, ""].join("\n");
}

function showLandmarks() {
  const { pairs, open, active } = landmarks;
  for (const side of ["source", "target"]) {
    const shownPoints = pairs.map((pair, i) => ({ vertex: pair[side], colour: LANDMARK_COLOURS[i % LANDMARK_COLOURS.length] }));
    if (open[side] >= 0) shownPoints.push({ vertex: open[side], colour: LANDMARK_COLOURS[pairs.length % LANDMARK_COLOURS.length] });
    views[side].setLandmarks(shownPoints);
  }
  const waiting = open.source >= 0 ? "target" : open.target >= 0 ? "source" : null;
  byId("landmark-state").textContent = !active ? ""
    : waiting ? `Now click the same point on the ${waiting}; Escape forgets the first one.` : "Click a point on either shape.";
  const rows = pairs.map((pair, i) => {
    const swatch = make("span", { class: "swatch", style: `background: #${LANDMARK_COLOURS[i % LANDMARK_COLOURS.length].toString(16).padStart(6, "0")}` });
    const image = matchOf("source", pair.source);
    const off = image < 0 ? "no match" : `${readable(lengthBetween("target", image, pair.target))} √area`;
    const button = make("button", { type: "button", "aria-label": `Remove p${i + 1}` }, "Remove");
    button.addEventListener("click", () => { pairs.splice(i, 1); showLandmarks(); });
    return [make("span", {}, swatch, ` p${i + 1}`), String(fileNumber("source", pair.source)),
      String(fileNumber("target", pair.target)), off, button];
  });
  const head = ["", "Source vertex", "Target vertex", "The shown map is off by", ""];
  byId("landmark-list").replaceChildren(...(rows.length ? [makeTable(head, rows, [1, 2, 3])] : []));
  byId("landmark-use").hidden = !rows.length;
  const command = matchCommand(facts.options.search.orientation, "--landmarks", "landmarks.csv", "--out", `${resultFolder()}-landmarks`);
  byId("landmark-command").replaceChildren(commandBox(command));
}

function saveLandmarks() {
  const link = make("a", { download: "landmarks.csv" });
  link.href = URL.createObjectURL(new Blob([landmarkFile()], { type: "text/csv" }));
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

function connectLandmarks() {
  byId("marking").addEventListener("change", (event) => {
    landmarks.active = event.target.checked;
    forgetOpenLandmark();
  });
  byId("landmark-save").addEventListener("click", saveLandmarks);
  byId("landmark-clear").addEventListener("click", () => { landmarks.pairs.length = 0; forgetOpenLandmark(); });
  showLandmarks();
}
