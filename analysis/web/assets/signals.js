"use strict";
// Plots of single fields: received by the proxy, forwarded by it, and true.

const MAX_SIGNALS = 6;
const LINES = [0, 3.5, 1.5, 1.2]; // widths in pixels: time, received, forwarded, truth
const FIRST = ["HIL_SENSOR.xgyro", "ATTITUDE.rollspeed", "RAW_IMU.xgyro"];
const DEGREES = 180 / Math.PI;

// The field to plot for a fault that acts on an entire message.
const DEFAULT_FIELDS = { HIL_SENSOR: "xgyro", HIL_GPS: "lat", GPS_RAW_INT: "lat", ATTITUDE: "roll", ATTITUDE_QUATERNION: "q1",
  GLOBAL_POSITION_INT: "relative_alt", VFR_HUD: "airspeed", ODOMETRY: "x", RAW_IMU: "xgyro", DISTANCE_SENSOR: "current_distance" };

// Fields whose truth is in HIL_STATE_QUATERNION, and the factor between the units.
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

// The truth of a field as rows and a function that reads its value.
function truthOf(name, end_us, span_us) {
  const table = store.tables.get("HIL_STATE_QUATERNION");
  const [field, factor = 1] = TRUTH[name] || [];
  if (!table || field === undefined) return [[], null];
  const q = table.place("attitude_quaternion"), place = table.place(field);
  const read = typeof field === "number" ? (row) => angles(row.slice(q, q + 4))[field] : (row) => row[place] * factor;
  return [table.window("sent", end_us, span_us), read];
}

// Rows [t_us, ...] as two columns, reduced to the screen's resolution; interrupted at unusually long gaps.
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
    this.note = make("p", { className: "note", textContent: "nothing received yet" });
    const close = make("button", { type: "button", className: "small", textContent: "Remove", onclick: remove, ariaLabel: `Remove ${name}` });
    const unit = this.range ? "m" : catalogue?.units[name.split("[")[0]], scaled = unit === "1e-7 deg"; // as people read positions
    this.scale = scaled ? 1e-7 : 1;
    this.area = make("div", { className: "plot" });
    this.now = make("span", { className: "now" });
    this.element = make("div", { className: "signal" },
      make("div", { className: "title" }, make("b", { textContent: name }), unit ? `, ${scaled ? "deg" : unit}` : "", this.now, close), this.note, this.area);
    area.append(this.element);
    this.observer = new ResizeObserver(() => this.plot?.setSize(this.size()));
    this.observer.observe(this.area);
  }
  size() { return { width: Math.max(240, this.area.clientWidth), height: 150 }; }
  // A range is 20,000 km and changes constantly: only the change by a fault is visible.
  changes(table, place, span_us) {
    const came = new Map(table.window("received", store.newest_us, span_us).map((row) => [row[0], row[place]]));
    return table.window("sent", store.newest_us, span_us).map((row) => [row[0], row[place] == null ? null : row[place] - came.get(row[0])]);
  }
  // Returns whether there was something to draw.
  draw() {
    const table = store.tables.get(this.message);
    const drawn = `${shown.end_s} ${shown.span_s}`;
    if (!table?.has(this.field) || drawn === this.drawn) return false;
    this.drawn = drawn;
    const span_us = shown.span_s * 1e6, place = table.place(this.field);
    const received = table.window("received", store.newest_us, span_us);
    if (!received.length) return false;
    const usual_us = (received.at(-1)[0] - received[0][0]) / Math.max(1, received.length - 1) || 1e6;
    const pick = (row) => row[place] == null ? null : row[place] * this.scale;
    const [rows, truth] = truthOf(this.name, store.newest_us, span_us);
    const sent = this.range ? this.changes(table, place, span_us) : table.window("sent", store.newest_us, span_us);
    const came = column(received, this.range ? () => 0 : pick, usual_us);
    const data = uPlot.join([
      came,
      !this.range && !table.faulted ? came : column(sent, this.range ? (row) => row[1] : pick, usual_us),
      column(rows, (row) => truth(row) * this.scale, 1e9),
    ], [[1, 1], [1, 1], [1, 1]]);
    this.note.hidden = true;
    const digits = (value) => value == null ? "–" : String(+(value * this.scale).toPrecision(Math.abs(value) > 1e5 ? 9 : 5));
    this.now.textContent = this.range ? `forwarded minus received ${digits(sent.at(-1)?.[1])}`
      : `received ${digits(table.newest(this.field, "received"))}, forwarded ${digits(table.newest(this.field))}`;
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
      axes: [x, { ...y, size: axisWidth }], hooks: { drawClear: [shadeFaults] },
      series: [{ label: "t", value: (u, t) => t == null ? "–" : `${t.toFixed(2)} s` },
        line("received", "--s0", { alpha: 0.45 }), line("forwarded", "--s1"), line("truth", "--s2", { dash: [5, 4] })],
    }, data, this.area);
    this.plot.over.setAttribute("aria-hidden", "true");
  }
  remove() {
    this.observer.disconnect();
    this.plot?.destroy();
    this.element.remove();
  }
}

// Width for the longest number of an axis.
function axisWidth(u, values) {
  return 16 + 7 * Math.max(4, ...(values || []).map((text) => String(text).length));
}

class Signals {
  // Fields picked by the viewer are kept; the two newest fields that faults act on are added automatically.
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
    this.layOut();
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
    this.layOut();
  }
  layOut() {
    const names = [...new Set([...this.picked, ...this.followed])].filter((name) => !this.removed.has(name)).slice(0, MAX_SIGNALS);
    for (const [name, signal] of this.shown) if (!names.includes(name)) { signal.remove(); this.shown.delete(name); }
    for (const name of names) {
      if (!this.shown.has(name)) this.shown.set(name, new Signal(name, this.area, () => this.drop(name)));
    }
    requestMessages([...this.shown.values()].map((signal) => signal.message));
  }
  drop(name) {
    this.picked.delete(name);
    this.removed.add(name);
    this.layOut();
    $("field").focus();
  }
  // Show a field before any fault has acted.
  begin() {
    if (this.shown.size || this.removed.size) return;
    const found = FIRST.find((name) => store.tables.has(name.split(".")[0]));
    if (found) { this.followed = [found]; this.layOut(); }
  }
}

// The field to plot for a fault's target; undefined for the simulated plant.
function fieldOf(target) {
  const [message, field] = target.split(".");
  if (message === "PLANT") return undefined;
  const some = field || DEFAULT_FIELDS[message] || Object.keys(catalogue?.units || {}).find((name) => name.startsWith(`${message}.`))?.split(".")[1];
  return some && `${message}.${some}`;
}

const signals = new Signals($("signals"));
$("pick").onsubmit = (event) => {
  event.preventDefault();
  const name = $("field").value.trim();
  if (!/^\w+\.\w+(\[\d+\])?$/.test(name)) return showMessage("field-message", `${name || "nothing"} is not a field; write MESSAGE.field, such as HIL_GPS.alt`);
  showMessage("field-message", "");
  $("field").value = "";
  signals.pick(name);
};
