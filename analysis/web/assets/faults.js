"use strict";
// The list of faults and the form for a new one.

const PREVIEW_MS = 300;

// -- changes, and undo --------------------------------------------------------------------------

const MAX_UNDO = 20;
const earlier = []; // schedules before each change made here, as YAML
const armed = new Map(); // entries armed here, by id

// Request a change and keep the previous schedule for undo.
async function change(path, body) {
  const { yaml } = await post("ctl/schedule/save");
  const reply = await post(path, body);
  earlier.push(yaml);
  if (earlier.length > MAX_UNDO) earlier.shift();
  $("undo").disabled = false;
  return reply;
}

$("undo").onclick = () => attempt("schedule-message", async () => {
  await post("ctl/schedule/load", earlier.at(-1));
  earlier.pop();
  $("undo").disabled = !earlier.length;
  return "the last change is undone";
});

// The entry that repeats a finished fault for the same duration.
function repeatedEntry(fault) {
  if (armed.has(fault.id)) return armed.get(fault.id);
  const kind = fault.preset ? { preset: fault.preset } : { fault: fault.fault };
  const for_s = fault.end_us ? { for_s: (fault.end_us - fault.start_us) / 1e6 } : {};
  return { ...kind, ...fault.targets?.length ? { target: fault.targets } : {}, ...fault.preset ? {} : fault.parameters, ...for_s };
}

// -- the list of faults ----------------------------------------------------------------------

const rows = new Map();
let state = { faults: [] };

function showFaults(news) {
  state = news;
  store.t0_us = news.t0_us ?? store.t0_us;
  $("none").hidden = news.faults.length > 0;
  const seen = new Set(news.faults.map((one) => one.id));
  for (const [id, row] of rows) if (!seen.has(id)) { row.close(); rows.delete(id); }
  for (const one of news.faults) {
    if (rows.get(one.id)?.kind !== kindOf(one)) { // new, or armed again as something else
      rows.get(one.id)?.close();
      rows.set(one.id, faultRow(one));
    }
    rows.get(one.id).show(one);
  }
  signals.follow(news.faults);
  followSequence(news.faults);
  if (news.revision !== undefined && news.revision !== lastSchedule.revision) scheduleSnapshot(news.revision);
}

// -- restoring the faults of a lost proxy -----------------------------------------------------------

const SNAPSHOT_MS = 500;
// The last schedule of the proxy, to restore it if the proxy dies; `revision` is the requested one.
let lastSchedule = { revision: null, anew: "", count: 0 }, snapshotTimer = 0;

function scheduleSnapshot(revision) {
  const count = state.faults.length;
  lastSchedule = { ...lastSchedule, revision, count: Math.min(count, lastSchedule.count) }; // without faults there is nothing to request
  clearTimeout(snapshotTimer);
  if (token && count) snapshotTimer = setTimeout(async () => {
    try { lastSchedule = { revision, anew: (await post("ctl/schedule/save")).anew, count }; } catch { lastSchedule.revision = null; } // the proxy may be shutting down
  }, SNAPSHOT_MS);
}

function clearRestore() {
  clearTimeout(snapshotTimer);
  lastSchedule = { revision: null, anew: "", count: 0 };
  $("adopt").hidden = true;
}

// A new proxy has connected: offer to restore the lost proxy's faults.
function offerRestore(name) {
  const { anew, count } = lastSchedule;
  clearRestore();
  $("adopt").hidden = !count;
  if (!count) return;
  const load = make("button", { type: "button", className: "small", textContent: "Restore them here" });
  const leave = make("button", { type: "button", className: "small", textContent: "No", onclick: () => { $("adopt").hidden = true; } });
  load.onclick = () => attempt("schedule-message", async () => {
    await change("ctl/schedule/begin", anew);
    $("adopt").hidden = true;
    return `the faults of ${name} are restored; their times count from now`;
  });
  $("adopt").replaceChildren(`${name} disconnected with ${count} fault${count > 1 ? "s" : ""} loaded. `, load, " ", leave);
}

function kindOf({ fault, preset, targets, parameters }) {
  return JSON.stringify([fault, preset, targets, Object.keys(parameters || {}), parameters?.profile]);
}

function faultRow(fault) {
  const stateText = make("span", { className: "state" });
  const what = make("span", { className: "what note" });
  const disarm = make("button", { type: "button", className: "small", textContent: "Disarm", disabled: !token, ariaLabel: `Disarm ${fault.id}` });
  disarm.onclick = () => attempt("schedule-message", () => change(`ctl/fault/${encodeURIComponent(fault.id)}/disarm`).then(() => ""));
  const again = make("button", { type: "button", className: "small", textContent: "Re-arm", hidden: true, disabled: !token, ariaLabel: `Re-arm ${fault.id}` });
  let newest = fault;
  again.onclick = () => attempt("schedule-message", async () => {
    await change(`ctl/fault/${encodeURIComponent(fault.id)}/arm`, JSON.stringify(repeatedEntry(newest)));
    return `armed again: ${fault.id}`;
  });
  const head = make("span", {}, make("b", { textContent: fault.id }), " ", stateText);
  const element = make("li", {}, head, disarm, again, what);
  const live = liveOf(fault);
  if (live) element.append(live.element);
  $("faults").append(element);
  return {
    kind: kindOf(fault),
    show(now) {
      newest = now;
      element.className = now.state;
      again.hidden = now.state === "active" || now.state === "waiting";
      stateText.textContent = phaseOf(now);
      const size = now.magnitude == null ? "" : `, largest change ${+now.magnitude.toPrecision(3)}`;
      const frames = now.frames ? ` · ${now.frames} frame${now.frames === 1 ? "" : "s"}${size}` : "";
      what.textContent = `${now.preset || now.fault} on ${shorten(targetsOf(now))}${frames}`;
      live?.show(now);
    },
    close() {
      live?.close();
      element.remove();
    },
  };
}

// A fault's targets: those named, else the messages of its kind, else every message.
function targetsOf({ targets, fault }) {
  if (targets?.length) return targets;
  const own = catalogue?.faults[fault]?.messages || [];
  return own.length ? own : ["every message"];
}

function shorten(names) {
  return names.length > 3 ? `${names.slice(0, 2).join(", ")} and ${names.length - 2} more` : names.join(", ");
}

function phaseOf(fault) {
  const at = (t_us) => `${store.seconds(t_us).toFixed(1)} s`;
  if (fault.state === "active") return fault.end_us ? `active until ${at(fault.end_us)}` : "active";
  if (fault.state === "waiting") return fault.start_us ? `waiting until ${at(fault.start_us)}` : "waiting";
  return "finished";
}

// The live value of a fault that has one: constant, or streamed if its profile is live.
function liveOf(fault) {
  const { value, profile } = fault.parameters || {};
  const unit = unitOf(fault.fault, fault.targets?.[0]);
  if (profile?.live) return new LiveValue(fault.id, unit, 0, profile.live.timeout_s ?? 0.5);
  if (typeof value === "number") return new LiveValue(fault.id, unit, value);
  return fault.preset && catalogue?.faults[fault.fault]?.schema.properties.value ? new LiveValue(fault.id, unit) : null;
}

$("stop").onclick = () => attempt("schedule-message", () => change("ctl/schedule/stop").then(() => ""));
$("save").onclick = () => attempt("schedule-message", async () => {
  download("schedule.yaml", (await post("ctl/schedule/save")).anew, "application/yaml");
});
$("load").onchange = () => attempt("schedule-message", async () => {
  const file = $("load").files[0];
  $("load").value = "";
  if (!file) return "";
  const loaded = await change("ctl/schedule/begin", await file.text());
  return `${file.name}: ${loaded.faults.length} fault${loaded.faults.length === 1 ? "" : "s"} loaded`;
});

// -- a new fault ------------------------------------------------------------------------------

const preview = new Preview($("preview"));
let catalogue = null, entryOf = () => ({}), previewTimer = 0, previewNumber = 0;
let touched = false; // until then the form's errors are not shown

async function offer() {
  catalogue = await (await fetch("/api/catalogue", { headers: { "X-Token": token } })).json();
  const group = (label, names, kind) => {
    const box = make("optgroup", { label });
    box.append(...names.map((name) => make("option", { value: `${kind}:${name}`, textContent: name.replaceAll("-", " ") })));
    return box;
  };
  $("kind").append(group("ready-made (presets)", Object.keys(catalogue.presets), "preset"), group("to build yourself (faults)", Object.keys(catalogue.faults), "fault"));
  $("known-fields").replaceChildren(...Object.entries(catalogue.units).map(([value, unit]) => make("option", { value, label: unit ? `${value}, ${unit}` : value })));
  choose();
  for (const row of rows.values()) row.close(); // now it is known which of them have a live value
  rows.clear();
  showFaults(state);
}

// Faults whose name or description has all words of the search; the first of them is chosen.
function findFaults() {
  const words = $("find").value.toLowerCase().split(/\s+/), options = [...$("kind").options];
  for (const option of options) {
    const [kind, name] = option.value.split(":");
    const about = kind === "preset" ? catalogue.presets[name] : catalogue.faults[name].schema.description;
    const text = `${option.value} ${option.textContent} ${about}`.toLowerCase();
    option.hidden = !words.every((word) => text.includes(word));
  }
  const first = options.find((option) => !option.hidden);
  if (!first || !$("kind").selectedOptions[0]?.hidden) return;
  $("kind").value = first.value;
  choose();
}

function chosen() {
  const [kind, name] = $("kind").value.split(":");
  return { kind, name, fault: catalogue.faults[name] };
}

function choose() {
  const { kind, name, fault } = chosen();
  $("about").textContent = kind === "preset" ? catalogue.presets[name] : fault.schema.description;
  const schema = kind === "preset" ? presetSchema() : fault.schema;
  entryOf = faultForm($("fields"), schema, catalogue.defs);
  suggest(kind, fault);
  const target = $("fields").querySelector("[data-key=target]");
  if (target) target.placeholder = kind === "preset" || fault.messages.length ? "the preset's own" : fault.acts_on === "frames" ? "every message" : "MESSAGE.field";
  showMessage("form-message", "");
  touched = kind === "preset";
  $("hint").textContent = "";
  preview.show([]);
  schedulePreview();
}

function presetSchema() {
  // A preset takes the keys that all faults share.
  const some = Object.values(catalogue.faults).map((one) => Object.keys(one.schema.properties));
  const shared = some.reduce((left, right) => left.filter((key) => right.includes(key)));
  const { properties } = Object.values(catalogue.faults)[0].schema;
  return { properties: Object.fromEntries(shared.map((key) => [key, properties[key]])) };
}

function suggest(kind, fault) {
  const ranges = [...satellites.rows.keys()].map((name) => [`PSEUDORANGE.${name}`, "m"]);
  const fields = Object.entries(catalogue.units);
  let found = [...ranges, ...fields];
  if (fault?.acts_on === "frames") found = [...new Set(fields.map(([name]) => name.split(".")[0]))].map((name) => [name, ""]);
  else if (fault && !fault.on_ranges) found = fields;
  $("targets").replaceChildren(...found.map(([value, label]) => make("option", { value, label: label ? `${value}, ${label}` : value })));
}

// The unit of a fault's value on a target; empty if it has none.
function unitOf(fault, target = "") {
  const field = target.startsWith("PSEUDORANGE.") ? "m" : catalogue?.units[target.split("[")[0]], unit = catalogue?.faults[fault]?.unit ?? "";
  return unit.startsWith("field") ? field && unit.replace("field", field) : unit;
}

function showUnit() {
  const target = $("fields").querySelector("[data-key=target]"), value = $("fields").querySelector("[data-key=value]");
  if (!value) return;
  const unit = unitOf(chosen().name, target?.value);
  value.closest(".field").firstChild.textContent = unit ? `value, ${unit}` : "value";
}

function entry() {
  const { kind, name } = chosen();
  return { [kind]: name, ...entryOf() };
}

function schedulePreview() {
  showUnit();
  clearTimeout(previewTimer);
  if (token) previewTimer = setTimeout(showPreview, PREVIEW_MS);
}

async function showPreview() {
  const number = ++previewNumber;
  try {
    const { curves, error } = await post("preview", JSON.stringify(entry()));
    if (number !== previewNumber) return;
    preview.show(curves.slice(0, 2));
    $("hint").textContent = touched ? error || "" : "";
  } catch (error) {
    if (number === previewNumber) showMessage("form-message", error.message);
  }
}

// A unique name: a second fault with the same name would replace the first.
function uniqueName(name) {
  let number = 1;
  while (rows.has(number > 1 ? `${name}-${number}` : name)) number++;
  return number > 1 ? `${name}-${number}` : name;
}

$("kind").onchange = choose;
$("find").oninput = findFaults;
$("fields").addEventListener("input", () => { touched = true; showMessage("form-message", ""); schedulePreview(); });
$("form").onsubmit = (event) => {
  event.preventDefault();
  const data = entry();
  const id = data.id || uniqueName(data.preset || data.fault);
  attempt("form-message", async () => {
    const reply = await change(`ctl/fault/${encodeURIComponent(id)}/arm`, JSON.stringify(data));
    armed.set(id, data);
    return `armed: ${reply.armed.join(", ")}`;
  });
};

