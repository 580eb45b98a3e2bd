"use strict";
// The vehicle: attitude from every source, state of autopilot and estimator.

const NO_AUTOPILOT = 8; // MAV_AUTOPILOT_INVALID: the simulator, a ground station
const ARMED = 128; // MAV_MODE_FLAG_SAFETY_ARMED
const STATES = ["uninitialised", "booting", "calibrating", "standby", "active", "critical", "emergency", "powering off", "terminating"];
const FIXES = ["no GPS", "no fix", "2D fix", "3D fix", "DGPS", "RTK float", "RTK fixed"];
const ESTIMATES = ["attitude", "horizontal velocity", "vertical velocity", "horizontal position (relative)", "horizontal position",
  "height", "height above ground", "constant position", "predicted position (relative)", "predicted position", "GPS glitch", "accelerometer error"];
const WARNINGS = new Set(["constant position", "GPS glitch", "accelerometer error", "uninitialised"]);
const RATIOS = { vel_ratio: "velocity", pos_horiz_ratio: "horizontal position", pos_vert_ratio: "height", mag_ratio: "magnetometer", hagl_ratio: "height above ground", tas_ratio: "airspeed" };
const VARIANCES = { velocity_variance: "velocity", pos_horiz_variance: "horizontal position", pos_vert_variance: "height", compass_variance: "magnetometer", terrain_alt_variance: "terrain" };
const LOST_US = 3e6;
const UPDATE_MS = 200; // between two batches of samples

// The views move evenly from batch to batch: they show the samples of the newest one at their own times.
const played = { us: null, newest_us: null, from_us: 0, ms: 0 };

function play(now_ms) {
  if (store.newest_us === null) return;
  if (store.newest_us !== played.newest_us) {
    const isNext = played.us !== null && Math.abs(store.newest_us - played.us) < LOST_US;
    Object.assign(played, { newest_us: store.newest_us, from_us: isNext ? played.us : store.newest_us, ms: now_ms });
  }
  played.us = played.from_us + (played.newest_us - played.from_us) * Math.min(1, (now_ms - played.ms) / UPDATE_MS);
}

// The newest sent row of the played time.
function playedRow(table) {
  return table?.sent.findLast(([t_us]) => t_us <= (played.us ?? Infinity)) ?? table?.sent.at(-1);
}

function quaternionOf(table, field) {
  const row = playedRow(table), first = table?.place(field);
  return row && [0, 1, 2, 3].map((n) => row[first + n]);
}

// Quaternions of the available sources.
function attitudes() {
  const found = new Map();
  const truth = quaternionOf(store.tables.get("HIL_STATE_QUATERNION"), "attitude_quaternion");
  if (truth) found.set("truth", truth);
  const own = quaternionOf(store.tables.get("ATTITUDE_QUATERNION"), "q1") || fromAngles(store.tables.get("ATTITUDE"));
  if (own) found.set("autopilot", own);
  const fused = quaternionOf(store.tables.get("fusion"), "qw");
  if (fused) found.set("fusion", fused);
  return found;
}

function fromAngles(table) {
  const row = playedRow(table);
  if (!row) return undefined;
  const [r, p, y] = ["roll", "pitch", "yaw"].map((field) => row[table.place(field)] / 2);
  const [sr, cr, sp, cp, sy, cy] = [Math.sin(r), Math.cos(r), Math.sin(p), Math.cos(p), Math.sin(y), Math.cos(y)];
  return [cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy];
}

const scene = new Scene($("scene"));
let vehicleType = null, vehicleDrawn = { ms: 0, us: null }, legend = "";

// Draw both canvases immediately, so that a resized or captured page is never blank.
function drawViews() {
  const sources = [...attitudes()];
  drawHorizon($("horizon"), sources[0] && angles(sources[0][1]), sources[1] && angles(sources[1][1]));
  scene.draw(sources[0]?.[1], vehicleType);
  return sources;
}

const views = new ResizeObserver(drawViews);
for (const id of ["horizon", "scene"]) views.observe($(id));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawViews);
document.addEventListener("visibilitychange", drawViews);
window.addEventListener("beforeprint", drawViews);

function drawVehicle(now_ms) {
  if (now_ms - vehicleDrawn.ms < 33) return;
  play(now_ms);
  if (played.us === vehicleDrawn.us && !scene.dirty) return;
  const slow = now_ms - vehicleDrawn.slow > 250 || vehicleDrawn.slow === undefined;
  vehicleDrawn = { ms: now_ms, us: played.us, slow: slow ? now_ms : vehicleDrawn.slow };
  scene.dirty = false;
  const sources = drawViews();
  if (!slow) return;
  $("no-vehicle").hidden = store.tables.size > 0;
  showLegend();
  showAngles(sources);
  showVehicleStatus();
}

function showLegend() {
  const tracks = scene.legend();
  if (tracks.map((one) => one.name).join() === legend) return;
  legend = tracks.map((one) => one.name).join();
  $("tracks").replaceChildren(...tracks.map((track) => {
    const mark = make("i");
    mark.style.background = `var(${track.stroke})`;
    return make("li", {}, mark, track.name);
  }));
}

function showAngles(sources) {
  const head = ["attitude, degrees", "roll", "pitch", "yaw"];
  const lines = sources.map(([name, q], number) => [name + (number === 1 ? " (dashed)" : ""), ...angles(q).map((one) => (one * DEGREES).toFixed(1))]);
  fillTable($("angles"), head, lines);
}

function fillTable(table, head, lines) {
  table.hidden = !lines.length;
  const row = (tag, cells) => make("tr", {}, ...cells.map((cell) => make(tag, { textContent: cell ?? "–" })));
  table.replaceChildren(make("thead", {}, row("th", head)), make("tbody", {}, ...lines.map((cells) => row("td", cells))));
}

// -- autopilot and estimator -------------------------------------------------------------------

function heartbeat() {
  for (const table of store.sources.values()) {
    if (table.has("base_mode") && table.has("autopilot") && table.newest("autopilot") !== NO_AUTOPILOT) return table;
  }
  return undefined;
}

function modeOf(autopilot, type, base, custom) {
  if (!(base & 1)) return `base mode ${base}`; // MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
  if (autopilot === 12) {
    const name = catalogue?.modes.px4[`${(custom >>> 16) & 255}.${custom >>> 24}`];
    return name || `custom mode ${custom}`;
  }
  return catalogue?.modes.ardupilot[type]?.[custom] || `custom mode ${custom}`;
}

function statusItems() {
  const items = [];
  const beat = heartbeat();
  if (beat) {
    const [type, autopilot, base, custom, system] = ["type", "autopilot", "base_mode", "custom_mode", "system_status"].map((field) => beat.newest(field));
    vehicleType = type;
    const lost = store.newest_us - beat.received.at(-1)[0] > LOST_US;
    items.push(["", base & ARMED ? "armed" : "disarmed", false], ["mode", modeOf(autopilot, type, base, custom), false],
      ["state", lost ? "no heartbeat" : STATES[system] || `state ${system}`, lost || system >= 5]);
  }
  const gps = ["HIL_GPS", "GPS_RAW_INT"].map((name) => store.tables.get(name)).find((table) => table?.sent.length);
  if (gps) {
    const fix = gps.newest("fix_type"), lost = store.newest_us - gps.sent.at(-1)[0] > LOST_US;
    items.push(["GPS", lost ? "lost" : `${FIXES[fix] ?? `fix ${fix}`}, ${gps.newest("satellites_visible")} satellites`, lost || fix < 3]);
  }
  const fused = store.tables.get("fusion");
  if (fused?.sent.length) items.push(["fusion", `position ±${fused.newest("sigma_m").toFixed(2)} m${fused.newest("reason") ? `, ${fused.newest("reason")}` : ""}`, false]);
  return [...items, ...estimatorItems()];
}

function estimatorItems() {
  const px4 = store.tables.get("ESTIMATOR_STATUS"), ardupilot = store.tables.get("EKF_STATUS_REPORT");
  const table = px4?.sent.length ? px4 : ardupilot?.sent.length ? ardupilot : null;
  if (!table) return [];
  const flags = table.newest("flags"), names = table === px4 ? ESTIMATES : [...ESTIMATES.slice(0, 10), "uninitialised"];
  const warnings = names.filter((name, bit) => flags >> bit & 1 && WARNINGS.has(name));
  const missing = names.slice(0, 6).filter((name, bit) => name !== "horizontal position (relative)" && !(flags >> bit & 1));
  const problems = [...warnings, ...missing.map((name) => `no ${name}`)];
  const tests = Object.entries(table === px4 ? RATIOS : VARIANCES).map(([field, name]) => [name, table.newest(field)]).filter(([, value]) => value != null && value > 0);
  return [["estimator", problems.join(", ") || "all estimates good", problems.length > 0],
    ...tests.map(([name, value]) => [`${name} test`, `${value.toFixed(2)}${value > 1 ? " fails" : ""}`, value > 1])];
}

function showVehicleStatus() {
  const items = statusItems();
  $("status").replaceChildren(...items.map(([name, value, bad]) => make("li", { className: bad ? "bad" : "" }, make("span", { textContent: name && `${name}: ` }), value)));
}
