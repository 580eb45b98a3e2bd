"use strict";
// A test sequence: a list of steps, checked by the server and run as a schedule.

const COMMAND_NAMES = ["arm", "take-off", "hold", "mission", "return", "land", "disarm"];
const COMMAND_TIMEOUT_S = 10; // a button's command is repeated until it is accepted, at most for this long
const CHECK_MS = 300;
let allowed = { commands: false, sequences: null }, steps = [], checkTimer = 0, checkNumber = 0, phases = [];

// -- a step -------------------------------------------------------------------------------------

// A row for one entry of a schedule: its start can be edited, the rest is kept.
class Step {
  constructor({ at_s, after, when, ...rest }) {
    this.rest = rest;
    this.id = rest.id;
    const { id = after, event = "end", delay_s = 0 } = typeof after === "object" ? after : {};
    this.wanted = id ? `${event}:${id}` : "";
    this.earliest_s = id ? at_s : undefined; // a file may have both
    this.begin = make("select");
    this.wait = make("input", { type: "text", inputMode: "decimal", value: id ? delay_s : at_s ?? 0 });
    this.when = make("input", { type: "text", value: when ?? "", placeholder: "condition", spellcheck: false });
    const height = rest.do === "take-off" ? make("input", { type: "text", inputMode: "decimal", value: rest.height_m ?? 10 }) : null;
    height?.addEventListener("input", () => { this.rest.height_m = scalar(height.value.trim(), { type: "number" }); });
    this.begin.onchange = () => { this.wanted = this.begin.value; };
    this.state = make("span", { className: "state" });
    const button = (textContent, label, onclick) =>
      make("button", { type: "button", className: "small", textContent, onclick, ariaLabel: `${label} ${this.id}` });
    const named = (words, control) => {
      control.setAttribute("aria-label", `${words} of ${this.id}`);
      return make("label", {}, `${words} `, control);
    };
    this.element = make("li", {}, make("span", {}, make("b", { textContent: this.id }), " ", this.state),
      button("↑", "Earlier", () => moveUp(this)), button("Remove", "Remove", () => remove(this)),
      make("span", { className: "what note", textContent: described(rest) }),
      make("div", { className: "when" }, named("begins", this.begin), named("wait, s", this.wait), named("until", this.when), ...height ? [named("height, m", height)] : []));
  }
  // The possible predecessors: the start, and start and end of every other step.
  offer(others) {
    const choices = [["", "from the start"], ...others.flatMap((id) => [[`end:${id}`, `after ${id} ends`], [`start:${id}`, `after ${id} starts`]])];
    this.begin.replaceChildren(...choices.map(([value, textContent]) => make("option", { value, textContent, selected: value === this.wanted })));
    this.wanted = this.begin.value;
  }
  entry() {
    const wait_s = scalar(this.wait.value.trim() || "0", { type: "number" }), [event, ...rest] = this.wanted.split(":");
    const id = rest.join(":"), when = this.when.value.trim();
    const after = event === "end" && wait_s === 0 ? id : { id, ...event === "end" ? {} : { event }, ...wait_s === 0 ? {} : { delay_s: wait_s } };
    const at_s = id ? this.earliest_s : wait_s === 0 ? undefined : wait_s;
    return { ...this.rest, ...at_s === undefined ? {} : { at_s }, ...id ? { after } : {}, ...when ? { when } : {} };
  }
  show(faults) {
    // A preset of several parts is one step.
    const own = faults.filter(({ id }) => id === this.id || id.replace(/\.\d+$/, "") === this.id);
    const now = own.some((one) => one.state === "active") ? "active" : own.some((one) => one.state === "waiting") ? "waiting" : own.length ? "done" : "";
    this.element.className = now;
    this.state.textContent = { active: "running", waiting: "waiting", done: "done" }[now] || "";
    if (now === "active") this.element.setAttribute("aria-current", "step");
    else this.element.removeAttribute("aria-current");
    return now;
  }
}

function described({ fault, preset, target, value, for_s, number, ...rest }) {
  if (fault === "command") return rest.do ? "command to the vehicle" : `MAV_CMD ${number}`;
  const on = target ? ` on ${[target].flat().join(", ")}` : "", size = typeof value === "number" ? `, value ${value}` : "";
  return `${preset || fault}${on}${size}${for_s ? ` for ${for_s} s` : ""}`;
}

// -- the list -------------------------------------------------------------------------------------

// A new step follows the end of the previous one, or its start if it never ends.
function addStep(entry, name) {
  const before = steps.at(-1), taken = new Set(steps.map((one) => one.id));
  let id = entry.id || name;
  for (let number = 2; taken.has(id); number++) id = `${name}-${number}`;
  const ends = before && (before.rest.fault === "command" || before.rest.for_s !== undefined);
  const { at_s = 0, ...rest } = entry;
  const after = { id: before?.id, event: ends ? "end" : "start", delay_s: at_s };
  steps.push(new Step({ ...rest, id, ...before ? { after } : { at_s } }));
  layOut();
}

function remove(step) {
  steps = steps.filter((one) => one !== step);
  for (const one of steps) if (one.wanted.endsWith(`:${step.id}`)) one.wanted = step.wanted; // its successors follow its predecessor
  layOut();
}

function moveUp(step) {
  const place = steps.indexOf(step);
  if (place > 0) steps.splice(place - 1, 2, step, steps[place - 1]);
  layOut();
}

function layOut() {
  for (const one of steps) one.offer(steps.filter((other) => other !== one).map((other) => other.id));
  $("steps").replaceChildren(...steps.map((one) => one.element));
  followSequence(state.faults);
  scheduleCheck();
}

function openSteps({ steps: entries }) {
  steps = entries.map((entry) => new Step(entry));
  layOut();
}

const asSequence = () => JSON.stringify({ faults: steps.map((one) => one.entry()) });

function scheduleCheck() {
  clearTimeout(checkTimer);
  for (const id of ["run-sequence", "download-sequence", "keep"]) $(id).disabled = !token || !steps.length;
  if (token && steps.length) checkTimer = setTimeout(checkSteps, CHECK_MS);
  else showMessage("sequence-message", "");
}

async function checkSteps() {
  const number = ++checkNumber;
  let wrong = "";
  try { await post("sequence/check", asSequence()); } catch (error) { wrong = error.message; }
  if (number === checkNumber) showMessage("sequence-message", wrong);
}

// Show which steps are done and running; called with each state of the schedule.
function followSequence(faults) {
  phases = steps.map((one) => one.show(faults));
  const running = steps.filter((_, place) => phases[place] === "active").map((one) => one.id);
  const done = phases.filter((one) => one === "done").length;
  const text = !phases.some(Boolean) ? "" : done === steps.length ? "the sequence is done"
    : `${done} of ${steps.length} steps done${running.length ? `; running: ${running.join(", ")}` : ""}`;
  if ($("sequence-state").textContent !== text) $("sequence-state").textContent = text;
}

// -- buttons --------------------------------------------------------------------------------------

// A button's message is kept: a pending check must not overwrite it.
function press(act) {
  clearTimeout(checkTimer);
  checkNumber++;
  return attempt("sequence-message", act);
}

$("steps").addEventListener("input", scheduleCheck);
$("add-step").onclick = () => addStep({ fault: "command", do: $("deed").value }, $("deed").value);
$("add-fault").onclick = () => press(async () => {
  const { id, ...data } = entry();
  await post("sequence/check", JSON.stringify({ faults: [data] }));
  addStep({ ...id ? { id } : {}, ...data }, id || data.preset || data.fault);
});
$("run-sequence").onclick = () => press(async () => {
  const { yaml } = await post("sequence/check", asSequence());
  await change("ctl/schedule/begin", yaml);
  return "the sequence is running";
});
$("download-sequence").onclick = () => press(async () => {
  download("sequence.yaml", (await post("sequence/check", asSequence())).yaml, "application/yaml");
});
$("open-sequence").onchange = () => press(async () => {
  const file = $("open-sequence").files[0];
  $("open-sequence").value = "";
  if (file) openSteps(await post("sequence/check", await file.text()));
});
$("keep").onclick = () => press(async () => {
  const name = $("kept-name").value.trim();
  showStored((await post(`sequence/write/${encodeURIComponent(name)}`, asSequence())).sequences);
  return `${name} is stored`;
});
$("open-kept").onclick = () => press(async () => {
  openSteps(await post(`sequence/read/${encodeURIComponent($("kept-name").value.trim())}`));
});

function showStored(names) {
  $("kept").hidden = !names;
  $("kept-names").replaceChildren(...(names || []).map((value) => make("option", { value })));
}

function commandButton(deed) {
  const button = make("button", { type: "button", textContent: deed.replace("-", " ") });
  button.onclick = () => attempt("commands-message", async () => {
    const height = deed === "take-off" ? { height_m: scalar($("height").value, { type: "number" }) } : {};
    await post(`ctl/fault/command-${deed}/arm`, JSON.stringify({ fault: "command", do: deed, for_s: COMMAND_TIMEOUT_S, ...height }));
    return `${deed}: sent until accepted, for at most ${COMMAND_TIMEOUT_S} s`;
  });
  return button;
}

async function loadPermissions() {
  if (token) allowed = await post("allowed");
  $("commands").hidden = $("command-step").hidden = !allowed.commands;
  $("deed").replaceChildren(...COMMAND_NAMES.map((value) => make("option", { value, textContent: value.replace("-", " ") })));
  $("commands").prepend(...COMMAND_NAMES.map(commandButton));
  showStored(allowed.sequences);
  scheduleCheck();
}
