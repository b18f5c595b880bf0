// Command lines that repeat the match in another way.

/** A word as a shell takes it: in quotes unless it is plain. */
const shellWord = (word) => (/^[\w@%+=:,./-]+$/.test(word) ? word : `'${word.replaceAll("'", "'\\''")}'`);

/** The folder that this page lies in, if it was opened as a file. */
function resultFolder() {
  if (location.protocol !== "file:") return "RESULT";
  const folder = decodeURIComponent(location.pathname).replace(/\/[^/]*$/, "");
  return folder.replace(/^\/([A-Za-z]:)/, "$1") || "/";
}

/** "clalign match …" for the same files and options, with further words. */
function matchCommand(orientation, ...words) {
  const files = ["source", "target"].map((side) => facts[side].path ?? side.toUpperCase());
  const changes = facts.changed.flatMap((change) => ["--set", change]);
  const turned = orientation === "preserving" ? [] : ["--orientation", orientation];
  return ["clalign", "match", ...files, ...changes, ...turned, ...words].map(shellWord).join(" ");
}

/** A command in a box, with a button that copies it. */
function commandBox(text) {
  const code = make("code", { tabindex: "0" }, text);
  const button = make("button", { type: "button" }, "Copy");
  button.addEventListener("click", () => {
    const range = document.createRange();
    range.selectNodeContents(code);
    const selection = getSelection();
    selection.removeAllRanges();
    selection.addRange(range);
    button.textContent = document.execCommand("copy") ? "Copied" : "Selected";
  });
  return make("div", { class: "command" }, code, button);
}
