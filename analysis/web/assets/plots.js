"use strict";
// Plots over a sliding window, by uPlot, and the bars of the satellites.

const MAX_SPAN_S = 600;
const MAX_SAMPLES = 30000; // samples kept of a curve
const BAR_SIGMAS = 8; // a bar of full length
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

// The time interval of all plots: the newest seconds, with a common end.
const shown = { span_s: 60, end_s: -Infinity };
const SYNC = { key: "time", scales: ["x", null] };

function shownRange() {
  return Number.isFinite(shown.end_s) ? [shown.end_s - shown.span_s, shown.end_s] : [0, shown.span_s];
}

function plotAxes() {
  const common = { stroke: () => colour("--faint"), grid: { stroke: () => colour("--grid"), width: 1 },
    ticks: { stroke: () => colour("--grid"), width: 1 }, font: "12px system-ui, sans-serif" };
  // Nine digits: uPlot by itself rounds to three decimals.
  const digits = (u, ticks) => ticks.map((y) => y === null ? "" : String(+y.toPrecision(9)));
  return [{ ...common, size: 28, values: (u, ticks) => ticks.map((t) => `${+t.toFixed(3)} s`) }, { ...common, size: 66, values: digits }];
}

const logRange = (decades) => (u, min, max) => {
  if (!(max > 0)) return [0.1, 10];
  const top = 10 ** Math.ceil(Math.log10(max * 1.5));
  return [Math.max(10 ** Math.floor(Math.log10(min)), top / 10 ** decades), top];
};

// The intervals in which faults act, as [start, end or null] in seconds, by fault id and start.
const faultIntervals = new Map();

function shadeFaults(u) {
  const { left, top, width, height } = u.bbox, { ctx } = u;
  ctx.save();
  ctx.fillStyle = colour("--shade");
  for (const [begin, end] of faultIntervals.values()) {
    const from = Math.max(left, u.valToPos(begin, "x", true)), to = end === null ? left + width : Math.min(left + width, u.valToPos(end, "x", true));
    if (to > from) ctx.fillRect(from, top, Math.max(1, to - from), height);
  }
  ctx.restore();
}

const BINS = 400; // of the interval shown: a screen cannot resolve more than two samples in each

// Calls `keep` with the indices of the samples to draw: minimum and maximum of each bin, in order of time. Bins start
// at fixed times, so that a moving curve does not flicker. `null` is no sample.
function extremes(count, seconds, value, keep) {
  const bin_s = shown.span_s / BINS;
  let bin = null, least = 0, greatest = 0, low = 0, high = 0;
  const flush = () => {
    if (bin === null) return;
    keep(Math.min(least, greatest));
    if (least !== greatest) keep(Math.max(least, greatest));
  };
  for (let i = 0; i < count; i++) {
    const y = value(i);
    if (y == null) continue;
    const now = Math.floor(seconds(i) / bin_s);
    if (now !== bin) {
      flush();
      bin = now;
      least = greatest = i;
      low = high = y;
    } else if (y < low) { least = i; low = y; }
    else if (y > high) { greatest = i; high = y; }
  }
  flush();
}

// Over a long interval only thin lines are drawn fast enough.
const lineWidth = (usual) => shown.span_s > 60 ? 1 : usual;

const GAP_S = 3; // a longer gap between two samples interrupts a curve

// Interruptions of a curve, in pixels. Its nulls are no interruption: other curves have samples there.
function gapsOf(u, number, from, to) {
  const [t] = u.data, y = u.data[number], found = [];
  for (let i = from, last = null; i <= to; i++) {
    if (y[i] == null) continue;
    if (last !== null && t[i] - t[last] > GAP_S) found.push([last, i].map((one) => Math.round(u.valToPos(t[one], "x", true))));
    last = i;
  }
  return found;
}

// The curve of an isolated sensor continues dashed, under its own name.
const ISOLATED = ", isolated";
const LINE = 1.4; // pixels

class Sliding {
  // Curves by name over the shared time interval; a new name adds a curve. With `decades` the axis is logarithmic and
  // spans at most that many.
  constructor(area, { decades = 0, dashed = [] } = {}) {
    this.area = area;
    this.decades = decades;
    this.dashed = dashed;
    this.clear();
    new ResizeObserver(() => this.plot?.setSize(this.size())).observe(area);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.plot?.redraw());
  }
  clear() {
    this.names = [];
    this.t = [];
    this.rows = new Map();
    this.rebuild();
  }
  add(t, values) {
    for (const name of Object.keys(values)) {
      if (this.rows.has(name)) continue;
      this.names.push(name);
      this.rows.set(name, new Array(this.t.length).fill(null));
      this.stale = true;
    }
    const last = this.t.length - 1;
    if (last >= 0 && t < this.t[last]) return; // two keys of one tick may be out of order
    if (last < 0 || t > this.t[last]) {
      this.t.push(t);
      for (const row of this.rows.values()) row.push(null);
    }
    for (const [name, value] of Object.entries(values)) {
      const fits = Number.isFinite(value) && (!this.decades || value > 0);
      this.rows.get(name)[this.t.length - 1] = fits ? value : null;
    }
    this.trim();
    this.dirty = true;
  }
  trim() {
    let old = Math.max(0, this.t.length - MAX_SAMPLES);
    while (this.t[old] < this.t[this.t.length - 1] - MAX_SPAN_S) old++;
    if (old < 200 && this.t.length <= MAX_SAMPLES) return; // shifting arrays at each sample is slow
    this.t.splice(0, old);
    for (const row of this.rows.values()) row.splice(0, old);
  }
  // Returns whether there was something to draw.
  draw() {
    if (this.stale) this.rebuild();
    if (!this.plot || !this.dirty && this.end_s === shown.end_s) return false;
    this.dirty = false;
    this.end_s = shown.end_s;
    for (const one of this.plot.series) one.width = lineWidth(LINE);
    this.plot.setData(this.data());
    return true;
  }
  // Curves have their extremes at different times, and no value at the others'.
  data() {
    const { t } = this, [from] = shownRange();
    let first = t.length;
    while (first && t[first - 1] >= from - GAP_S) first--;
    const kept = new Set(), curves = this.names.map((name) => {
      const y = this.rows.get(name), own = new Map();
      extremes(t.length - first, (i) => t[first + i], (i) => y[first + i], (i) => own.set(first + i, y[first + i]));
      for (const i of own.keys()) kept.add(i);
      return own;
    });
    const order = [...kept].sort((one, other) => one - other);
    return [order.map((i) => t[i]), ...curves.map((own) => order.map((i) => own.get(i) ?? null))];
  }
  strokeOf(name) {
    if (this.dashed.includes(name)) return colour("--bad");
    return colour(`--s${this.names.indexOf(name.replace(ISOLATED, "")) % 6}`);
  }
  rebuild() {
    this.plot?.destroy();
    this.plot = null;
    this.stale = false;
    this.dirty = true;
    if (!this.names.length) return;
    this.plot = new uPlot({
      ...this.size(), pxAlign: 0, cursor: { drag: { x: false, y: false }, sync: SYNC },
      scales: { x: { time: false, range: shownRange },
        y: this.decades ? { distr: 3, range: logRange(this.decades) } : {} },
      axes: plotAxes(), hooks: { drawClear: [shadeFaults] },
      series: [{ label: "t", value: (u, t) => t == null ? "–" : `${t.toFixed(2)} s` },
        ...this.names.map((name) => ({
          label: name, width: lineWidth(LINE), gaps: gapsOf, points: { show: false },
          stroke: () => this.strokeOf(name),
          dash: this.dashed.includes(name) || name.endsWith(ISOLATED) ? [6, 4] : undefined,
          value: (u, value) => value == null ? "–" : String(+value.toPrecision(4)),
        }))],
    }, this.data(), this.area);
  }
  size() { return { width: Math.max(240, this.area.clientWidth), height: 190 }; }
}

// A synthetic healthy signal, the same with the fault, and the change, on the right axis.
function drawCurve(area, curve) {
  const lost = curve.lost.length ? `, ${curve.lost.length} frame${curve.lost.length === 1 ? "" : "s"} lost` : "";
  const alone = curve.name.startsWith("change of"); // of a large value only the change is drawn
  const textContent = `${curve.name}${lost} (${alone ? "" : "grey: healthy, synthetic; "}orange: with the fault${alone ? "" : "; blue, right: the change"})`;
  area.append(make("p", { className: "note", textContent }));
  if (!curve.t.length) return;
  const change = curve.faulty.map((y, n) => alone || y === null || curve.healthy[n] === null ? null : y - curve.healthy[n]);
  const line = (label, stroke, more) => ({ label, stroke: () => colour(stroke), width: 1.3, points: { show: false }, ...more });
  const [x, y] = plotAxes();
  const right = { ...y, scale: "change", side: 1, size: 48, stroke: () => colour("--s0"), grid: { show: false }, show: !alone };
  new uPlot({
    width: Math.max(240, area.clientWidth), height: 125, pxAlign: 0, legend: { show: false },
    cursor: { drag: { x: false, y: false } }, scales: { x: { time: false } }, axes: [x, y, right],
    series: [{}, line("healthy", "--faint"), line("faulty", "--s1"), line("change", "--s0", { scale: "change", dash: [4, 3] })],
  }, [curve.t, curve.healthy, curve.faulty, change], area);
}

class Preview {
  // The preview of a fault; redrawn when the page's width or colours change.
  constructor(area) {
    this.area = area;
    this.show([]);
    let width = area.clientWidth;
    new ResizeObserver(() => {
      if (area.clientWidth !== width) this.show(this.curves);
      width = area.clientWidth;
    }).observe(area);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.show(this.curves));
  }
  show(curves) {
    this.curves = curves;
    this.area.replaceChildren();
    for (const curve of curves) drawCurve(this.area, curve);
  }
}

class Satellites {
  // A bar for each satellite of the newest epoch; rows are kept while the list does not change.
  constructor(area) {
    this.area = area;
    this.rows = new Map();
  }
  clear() { this.layOut([]); }
  show(decision) {
    const out = new Set(decision.excluded);
    const names = [...new Set([...decision.satellites, ...out])].sort();
    if (names.join() !== [...this.rows.keys()].join()) this.layOut(names);
    for (const [name, row] of this.rows) {
      const sigmas = decision.normalised[decision.satellites.indexOf(name)];
      row.className = out.has(name) ? "sat out" : "sat";
      row.children[1].firstChild.style.width = `${Math.min(100, Math.abs(sigmas ?? 0) / BAR_SIGMAS * 100)}%`;
      row.children[2].textContent = out.has(name) ? "isolated" : sigmas == null ? "–" : `${sigmas.toFixed(1)} σ`;
    }
  }
  layOut(names) {
    this.area.replaceChildren();
    this.rows.clear();
    for (const name of names) {
      const row = make("div", {}, make("span", { textContent: name }), make("span", {}, make("i")), make("span"));
      this.area.append(row);
      this.rows.set(name, row);
    }
  }
}
