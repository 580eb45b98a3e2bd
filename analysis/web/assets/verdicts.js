"use strict";
// The current verdict of all detectors, and when and why the last isolation ended. Verdicts on satellites or a
// receiver's fixes come as decisions, those on other sensors as sensor decisions.

const WHY_S = 20; // a fault that ended at most this long ago explains the end of an isolation
const NAMES = { imu: "IMU", baro: "barometer", airspeed: "airspeed", mag: "magnetometer", vision: "vision", range: "rangefinder",
  "gps-position": "GPS position", "gps-velocity": "GPS velocity" };
const HYPOTHESES = { satellites: "satellites", imu: "IMU", clock: "receiver clock", gps: "GPS position", "multiple-unknown": "several satellites, not isolated" };
const NO_FAULT = "no fault found", NOT_TESTED = "no fault found, nothing tested now";

// A decision as text, with the excluded satellites.
function describeDecision(decision) {
  if (decision.hypothesis === "none") return NO_FAULT;
  if (decision.hypothesis === "untestable") return `cannot be tested: ${decision.reason || "too little data"}`;
  const out = decision.excluded.length ? ` ${decision.excluded.join(", ")}` : "";
  return `fault in ${HYPOTHESES[decision.hypothesis] || decision.hypothesis}${out}`;
}

// The sensors or satellites that a verdict names.
function partsOf(text) { return text.replace(/^fault in (satellites )?/, "").split(", "); }

class Verdicts {
  constructor() { this.clear(); }
  clear() {
    this.decision = null;
    this.sensors = new Map();
    this.newest_us = this.came_us = -Infinity; // of the verdicts; of those not processed yet
    this.passed = null; // the newest verdict, and the vehicle's time at its arrival
    this.fresh = false; // there is something new to draw
    this.isolation = null;
    this.ended = "";
  }
  addDecision(decision) {
    this.decision = decision;
    this.came_us = Math.max(this.came_us, decision.t_us);
  }
  // Tests have a statistic and report continually; stream monitors report only while something is wrong.
  addSensor({ sensor, t_us, statistic, alarm, isolated }) {
    const one = this.sensors.get(sensor) || { tested_us: null, watched_us: null, bad_us: null, agreed_us: null, found: "" };
    this.sensors.set(sensor, one);
    if (alarm || isolated) {
      one[statistic === null ? "watched_us" : "tested_us"] = one.bad_us = t_us;
      one.found = isolated ? "isolated" : "alarm";
    } else Object.assign(one, { tested_us: null, agreed_us: t_us });
    this.came_us = Math.max(this.came_us, t_us);
  }
  // A verdict that is not repeated stays current for as long as a curve bridges missing samples.
  isCurrent(t_us) { return t_us !== null && Math.abs(this.newest_us - t_us) <= GAP_S * 1e6; }
  isBad(sensor) {
    const { tested_us, watched_us } = this.sensors.get(sensor);
    return this.isCurrent(tested_us) || this.isCurrent(watched_us);
  }
  stateOf(sensor) {
    const { found, agreed_us } = this.sensors.get(sensor);
    return this.isBad(sensor) ? found : this.isCurrent(agreed_us) ? "consistent" : "no fault found now";
  }
  // The decision of a recent epoch, if there is one.
  get current() { return this.decision && this.isCurrent(this.decision.t_us) ? this.decision : null; }
  now() {
    const { current } = this, faulty = [...this.sensors.keys()].filter((sensor) => this.isBad(sensor));
    const found = current?.alarm || current?.excluded.length > 0;
    const text = faulty.length && (!found || current.hypothesis === "none") ? `fault in ${faulty.map((name) => NAMES[name] || name).join(", ")}`
      : current ? describeDecision(current) : [...this.sensors.values()].some((one) => this.isCurrent(one.agreed_us)) ? NO_FAULT : NOT_TESTED;
    return { bad: Boolean(found || faulty.length), text };
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
  // To be called after each batch: starts or ends an isolation, and reports its end.
  update() {
    if (!this.advance()) return;
    const { bad, text } = this.now(), t_us = this.newest_us;
    if (bad) {
      const parts = text === NO_FAULT ? [] : partsOf(text); // none: the sensor is excluded, and its last test has passed
      const before = this.isolation?.starts ?? new Map();
      // Other sensors or satellites only: an isolation of its own.
      if (parts.length && before.size && !parts.some((part) => before.has(part))) this.end(t_us, `then ${text}`);
      this.isolation ||= { text, from_us: t_us, starts: new Map() };
      if (parts.length) { // it begins with the first of those that are still isolated
        const starts = new Map(parts.map((part) => [part, before.get(part) ?? t_us]));
        Object.assign(this.isolation, { text, starts, from_us: Math.min(...starts.values()) });
      }
      const sensors = this.isolation.sensors = [...this.sensors.keys()].filter((sensor) => this.isBad(sensor));
      this.isolation.found_us = Math.max(...sensors.map((name) => this.sensors.get(name).bad_us), this.current?.t_us ?? -Infinity);
    } else if (this.isolation) this.end(t_us);
  }
  // A passing test ends it at once; without reports it ends some time after the last detection.
  end(t_us, next) {
    const { text, from_us, found_us, sensors } = this.isolation;
    const agrees = sensors.length ? sensors.every((name) => this.sensors.get(name).agreed_us > this.sensors.get(name).bad_us) : this.current;
    const [from, to] = [from_us, agrees ? t_us : found_us].map((one_us) => store.seconds(one_us).toFixed(1));
    this.ended = `${text} from ${from} to ${to} s; ${next || this.endReason(t_us, agrees)}`;
    this.isolation = null;
    addEvent(t_us, `isolation ended: ${this.ended}`, "done");
  }
  endReason(t_us, agrees) {
    const t_s = store.seconds(t_us);
    const ended = [...faultIntervals].filter(([, [, end]]) => end !== null && end <= t_s && end > t_s - WHY_S).at(-1);
    if (ended) return `${ended[0].replace(/ \d+$/, "")} ended at ${ended[1][1].toFixed(1)} s`;
    return agrees ? "it is consistent with the others again" : `no fault was found in it for ${GAP_S} s`;
  }
}

const verdicts = new Verdicts();

// Unchanged text is left alone: screen readers announce changes only, and there is no new layout.
function retext(element, text) { if (element.textContent !== text) element.textContent = text; }

// One line with the current verdict of all detectors.
function showVerdict() {
  const { bad, text } = verdicts.now();
  const acting = bad ? [] : state.faults.filter((one) => one.state === "active").map((one) => one.id);
  const calm = text !== NOT_TESTED && !acting.length; // a fault that acts undetected is no good news
  $("verdict").hidden = false;
  $("verdict").className = `badge ${bad ? "alarm" : calm ? "calm" : ""}`;
  const last = verdicts.ended && (text === NO_FAULT || text === NOT_TESTED) ? ` (last: ${verdicts.ended})` : "";
  const undetected = acting.length ? `, while ${shorten(acting)} act${acting.length === 1 ? "s" : ""}` : "";
  retext($("verdict"), `${bad ? "⚠" : calm ? "✓" : "–"} ${text}${undetected}${last}`);
  $("clock").textContent = `${store.seconds(verdicts.newest_us).toFixed(1)} s`;
}
