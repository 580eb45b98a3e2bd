"use strict";
// Plots of single fields: as they came to the proxy, as they left it, and what was true.

const MOST_SIGNALS = 6;
const LINES = [0, 3.5, 1.5, 1.2]; // widths in pixels: time, received, sent on, truth
const FIRST = ["HIL_SENSOR.xgyro", "ATTITUDE.rollspeed", "RAW_IMU.xgyro"];
const DEGREES = 180 / Math.PI;

// What stands for a message where a fault takes it whole.
const STANDS_FOR = { HIL_SENSOR: "xgyro", HIL_GPS: "lat", GPS_RAW_INT: "lat", ATTITUDE: "roll", ATTITUDE_QUATERNION: "q1",
  GLOBAL_POSITION_INT: "relative_alt", VFR_HUD: "airspeed", ODOMETRY: "x", RAW_IMU: "xgyro", DISTANCE_SENSOR: "current_distance" };

// Fields of which HIL_STATE_QUATERNION holds the truth, and the factor between the units.
const G_MPS2 = 9.80665e-3; // of one mG
const TRUTH = {
  "HIL_SENSOR.xgyro": ["rollspeed"], "HIL_SENSOR.ygyro": ["pitchspeed"], "HIL_SENSOR.zgyro": ["yawspeed"],
  "HIL_SENSOR.xacc": ["xacc", G_MPS2], "HIL_SENSOR.yacc": ["yacc", G_MPS2], "HIL_SENSOR.zacc": ["zacc", G_MPS2],
  "ATTITUDE.rollspeed": ["rollspeed"], "ATTITUDE.pitchspeed": ["pitchspeed"], "ATTITUDE.yawspeed": ["yawspeed"],
};
for (const name of ["HIL_GPS", "GPS_RAW_INT", "GLOBAL_POSITION_INT"]) for (const field of ["lat", "lon", "alt"]) TRUTH[`${name}.${field}`] = [field];
for (const [one, other] of [["vn", "vx"], ["ve", "vy"], ["vd", "vz"]]) TRUTH[`HIL_GPS.${one}`] = [other];
for (const field of ["vx", "vy", "vz"]) TRUTH[`GLOBAL_POSITION_INT.${field}`] = [field];
for (const number of [0, 1, 2, 3]) TRUTH[`ATTITUDE_QUATERNION.q${number + 1}`] = [`attitude_quaternion[${number}]`];
for (const [number, field] of ["roll", "pitch", "yaw"].entries()) TRUTH[`ATTITUDE.${field}`] = [number];

// Roll, pitch and yaw in radians of a quaternion (w, x, y, z) from body to north-east-down.
function angles([w, x, y, z]) {
  return [Math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
    Math.asin(Math.max(-1, Math.min(1, 2 * (w * y - x * z)))),
    Math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))];
}

// The truth of a field as rows and what to read from them.
function truthOf(name, end_us, span_us) {
  const table = store.tables.get("HIL_STATE_QUATERNION");
  const [field, factor = 1] = TRUTH[name] || [];
  if (!table || field === undefined) return [[], null];
  const q = table.place("attitude_quaternion"), place = table.place(field);
  const read = typeof field === "number" ? (row) => angles(row.slice(q, q + 4))[field] : (row) => row[place] * factor;
  return [table.window("sent", end_us, span_us), read];
}

// Rows [t_us, ...] as two columns, as many as can be told apart; a break where far more time passed than is usual.
function column(rows, read, usual_us) {
  const t = [], y = [], far_us = Math.max(4 * usual_us, 2e6 * shown.span_s / BINS);
  let before = null;
  extremes(rows.length, (i) => rows[i][0] / 1e6, (i) => read(rows[i]), (i) => {
    const t_us = rows[i][0];
    if (before !== null && t_us - before > far_us) { t.push(store.seconds(before + usual_us)); y.push(null); }
    t.push(store.seconds(t_us));
    y.push(read(rows[i]));
    before = t_us;
  });
  return [t, y];
}

class Signal {
  // `name` is MESSAGE.field or MESSAGE.field[3].
  constructor(name, area, remove) {
    this.name = name;
    const [message, field] = name.split(".");
    Object.assign(this, { message, field, range: message === "PSEUDORANGE", plot: null, drawn: "" });
    this.said = make("p", { className: "note", textContent: "nothing of it has come yet" });
    const close = make("button", { type: "button", className: "small", textContent: "Remove", onclick: remove });
    close.setAttribute("aria-label", `Remove ${name}`);
    const unit = this.range ? "m" : catalogue?.units[name.split("[")[0]];
    this.area = make("div", { className: "plot" });
    this.now = make("span", { className: "now" });
    this.element = make("div", { className: "signal" },
      make("div", { className: "title" }, make("b", { textContent: name }), unit ? `, ${unit}` : "", this.now, close), this.said, this.area);
    area.append(this.element);
    this.observer = new ResizeObserver(() => this.plot?.setSize(this.size()));
    this.observer.observe(this.area);
  }
  size() { return { width: Math.max(240, this.area.clientWidth), height: 150 }; }
  // A range is 20,000 km and changes by the second: only what a fault adds to it can be seen.
  changes(table, place, span_us) {
    const came = new Map(table.window("received", store.newest_us, span_us).map((row) => [row[0], row[place]]));
    return table.window("sent", store.newest_us, span_us).map((row) => [row[0], row[place] == null ? null : row[place] - came.get(row[0])]);
  }
  // Whether there was something to draw.
  draw() {
    const table = store.tables.get(this.message);
    const drawn = `${shown.end_s} ${shown.span_s}`;
    if (!table?.has(this.field) || drawn === this.drawn) return false;
    this.drawn = drawn;
    const span_us = shown.span_s * 1e6, place = table.place(this.field);
    const received = table.window("received", store.newest_us, span_us);
    if (!received.length) return false;
    const usual_us = (received.at(-1)[0] - received[0][0]) / Math.max(1, received.length - 1) || 1e6;
    const pick = (row) => row[place];
    const sent = this.range ? this.changes(table, place, span_us) : table.window("sent", store.newest_us, span_us);
    const came = column(received, this.range ? () => 0 : pick, usual_us);
    const data = uPlot.join([
      came,
      !this.range && !table.faulted ? came : column(sent, this.range ? (row) => row[1] : pick, usual_us),
      column(...truthOf(this.name, store.newest_us, span_us), 1e9),
    ], [[1, 1], [1, 1], [1, 1]]);
    this.said.hidden = true;
    const digits = (value) => value == null ? "–" : String(+value.toPrecision(Math.abs(value) > 1e5 ? 10 : 5));
    this.now.textContent = this.range ? `sent on minus received ${digits(sent.at(-1)?.[1])}`
      : `received ${digits(table.newest(this.field, "received"))}, sent on ${digits(table.newest(this.field))}`;
    if (!this.plot) this.make(data);
    this.plot.series.forEach((one, number) => { one.width = lineWidth(LINES[number]); });
    this.plot.setData(data);
    return true;
  }
  make(data) {
    const line = (label, stroke, more) => ({ label, stroke: () => colour(stroke), points: { show: false },
      value: (u, value) => value == null ? "–" : String(+value.toPrecision(10)), ...more });
    const [x, y] = plotAxes();
    this.plot = new uPlot({
      ...this.size(), pxAlign: 0, cursor: { drag: { x: false, y: false }, sync: SYNC },
      scales: { x: { time: false, range: shownRange } },
      axes: [x, { ...y, size: wide }], hooks: { drawClear: [shadeFaults] },
      series: [{ label: "t", value: (u, t) => t == null ? "–" : `${t.toFixed(2)} s` },
        line("received", "--s0", { alpha: 0.45 }), line("sent on", "--s1"), line("truth", "--s2", { dash: [5, 4] })],
    }, data, this.area);
    this.plot.over.setAttribute("aria-hidden", "true");
  }
  remove() {
    this.observer.disconnect();
    this.plot?.destroy();
    this.element.remove();
  }
}

// Room for the longest number of an axis.
function wide(u, values) {
  return 16 + 7 * Math.max(4, ...(values || []).map((text) => String(text).length));
}

class Signals {
  // What the viewer picked stays; what a fault acts on comes by itself, the newest two.
  constructor(area) {
    this.area = area;
    this.shown = new Map();
    this.picked = new Set();
    this.followed = [];
    this.acting = [];
    this.removed = new Set();
  }
  pick(name) {
    this.picked.add(name);
    this.removed.delete(name);
    this.lay();
  }
  follow(faults) {
    const before = this.acting;
    this.acting = faults.filter((one) => one.state === "active").flatMap(targetsOf).map(fieldOf).filter(Boolean);
    const begun = this.acting.filter((name) => !before.includes(name));
    const coming = begun.filter((name) => store.tables.has(name.split(".")[0]));
    const fresh = coming.length ? coming : begun;
    if (!fresh.length) return;
    for (const name of fresh) this.removed.delete(name);
    this.followed = [...new Set([...fresh, ...this.followed])].slice(0, 2);
    this.lay();
  }
  lay() {
    const names = [...new Set([...this.picked, ...this.followed])].filter((name) => !this.removed.has(name)).slice(0, MOST_SIGNALS);
    for (const [name, signal] of this.shown) if (!names.includes(name)) { signal.remove(); this.shown.delete(name); }
    for (const name of names) {
      if (!this.shown.has(name)) this.shown.set(name, new Signal(name, this.area, () => this.drop(name)));
    }
    wish([...this.shown.values()].map((signal) => signal.message));
  }
  drop(name) {
    this.picked.delete(name);
    this.removed.add(name);
    this.lay();
    $("field").focus();
  }
  // Something to see before any fault has acted.
  begin() {
    if (this.shown.size || this.removed.size) return;
    const found = FIRST.find((name) => store.tables.has(name.split(".")[0]));
    if (found) { this.followed = [found]; this.lay(); }
  }
}

// The field to plot for a fault's target; undefined for the simulated plant.
function fieldOf(target) {
  const [message, field] = target.split(".");
  if (message === "PLANT") return undefined;
  const some = field || STANDS_FOR[message] || Object.keys(catalogue?.units || {}).find((name) => name.startsWith(`${message}.`))?.split(".")[1];
  return some && `${message}.${some}`;
}

const signals = new Signals($("signals"));
$("pick").onsubmit = (event) => {
  event.preventDefault();
  const name = $("field").value.trim();
  if (!/^\w+\.\w+(\[\d+\])?$/.test(name)) return say("field-said", `${name || "nothing"} is no field; write MESSAGE.field, such as HIL_GPS.alt`);
  say("field-said", "");
  $("field").value = "";
  signals.pick(name);
};
