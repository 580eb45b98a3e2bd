"use strict";
// Who is blamed just now, by any detector, and when the last blame ended and why. Verdicts on
// satellites or on a receiver's fixes come as decisions; without them those on sensors are enough.

const WHY_S = 20; // a fault that ended so shortly before explains the end of its blame
const NAMES = { imu: "IMU", baro: "barometer", airspeed: "airspeed", mag: "magnetometer", vision: "vision", range: "rangefinder",
  "gps-position": "GPS position", "gps-velocity": "GPS velocity" };
const BLAMED = { satellites: "satellites", imu: "IMU", clock: "receiver clock", gps: "GPS position", "multiple-unknown": "several satellites, not told apart" };
const CALM = "no fault found", SILENT = "nothing found, nothing tested now";

// In words, with the satellites that are left out.
function spoken(decision) {
  if (decision.hypothesis === "none") return CALM;
  if (decision.hypothesis === "untestable") return `cannot be tested: ${decision.reason || "too little data"}`;
  const out = decision.excluded.length ? ` ${decision.excluded.join(", ")}` : "";
  return `fault in ${BLAMED[decision.hypothesis] || decision.hypothesis}${out}`;
}

class Verdicts {
  constructor() { this.clear(); }
  clear() {
    this.decision = null;
    this.sensors = new Map();
    this.newest_us = this.came_us = -Infinity; // of the verdicts; of those that are not followed yet
    this.passed = null; // the newest verdict, and the vehicle's time when it came
    this.fresh = false; // something came that is not drawn yet
    this.blame = null;
    this.ended = "";
  }
  addDecision(decision) {
    this.decision = decision;
    this.came_us = Math.max(this.came_us, decision.t_us);
  }
  // Tests have a statistic and come again and again; what only watches speaks while something is wrong.
  addSensor({ sensor, t_us, statistic, alarm, isolated }) {
    const one = this.sensors.get(sensor) || { tested_us: null, watched_us: null, bad_us: null, agreed_us: null, found: "" };
    this.sensors.set(sensor, one);
    if (alarm || isolated) {
      one[statistic === null ? "watched_us" : "tested_us"] = one.bad_us = t_us;
      one.found = isolated ? "isolated" : "alarm";
    } else Object.assign(one, { tested_us: null, agreed_us: t_us });
    this.came_us = Math.max(this.came_us, t_us);
  }
  // A verdict that is not repeated stands as long as a curve goes on without samples.
  stands(t_us) { return t_us !== null && Math.abs(this.newest_us - t_us) <= GAP_S * 1e6; }
  isBad(sensor) {
    const { tested_us, watched_us } = this.sensors.get(sensor);
    return this.stands(tested_us) || this.stands(watched_us);
  }
  stateOf(sensor) {
    const { found, agreed_us } = this.sensors.get(sensor);
    return this.isBad(sensor) ? found : this.stands(agreed_us) ? "agrees" : "nothing found now";
  }
  // The decision of an epoch not long ago, if there was one.
  get current() { return this.decision && this.stands(this.decision.t_us) ? this.decision : null; }
  now() {
    const { current } = this, blamed = [...this.sensors.keys()].filter((sensor) => this.isBad(sensor));
    const found = current?.alarm || current?.excluded.length > 0;
    const words = blamed.length && (!found || current.hypothesis === "none") ? `fault in ${blamed.map((name) => NAMES[name] || name).join(", ")}`
      : current ? spoken(current) : [...this.sensors.values()].some((one) => this.stands(one.agreed_us)) ? CALM : SILENT;
    return { bad: Boolean(found || blamed.length), words };
  }
  // Where only what watches streams speaks, nothing may come for long: then the vehicle's time goes on.
  advance() {
    const came = this.came_us > -Infinity;
    if (came) this.passed = [this.came_us, store.newest_us]; // also where a clock has begun anew
    else if (!this.passed || store.newest_us <= this.passed[1]) return false;
    const [verdict_us, vehicle_us] = this.passed;
    this.newest_us = verdict_us + store.newest_us - vehicle_us;
    this.came_us = -Infinity;
    return this.fresh = true;
  }
  // To be called when all that came together is added: begins or ends a blame, and tells of an end.
  follow() {
    if (!this.advance()) return;
    const { bad, words } = this.now(), t_us = this.newest_us;
    if (bad) {
      this.blame ||= { words, from_us: t_us };
      if (words !== CALM) this.blame.words = words; // it is left out, and its last test has passed
      const sensors = this.blame.sensors = [...this.sensors.keys()].filter((sensor) => this.isBad(sensor));
      this.blame.found_us = Math.max(...sensors.map((name) => this.sensors.get(name).bad_us), this.current?.t_us ?? -Infinity);
    } else if (this.blame) this.end(t_us);
  }
  // Seen by a test that passes at once; where nobody speaks, a while after it was found last.
  end(t_us) {
    const { words, from_us, found_us, sensors } = this.blame;
    const agrees = sensors.length ? sensors.every((name) => this.sensors.get(name).agreed_us > this.sensors.get(name).bad_us) : this.current;
    const [from, to] = [from_us, agrees ? t_us : found_us].map((one_us) => store.seconds(one_us).toFixed(1));
    this.ended = `${words} from ${from} to ${to} s; ${this.why(t_us, agrees)}`;
    this.blame = null;
    addEvent(t_us, `blame ended: ${this.ended}`, "done");
  }
  why(t_us, agrees) {
    const t_s = store.seconds(t_us);
    const over = [...stretches].filter(([, [, end]]) => end !== null && end <= t_s && end > t_s - WHY_S).at(-1);
    if (over) return `${over[0].replace(/ \d+$/, "")} ended at ${over[1][1].toFixed(1)} s`;
    return agrees ? "it agrees with the others again" : `nothing was found against it for ${GAP_S} s`;
  }
}

const verdicts = new Verdicts();

// A screen reader says what changes, and nothing is laid out anew for what does not.
function retext(element, text) { if (element.textContent !== text) element.textContent = text; }

// One line that says what is found just now, by any detector.
function showVerdict() {
  const { bad, words } = verdicts.now();
  $("verdict").hidden = false;
  $("verdict").className = `badge ${bad ? "alarm" : words === SILENT ? "" : "calm"}`;
  const last = verdicts.ended && (words === CALM || words === SILENT) ? ` (last: ${verdicts.ended})` : "";
  retext($("verdict"), `${bad ? "⚠" : words === SILENT ? "–" : "✓"} ${words}${last}`);
  $("clock").textContent = `${store.seconds(verdicts.newest_us).toFixed(1)} s`;
}
