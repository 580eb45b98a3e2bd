"use strict";
// The current verdict of all detectors, and when and why the last isolation ended. Verdicts on satellites or a
// receiver's fixes come as decisions, those on other sensors as sensor decisions.

const WHY_S = 20; // a fault that ended at most this long ago explains the end of an isolation
const NAMES = { imu: "IMU", baro: "barometer", airspeed: "airspeed", mag: "magnetometer", vision: "vision", range: "rangefinder",
  "gps-position": "GPS position", "gps-velocity": "GPS velocity" };
const HYPOTHESES = { imu: "IMU", clock: "receiver clock", gps: "GPS position", "imu-or-mag": "IMU or magnetometer", "multiple-unknown": "several satellites, not isolated" };
const NO_FAULT = "no fault found", NOT_TESTED = "no fault found, nothing tested now";
const AGREES = "it is consistent with the others again", FLIGHT_OVER = "the flight ended";

// The part that a decision on a sensor finds faulty: a motor of the actuators, else the sensor.
const nameOf = ({ sensor, suspect }) => HYPOTHESES[suspect] || suspect || NAMES[sensor] || sensor;

// The satellites or the sensor that a decision names.
function partsOf({ hypothesis, excluded }) {
  return excluded.length ? excluded : ["none", "untestable"].includes(hypothesis) ? [] : [HYPOTHESES[hypothesis] || hypothesis];
}

function describeFault(parts) {
  const satellites = parts.filter((part) => /^[A-Z]\d+$/.test(part)), others = parts.filter((part) => !satellites.includes(part));
  if (satellites.length) others.unshift(`satellite${satellites.length > 1 ? "s" : ""} ${satellites.join(", ")}`);
  return `fault in ${others.join(", ")}`;
}

// A decision as text, with the excluded satellites.
function describeDecision(decision) {
  if (decision.hypothesis === "untestable") return `cannot be tested: ${decision.reason || "too little data"}`;
  const parts = partsOf(decision);
  return parts.length ? describeFault(parts) : NO_FAULT;
}

class Verdicts {
  constructor() { this.clear(); }
  clear() {
    this.decision = null;
    this.sensors = new Map(); // the newest decision on each sensor
    this.waiting = []; // decisions since the last update
    this.isolations = new Map(); // by sensor or satellite: since when faulty and isolated, and the detectors that find so
    this.newest_us = this.came_us = -Infinity; // of the verdicts; of those not processed yet
    this.passed = null; // the newest verdict, and the vehicle's time at its arrival
    this.fresh = false; // there is something new to draw
    this.ended = "";
  }
  addDecision(decision) {
    this.decision = decision;
    this.waiting.push({ detector: "epoch", parts: partsOf(decision), t_us: decision.t_us, tested: false,
      isolated: decision.hypothesis !== "multiple-unknown" });
  }
  // Tests have a statistic and report until they pass; stream monitors report only while something is wrong.
  addSensor(decision) {
    const { sensor, t_us, statistic, alarm, isolated } = decision, part = nameOf(decision);
    const tested = statistic !== null, bad = alarm || isolated;
    this.came_us = Math.max(this.came_us, t_us);
    if (!tested && !bad) return; // without a reference nothing was found, and no isolation ends
    this.sensors.set(sensor, decision);
    this.waiting.push({ detector: sensor, parts: bad ? [part] : [], t_us, tested, isolated });
  }
  // A detector finds these parts faulty, and no others.
  find({ detector, parts, t_us, tested, isolated }) {
    this.came_us = Math.max(this.came_us, t_us);
    for (const part of parts) {
      if (!this.isolations.has(part)) this.isolations.set(part, { from_us: t_us, isolated_us: null, by: new Map() });
      const found = this.isolations.get(part);
      if (isolated) found.isolated_us ??= t_us;
      found.last_us = t_us;
      found.by.set(detector, { t_us, tested: tested || found.by.get(detector)?.tested });
    }
    const over = [...this.isolations].filter(([part, { by }]) => !parts.includes(part) && by.delete(detector) && !by.size);
    this.end(over, t_us, AGREES);
  }
  // A verdict that is not repeated stays current for as long as a curve bridges missing samples.
  isCurrent(t_us) { return Math.abs(this.newest_us - t_us) <= GAP_S * 1e6; }
  isBad(sensor) { return [...this.isolations.values()].some(({ by }) => by.has(sensor)); }
  stateOf(sensor) {
    const decision = this.sensors.get(sensor);
    if (!decision) return "not tested";
    if (this.isBad(sensor)) return describeState(decision);
    return !decision.alarm && !decision.isolated && this.isCurrent(decision.t_us) ? "consistent" : "no fault found now";
  }
  now() {
    const bad = this.isolations.size > 0, current = this.decision && this.isCurrent(this.decision.t_us);
    const text = bad ? describeFault([...this.isolations.keys()]) : current ? describeDecision(this.decision)
      : [...this.sensors.keys()].some((sensor) => this.stateOf(sensor) === "consistent") ? NO_FAULT : NOT_TESTED;
    return { bad, text };
  }
  // Stream monitors may be silent for long: then the vehicle's time advances the verdicts' time.
  advance() {
    const came = this.came_us > -Infinity;
    if (came) this.passed = [this.came_us, store.newest_us]; // also after a clock reset
    else if (!this.passed || store.newest_us <= this.passed[1]) return false;
    const [verdict_us, vehicle_us] = this.passed;
    this.newest_us = verdict_us + store.newest_us - vehicle_us;
    this.came_us = -Infinity;
    return this.fresh = true;
  }
  // To be called after each batch: without reports an isolation ends some time after the last detection.
  update() {
    // The monitor's streams come one after the other: in the order of time, and a sensor's finding before the end of one.
    const order = (a, b) => a.t_us - b.t_us || (a.detector === "epoch") - (b.detector === "epoch");
    for (const one of this.waiting.splice(0).sort(order)) this.find(one);
    if (!this.advance()) return;
    for (const entry of this.isolations) {
      const { by } = entry[1];
      let last_us = -Infinity;
      for (const [detector, { t_us, tested }] of by) {
        if (!tested && !this.isCurrent(t_us)) by.delete(detector);
        last_us = Math.max(last_us, t_us);
      }
      if (!by.size) this.end([entry], last_us, `no fault was found in it for ${GAP_S} s`);
    }
  }
  // The flight is over: what is isolated now has its interval too.
  finish() { this.end([...this.isolations], this.newest_us, FLIGHT_OVER); }
  end(over, t_us, reason) {
    const since = ([, { from_us, isolated_us }]) => isolated_us ?? from_us;
    for (const [from_us, entries] of Map.groupBy(over, since)) {
      const parts = entries.map(([part]) => part), last_us = Math.max(...entries.map(([, found]) => found.last_us));
      const [from_s, last_s, to_s] = [from_us, last_us, t_us].map((one_us) => store.seconds(one_us));
      for (const part of parts) this.isolations.delete(part);
      const what = entries.some(([, { isolated_us }]) => isolated_us !== null) ? "isolation" : "alarm";
      this.ended = `${describeFault(parts)} from ${from_s.toFixed(1)} to ${last_s.toFixed(1)} s; ${reason !== FLIGHT_OVER && this.endedFault(from_s, to_s) || reason}`;
      addEvent(t_us, `${what} ended: ${this.ended}`, "done");
    }
  }
  // The last fault that began before an isolation did explains its end, unless it still acts.
  endedFault(from_s, to_s) {
    const [id, [, end_s]] = [...faultIntervals].filter(([, [begin]]) => begin <= from_s).at(-1) ?? ["", [0, null]];
    return end_s !== null && end_s <= to_s && end_s > to_s - WHY_S && `${id.replace(/ \d+$/, "")} ended at ${end_s.toFixed(1)} s`;
  }
}

const verdicts = new Verdicts();

// Unchanged text is left alone: screen readers announce changes only, and there is no new layout.
function retext(element, text) { if (element.textContent !== text) element.textContent = text; }

// What is injected, and the current verdict of all detectors, side by side.
function showVerdict() {
  const { bad, text } = verdicts.now();
  const acting = state.faults.filter((one) => one.state === "active").map((one) => one.id);
  const calm = text === NO_FAULT && !acting.length; // a fault that acts undetected is no good news
  $("injected").hidden = !acting.length;
  retext($("injected"), `injected: ${shorten(acting)}`);
  $("verdict").hidden = false;
  $("verdict").className = `badge ${bad ? "alarm" : calm ? "calm" : ""}`;
  const last = verdicts.ended && (text === NO_FAULT || text === NOT_TESTED) ? ` (last: ${verdicts.ended})` : "";
  retext($("verdict"), `${bad ? "⚠" : calm ? "✓" : "–"} ${text}${last}`);
  $("clock").textContent = `${store.seconds(verdicts.newest_us).toFixed(1)} s`;
}
