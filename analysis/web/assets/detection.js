"use strict";
// The monitor's results: statistics, satellites, other sensors, attitude errors, and the list of events.

const EVENTS_SHOWN = 200;
const statistic = new Sliding($("statistic"), { decades: 4, dashed: ["threshold"] });
const attitude = new Sliding($("attitude"));
const satellites = new Satellites($("satellites"));
const others = new Sliding($("others"), { decades: 3, dashed: ["threshold"] });
const sensors = new Map();
const ratios = new Map(); // statistic over threshold, the last of each sensor
let epoch = null;
let crossed = ""; // when the statistic was last above its threshold: one epoch, if isolation succeeds at once

function clearDetection() {
  for (const plot of [statistic, attitude, others]) plot.clear();
  faultIntervals.clear();
  for (const chip of sensors.values()) chip.remove();
  sensors.clear();
  ratios.clear();
  satellites.clear();
  $("verdict").hidden = true;
  $("now").textContent = crossed = "";
  verdicts.clear();
}

function showDecision(decision) {
  epoch = decision;
  verdicts.addDecision(decision);
  statistic.add(store.seconds(decision.t_us), { statistic: decision.statistic, threshold: decision.threshold });
  if (decision.statistic > decision.threshold) crossed = `; was above it at ${store.seconds(decision.t_us).toFixed(1)} s with ${decision.statistic.toFixed(0)}`;
  const { alarm, hypothesis, excluded } = decision;
  store.note("gnss", decision.t_us, { statistic: decision.statistic, threshold: decision.threshold, alarm, hypothesis, excluded: excluded.join(" ") });
}

function drawEpoch() {
  if (!epoch) return;
  satellites.show(epoch);
  const { excluded } = epoch;
  $("isolated").hidden = false;
  $("isolated").className = excluded.length ? "bad" : "note";
  $("isolated").textContent = excluded.length ? `isolated: ${excluded.join(", ")}` : "no satellite is isolated";
  const { statistic: now, threshold } = epoch;
  $("now").textContent = now == null ? "" : `${now.toFixed(1)} is ${now > threshold ? "above" : "below"} ${threshold.toFixed(1)}${crossed}`;
  $("now").className = now > threshold ? "bad" : "note";
  epoch = null;
}

// Draw the current verdicts, with or without satellites.
function drawVerdicts() {
  if (!verdicts.fresh) return;
  verdicts.fresh = false;
  $("quiet").hidden = true;
  drawEpoch();
  for (const [sensor, chip] of sensors) {
    chip.className = verdicts.isBad(sensor) ? "bad" : "";
    retext(chip, `${NAMES[sensor] || sensor}: ${verdicts.stateOf(sensor)}`);
  }
  showVerdict();
}

function describeState(decision) {
  return decision.isolated ? "isolated" : decision.alarm ? "alarm" : "consistent";
}

// An isolated sensor may have nothing to test, for example when silent: its last value is kept.
function followCurve({ sensor, t_us, statistic, threshold, isolated }) {
  const before = ratios.get(sensor), tested = threshold > 0;
  if (!tested && !(isolated && before)) return;
  const ratio = tested ? statistic / threshold : before.ratio;
  const name = NAMES[sensor] || sensor, values = { threshold: 1 };
  // The dashed curve starts where the other one ends.
  if (!isolated || !before?.isolated) values[name] = ratio;
  if (isolated) values[name + ISOLATED] = ratio;
  others.add(store.seconds(t_us), values);
  ratios.set(sensor, { ratio, isolated });
}

function showSensor(decision) {
  const chip = sensors.get(decision.sensor) || $("sensors").appendChild(make("li"));
  sensors.set(decision.sensor, chip);
  verdicts.addSensor(decision);
  followCurve(decision);
  const { alarm, isolated } = decision;
  store.note(decision.sensor, decision.t_us, { statistic: decision.statistic, threshold: decision.threshold, alarm, isolated });
}

function showError(error) {
  attitude.add(store.seconds(error.t_us), { [error.estimator]: error.angle });
  store.note(`attitude error ${error.estimator}`, error.t_us, { roll_deg: error.roll, pitch_deg: error.pitch, yaw_deg: error.yaw, angle_deg: error.angle });
}

function showFused(state) {
  const [x_m, y_m, z_m] = state.position_ecef_m, [vn_mps, ve_mps, vd_mps] = state.velocity_ned_mps, [qw, qx, qy, qz] = state.q_nb;
  store.note("fusion", state.t_us, { x_m, y_m, z_m, vn_mps, ve_mps, vd_mps, qw, qx, qy, qz, sigma_m: Math.max(...state.position_sigma_m), reason: state.reason || "" });
}

// -- links ------------------------------------------------------------------------------------

const FIGURES = { name: "link", frames_in: "in", chunks_out: "out", faulted: "faulted", gaps: "missing", lost_in_kernel: "lost in kernel", crc_errors: "bad CRC",
  drops: "drops", delays_lost: "lost in a full delay queue", p50_us: "median µs", p99_us: "99 % µs" };

function showLinks(points) {
  const list = Array.isArray(points) ? points : [];
  $("links-title").hidden = !list.length;
  const used = Object.keys(FIGURES).filter((key) => list.some((one) => one[key] != null && (one[key] || key !== "delays_lost")));
  fillTable($("links"), used.map((key) => FIGURES[key]), list.map((one) => used.map((key) => one[key])));
}

// Show why nothing is recorded; lost records stay visible when recording continues.
function showRecording({ failing = null, lost_records: lost = 0 }) {
  const missing = lost ? `${lost} record${lost === 1 ? " is" : "s are"} missing in the logs.` : "";
  $("recording").hidden = !failing && !lost;
  $("recording").className = failing ? "gone" : "note";
  $("recording").textContent = failing ? `Recording has stopped: ${failing}. ${missing}` : missing;
}

// -- events -----------------------------------------------------------------------------------

function addEvent(t_us, text, kind) {
  const item = make("li", { className: kind }, make("time", { textContent: `${store.seconds(t_us).toFixed(1)} s` }), text);
  $("events").prepend(item);
  while ($("events").children.length > EVENTS_SHOWN) $("events").lastChild.remove();
  $("no-events").hidden = true;
}

const RESULTS = ["accepted", "rejected for now", "denied", "unsupported", "failed", "in progress", "cancelled"]; // MAV_RESULT
const COMMANDS = { 17: "hold", 20: "return", 21: "land", 22: "take off", 176: "set mode", 300: "start mission", 400: "arm or disarm" }; // MAV_CMD

// The vehicle's answers to commands from any sender.
function showAnswers(batch) {
  for (const { message, fields, received } of batch) {
    if (message !== "COMMAND_ACK") continue;
    const command = fields.indexOf("command") + 1, result = fields.indexOf("result") + 1;
    for (const row of received) {
      addEvent(row[0], `command ${COMMANDS[row[command]] || row[command]}: ${RESULTS[row[result]] || row[result]}`, row[result] === 0 || row[result] === 5 ? "done" : "bad");
    }
  }
}

function showEvent(one) {
  const text = one.type === "SensorDecision" ? `${nameOf(one)}: ${describeState(one)}`
    : one.hypothesis === "none" ? "satellites: consistent" : describeDecision(one);
  addEvent(one.t_us, text, one.alarm ? "bad" : "");
}

function showLabel(label) {
  const at_us = label.end_us ?? label.changed_us ?? label.start_us;
  const what = label.by ? `${label.fault} by the ${label.by} ${label.end_us == null ? "starts" : "ended"}`
    : label.end_us != null ? `fault ended after ${label.frames || 0} frame${label.frames === 1 ? "" : "s"}`
    : label.changed_us != null ? `value set to ${+label.value.toPrecision(6)}` : `fault starts on ${shorten(targetsOf(label))}`;
  const begin = store.seconds(label.start_us);
  faultIntervals.set(`${label.id} ${label.start_us}`, [begin, label.end_us == null ? null : store.seconds(label.end_us)]);
  addEvent(at_us, `${label.id}: ${what}`, "done");
}
