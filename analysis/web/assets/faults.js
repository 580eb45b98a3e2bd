"use strict";
// The faults there are, and the form for a new one: what is clicked is asked of the server.

const PREVIEW_MS = 300;

// -- changes, and the way back ------------------------------------------------------------------

const MOST_UNDONE = 20;
const earlier = []; // schedules as they stood before each change made here, as YAML
const armed = new Map(); // entries armed here, by id

// Ask for a change, keeping the schedule that it changes.
async function change(path, body) {
  const { yaml } = await ask("ctl/schedule/save");
  const reply = await ask(path, body);
  earlier.push(yaml);
  if (earlier.length > MOST_UNDONE) earlier.shift();
  $("undo").disabled = false;
  return reply;
}

$("undo").onclick = () => attempt("schedule-said", async () => {
  await ask("ctl/schedule/load", earlier.at(-1));
  earlier.pop();
  $("undo").disabled = !earlier.length;
  return "the last change is undone";
});

// The entry of a fault that is over, to act again as long as before.
function entryAgain(fault) {
  if (armed.has(fault.id)) return armed.get(fault.id);
  const kind = fault.preset ? { preset: fault.preset } : { fault: fault.fault };
  const for_s = fault.end_us ? { for_s: (fault.end_us - fault.start_us) / 1e6 } : {};
  return { ...kind, ...fault.targets?.length ? { target: fault.targets } : {}, ...fault.preset ? {} : fault.parameters, ...for_s };
}

// -- the faults there are ---------------------------------------------------------------------

const rows = new Map();
let state = { faults: [] };

function showFaults(news) {
  state = news;
  store.t0_us = news.t0_us ?? store.t0_us;
  $("none").hidden = news.faults.length > 0;
  const seen = new Set(news.faults.map((one) => one.id));
  for (const [id, row] of rows) if (!seen.has(id)) { row.close(); rows.delete(id); }
  for (const one of news.faults) {
    if (rows.get(one.id)?.kind !== kindOf(one)) { // new, or armed anew as something else
      rows.get(one.id)?.close();
      rows.set(one.id, faultRow(one));
    }
    rows.get(one.id).show(one);
  }
  signals.follow(news.faults);
  followSequence(news.faults);
  if (news.revision !== undefined && news.revision !== lastSet.revision) soonRemember(news.revision);
}

// -- the faults of a proxy that is gone -----------------------------------------------------------

const REMEMBER_MS = 500;
// The schedule of the proxy as it stood last, for the case that the proxy dies; `revision` is the one asked for.
let lastSet = { revision: null, anew: "", count: 0 }, rememberTimer = 0;

function soonRemember(revision) {
  const count = state.faults.length;
  lastSet = { ...lastSet, revision, count: Math.min(count, lastSet.count) }; // without faults there is nothing to ask for
  clearTimeout(rememberTimer);
  if (token && count) rememberTimer = setTimeout(async () => {
    try { lastSet = { revision, anew: (await ask("ctl/schedule/save")).anew, count }; } catch { lastSet.revision = null; } // it is just going
  }, REMEMBER_MS);
}

function forgetFaults() {
  clearTimeout(rememberTimer);
  lastSet = { revision: null, anew: "", count: 0 };
  $("adopt").hidden = true;
}

// Another proxy is there: what the one that died had is offered to it.
function offerFaults(name) {
  const { anew, count } = lastSet;
  forgetFaults();
  $("adopt").hidden = !count;
  if (!count) return;
  const load = make("button", { type: "button", className: "small", textContent: "Load them here" });
  const leave = make("button", { type: "button", className: "small", textContent: "No", onclick: () => { $("adopt").hidden = true; } });
  load.onclick = () => attempt("schedule-said", async () => {
    await change("ctl/schedule/begin", anew);
    $("adopt").hidden = true;
    return `the faults of ${name} are loaded; their times count from now`;
  });
  $("adopt").replaceChildren(`${name} went away with ${count} fault${count > 1 ? "s" : ""} loaded. `, load, " ", leave);
}

function kindOf({ fault, preset, targets, parameters }) {
  return JSON.stringify([fault, preset, targets, Object.keys(parameters || {}), parameters?.profile]);
}

function faultRow(fault) {
  const stateText = make("span", { className: "state" });
  const what = make("span", { className: "what note" });
  const disarm = make("button", { type: "button", className: "small", textContent: "Disarm", disabled: !token });
  disarm.setAttribute("aria-label", `Disarm ${fault.id}`);
  disarm.onclick = () => attempt("schedule-said", () => change(`ctl/fault/${encodeURIComponent(fault.id)}/disarm`).then(() => ""));
  const again = make("button", { type: "button", className: "small", textContent: "Re-arm", hidden: true, disabled: !token });
  again.setAttribute("aria-label", `Re-arm ${fault.id}`);
  let newest = fault;
  again.onclick = () => attempt("schedule-said", async () => {
    await change(`ctl/fault/${encodeURIComponent(fault.id)}/arm`, JSON.stringify(entryAgain(newest)));
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
      const frames = now.frames ? ` · ${now.frames} frames${size}` : "";
      what.textContent = `${now.preset || now.fault} on ${briefly(targetsOf(now))}${frames}`;
      live?.show(now);
    },
    close() {
      live?.close();
      element.remove();
    },
  };
}

// What a fault acts on: what was named, else the messages it is made for, else all that passes.
function targetsOf({ targets, fault }) {
  if (targets?.length) return targets;
  const own = catalogue?.faults[fault]?.messages || [];
  return own.length ? own : ["every message"];
}

function briefly(names) {
  return names.length > 3 ? `${names.slice(0, 2).join(", ")} and ${names.length - 2} more` : names.join(", ");
}

function phaseOf(fault) {
  const at = (t_us) => `${store.seconds(t_us).toFixed(1)} s`;
  if (fault.state === "active") return fault.end_us ? `acts until ${at(fault.end_us)}` : "acts";
  if (fault.state === "waiting") return fault.start_us ? `waits until ${at(fault.start_us)}` : "waits";
  return "is over";
}

// The live value of a fault that has one: constant, or streamed where its profile asks for that.
function liveOf(fault) {
  const { value, profile } = fault.parameters || {};
  if (profile?.live) return new LiveValue(fault.id, 0, profile.live.timeout_s ?? 0.5);
  if (typeof value === "number") return new LiveValue(fault.id, value);
  return fault.preset && catalogue?.faults[fault.fault]?.schema.properties.value ? new LiveValue(fault.id) : null;
}

$("stop").onclick = () => attempt("schedule-said", () => change("ctl/schedule/stop").then(() => ""));
$("save").onclick = () => attempt("schedule-said", async () => {
  download("schedule.yaml", (await ask("ctl/schedule/save")).anew, "application/yaml");
});
$("load").onchange = () => attempt("schedule-said", async () => {
  const file = $("load").files[0];
  $("load").value = "";
  if (!file) return "";
  const loaded = await change("ctl/schedule/begin", await file.text());
  return `${file.name}: ${loaded.faults.length} faults loaded`;
});

// -- a new fault ------------------------------------------------------------------------------

const preview = new Preview($("preview"));
let catalogue = null, entryOf = () => ({}), previewTimer = 0, previewNumber = 0;
let touched = false; // until then nothing is said about what the form lacks

async function offer() {
  catalogue = await (await fetch("/api/catalogue")).json();
  const group = (label, names, kind) => {
    const box = make("optgroup", { label });
    box.append(...names.map((name) => make("option", { value: `${kind}:${name}`, textContent: name.replaceAll("-", " ") })));
    return box;
  };
  $("kind").append(group("ready-made (presets)", Object.keys(catalogue.presets), "preset"), group("to build yourself (faults)", Object.keys(catalogue.faults), "fault"));
  $("known-fields").replaceChildren(...Object.entries(catalogue.units).map(([value, unit]) => make("option", { value, label: unit ? `${value}, ${unit}` : value })));
  choose();
  for (const row of rows.values()) row.close(); // now it is known which of them take a value
  rows.clear();
  showFaults(state);
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
  if (target) target.placeholder = kind === "preset" || fault.messages.length ? "as it is made" : fault.acts_on === "frames" ? "every message" : "MESSAGE.field";
  say("form-said", "");
  touched = kind === "preset";
  $("hint").textContent = "";
  preview.show([]);
  soonPreview();
}

function presetSchema() {
  // A preset takes the keys that every fault has.
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

function showUnit() {
  const target = $("fields").querySelector("[data-key=target]"), value = $("fields").querySelector("[data-key=value]");
  if (!target || !value) return;
  const unit = target.value.startsWith("PSEUDORANGE.") ? "m" : catalogue.units[target.value.split("[")[0]];
  value.closest(".field").firstChild.textContent = unit ? `value, ${unit}` : "value";
}

function entry() {
  const { kind, name } = chosen();
  return { [kind]: name, ...entryOf() };
}

function soonPreview() {
  showUnit();
  clearTimeout(previewTimer);
  if (token) previewTimer = setTimeout(showPreview, PREVIEW_MS);
}

async function showPreview() {
  const number = ++previewNumber;
  try {
    const { curves, error } = await ask("preview", JSON.stringify(entry()));
    if (number !== previewNumber) return;
    preview.show(curves.slice(0, 2));
    $("hint").textContent = touched ? error || "" : "";
  } catch (error) {
    if (number === previewNumber) say("form-said", error.message);
  }
}

// A name of its own for a second fault of a kind: the same name would replace the first.
function unused(name) {
  let number = 1;
  while (rows.has(number > 1 ? `${name}-${number}` : name)) number++;
  return number > 1 ? `${name}-${number}` : name;
}

$("kind").onchange = choose;
$("fields").addEventListener("input", () => { touched = true; say("form-said", ""); soonPreview(); });
$("form").onsubmit = (event) => {
  event.preventDefault();
  const data = entry();
  const id = data.id || unused(data.preset || data.fault);
  attempt("form-said", async () => {
    const reply = await change(`ctl/fault/${encodeURIComponent(id)}/arm`, JSON.stringify(data));
    armed.set(id, data);
    return `armed: ${reply.armed.join(", ")}`;
  });
};

