"use strict";
// The page: what the socket brings is shown, what is clicked is asked of the server.

const $ = (id) => document.getElementById(id);
const RETRY_MS = 1000;
const EVENTS_SHOWN = 200;
const ROWS_KEPT = 50000; // for the CSV
const PREVIEW_MS = 300;
const SLIDER_MS = 60;

const printed = new URLSearchParams(location.hash.slice(1)).get("token");
if (printed) {
  sessionStorage.setItem("token", printed);
  history.replaceState(null, "", location.pathname);
}
const token = sessionStorage.getItem("token") || "";

async function ask(path, body = "") {
  let reply;
  try {
    reply = await fetch(`/api/${path}`, { method: "POST", headers: { "X-Token": token }, body });
  } catch {
    throw new Error("the page's server does not answer");
  }
  const value = await reply.json();
  if (!reply.ok) throw new Error(value.error);
  return value;
}

function say(id, text, fine = false) {
  $(id).textContent = text;
  $(id).hidden = !text;
  $(id).classList.toggle("fine", fine);
}

async function attempt(id, act) {
  try { say(id, await act() || "", true); } catch (error) { say(id, error.message); }
}

// -- the faults there are ---------------------------------------------------------------------

const rows = new Map();
let state = { faults: [] };

function showFaults(news) {
  state = news;
  $("none").hidden = news.faults.length > 0;
  const seen = new Set(news.faults.map((one) => one.id));
  for (const [id, row] of rows) if (!seen.has(id)) { row.element.remove(); rows.delete(id); }
  for (const one of news.faults) {
    if (!rows.has(one.id)) rows.set(one.id, faultRow(one));
    rows.get(one.id).show(one);
  }
}

function faultRow(fault) {
  const stateText = make("span", { className: "state" });
  const what = make("span", { className: "what note" });
  const disarm = make("button", { type: "button", textContent: "Disarm", disabled: !token });
  disarm.setAttribute("aria-label", `Disarm ${fault.id}`);
  disarm.onclick = () => attempt("schedule-said", () => ask(`ctl/fault/${fault.id}/disarm`).then(() => ""));
  const head = make("span", {}, make("b", { textContent: fault.id }), " ", stateText);
  const element = make("li", {}, head, disarm, what);
  const { value, profile } = fault.parameters || {};
  if (typeof value === "number" || profile?.live) element.append(slider(fault.id, value ?? 0));
  else if (fault.preset && catalogue?.faults[fault.fault]?.schema.properties.value) element.append(slider(fault.id));
  $("faults").append(element);
  const t0 = () => state.t0_us ?? 0;
  return {
    element,
    show(now) {
      element.className = now.state;
      stateText.textContent = now.state === "waiting" && now.start_us ? `from ${((now.start_us - t0()) / 1e6).toFixed(1)} s` : now.state;
      const size = now.magnitude == null ? "" : `, largest change ${+now.magnitude.toPrecision(3)}`;
      what.textContent = `${now.fault} ${(now.targets || []).join(", ") || ""} · ${now.frames || 0} frames${size}`;
    },
  };
}

// A slider and a field for the value of a fault; only a field where the value is not known.
function slider(id, value) {
  const known = value !== undefined;
  const reach = Math.abs(value ?? 0) * 3 || 1;
  const range = make("input", { type: "range", min: -reach, max: reach, step: reach / 300, value: value ?? 0, disabled: !token });
  const number = make("input", { type: "number", step: "any", value: value ?? "", placeholder: "value", disabled: !token });
  range.setAttribute("aria-label", `Value of ${id}, slider`);
  number.setAttribute("aria-label", `Value of ${id}`);
  let wanted = null, busy = false;
  const send = async () => {
    if (busy || wanted === null) return;
    busy = true;
    const next = wanted;
    wanted = null;
    await attempt("schedule-said", () => ask(`ctl/fault/${id}/value`, JSON.stringify({ value: next })).then(() => ""));
    setTimeout(() => { busy = false; send(); }, SLIDER_MS);
  };
  range.oninput = () => { number.value = range.value; wanted = Number(range.value); send(); };
  number.onchange = () => { if (number.value === "") return; range.value = number.value; wanted = Number(number.value); send(); };
  return make("div", { className: "live" }, known ? range : make("span", { className: "note", textContent: "another value" }), number);
}

$("stop").onclick = () => attempt("schedule-said", () => ask("ctl/schedule/stop").then(() => ""));
$("save").onclick = () => attempt("schedule-said", async () => {
  download("schedule.yaml", (await ask("ctl/schedule/save")).yaml, "application/yaml");
});
$("load").onchange = () => attempt("schedule-said", async () => {
  const file = $("load").files[0];
  $("load").value = "";
  if (!file) return "";
  const loaded = await ask("ctl/schedule/load", await file.text());
  return `${file.name}: ${loaded.faults.length} faults loaded`;
});

function download(name, text, type) {
  const link = make("a", { download: name, href: URL.createObjectURL(new Blob([text], { type })) });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

// -- a new fault ------------------------------------------------------------------------------

const preview = new Preview($("preview"));
let catalogue = null, entryOf = () => ({}), previewTimer = 0, previewNumber = 0;

async function offer() {
  catalogue = await (await fetch("/api/catalogue")).json();
  const group = (label, names, kind) => {
    const box = make("optgroup", { label });
    box.append(...names.map((name) => make("option", { value: `${kind}:${name}`, textContent: name })));
    return box;
  };
  $("kind").append(group("presets", Object.keys(catalogue.presets), "preset"), group("faults", Object.keys(catalogue.faults), "fault"));
  choose();
  $("faults").replaceChildren(); // now it is known which of them take a value
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
  say("form-said", "");
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
    const { curves } = await ask("preview", JSON.stringify(entry()));
    if (number !== previewNumber) return;
    if (!$("form-said").classList.contains("fine")) say("form-said", ""); // what was armed stays said
    preview.show(curves.slice(0, 4));
  } catch (error) {
    if (number !== previewNumber) return;
    preview.show([]);
    say("form-said", error.message);
  }
}

$("kind").onchange = choose;
$("fields").addEventListener("input", soonPreview);
$("form").onsubmit = (event) => {
  event.preventDefault();
  const data = entry();
  const id = data.id || data.preset || data.fault;
  attempt("form-said", async () => {
    const reply = await ask(`ctl/fault/${encodeURIComponent(id)}/arm`, JSON.stringify(data));
    return `armed: ${reply.armed.join(", ")}`;
  });
};

// -- what is detected -------------------------------------------------------------------------

const statistic = new Sliding($("statistic"), { log: true, dashed: ["threshold"] });
const attitude = new Sliding($("attitude"));
const satellites = new Satellites($("satellites"));
const sensors = new Map();
const kept = new Map(); // source: time of its newest row
let received = [];
let epoch = null;

function showDecision(decision) {
  epoch = decision;
  $("quiet").hidden = true;
  statistic.add(decision.t_s, { statistic: decision.statistic, threshold: decision.threshold });
  keep([decision.t_s, "gnss", decision.statistic, decision.threshold, decision.alarm, decision.hypothesis, decision.excluded.join(" ")]);
}

function drawEpoch() {
  if (!epoch) return;
  satellites.show(epoch);
  const out = epoch.excluded.length ? `, isolated: ${epoch.excluded.join(", ")}` : "";
  $("verdict").hidden = false;
  $("verdict").className = `badge ${epoch.alarm || epoch.excluded.length ? "alarm" : "calm"}`;
  $("verdict").textContent = `${epoch.t_s.toFixed(1)} s: ${epoch.hypothesis === "none" ? "no fault found" : `fault: ${epoch.hypothesis}`}${out}`;
  epoch = null;
}

function showSensor(decision) {
  const chip = sensors.get(decision.sensor) || $("sensors").appendChild(make("li"));
  sensors.set(decision.sensor, chip);
  chip.className = decision.alarm || decision.isolated ? "bad" : "";
  chip.textContent = `${decision.sensor}: ${decision.isolated ? "isolated" : decision.alarm ? "alarm" : "agrees"}`;
  keep([decision.t_s, decision.sensor, decision.statistic, decision.threshold, decision.alarm, decision.isolated, ""]);
}

function showLinks(news) {
  const points = Array.isArray(news) ? news : news?.endpoints || [];
  const columns = ["name", "frames_in", "chunks_out", "faulted", "drops", "crc_errors", "p50_us", "p99_us"];
  $("links-title").hidden = !points.length;
  if (!points.length) return;
  const cells = (tag, values) => make("tr", {}, ...values.map((one) => make(tag, { textContent: one ?? "–" })));
  $("links").replaceChildren(cells("th", columns.map((one) => one.replaceAll("_", " "))), ...points.map((one) => cells("td", columns.map((key) => one[key]))));
}

function keep(row) {
  const [t_s, source] = row;
  if (t_s <= kept.get(source)) return; // told again after a reconnection
  kept.set(source, t_s);
  received.push(row);
  if (received.length > ROWS_KEPT * 1.2) received = received.slice(-ROWS_KEPT);
}

$("csv").onclick = () => {
  const lines = [["t_s", "source", "statistic", "threshold", "alarm", "said", "excluded"], ...received];
  download("received.csv", lines.map((row) => row.map((one) => one ?? "").join(",")).join("\n") + "\n", "text/csv");
};

// -- events -----------------------------------------------------------------------------------

function addEvent(t_s, text, bad) {
  const item = make("li", { className: bad ? "bad" : "" }, make("time", { textContent: `${t_s.toFixed(1)} s` }), text);
  $("events").prepend(item);
  while ($("events").children.length > EVENTS_SHOWN) $("events").lastChild.remove();
}

function showEvent(one) {
  if (one.type === "SensorDecision") {
    addEvent(one.t_s, `${one.sensor}: ${one.isolated ? "isolated" : one.alarm ? "alarm" : "agrees"}`, one.alarm);
  } else {
    const out = one.excluded.length ? `, isolated: ${one.excluded.join(", ")}` : "";
    addEvent(one.t_s, `${one.alarm ? "alarm: " : ""}${one.hypothesis === "none" ? "no fault" : one.hypothesis}${out}`, one.alarm);
  }
}

function showLabel(label) {
  const at = label.end_us ?? label.start_us;
  const what = label.end_us == null ? "injection begins" : `injection ended after ${label.frames || 0} frames`;
  addEvent((at - label.t0_us) / 1e6, `${label.id}: ${what}`, false);
}

// -- the socket -------------------------------------------------------------------------------

let run = null, there = false;

function showStatus(news) {
  $("connection").className = news.run ? "there" : "gone";
  $("connection").textContent = news.run ? `connected to ${news.run} on ${news.url}`
    : `${run ? "The proxy is gone; waiting for it to come back" : "No proxy or run yet; waiting"} on ${news.url}`;
  if (news.run && !there) {
    for (const plot of [statistic, attitude]) plot.clear();
    kept.clear();
    for (const chip of sensors.values()) chip.remove();
    sensors.clear();
    showFaults({ faults: [] });
  }
  if (!news.run && run) showFaults({ faults: [] });
  run = news.run || run;
  there = Boolean(news.run);
}

function take(key, value) {
  if (key === "page/picture") {
    $("events").replaceChildren();
    for (const plot of [statistic, attitude]) plot.clear();
  } else if (key === "page/status") showStatus(value);
  else if (key === "schedule/state") showFaults(value);
  else if (key === "proxy/labels") showLabel(value);
  else if (key === "proxy/stats") showLinks(value);
  else if (key === "fdi/events") showEvent(value);
  else if (key === "fdi/main/stat") showDecision(value);
  else if (/^fdi\/.*\/stat$/.test(key)) showSensor(value);
  else if (key.startsWith("att/")) attitude.add(value.t_s, { [value.estimator]: value.angle });
}

function connect() {
  const socket = new WebSocket(`ws://${location.host}/api/live`);
  socket.onmessage = (message) => { for (const [key, value] of JSON.parse(message.data)) take(key, value); };
  socket.onclose = () => {
    $("connection").className = "gone";
    $("connection").textContent = "The page's server is gone; trying again";
    setTimeout(connect, RETRY_MS);
  };
}

function frame() {
  drawEpoch();
  statistic.draw();
  attitude.draw();
  requestAnimationFrame(frame);
}

$("viewing").hidden = Boolean(token);
for (const id of ["stop", "save", "load", "arm"]) $(id).disabled = !token;
offer();
connect();
frame();
