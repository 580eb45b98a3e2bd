"use strict";
// The plots of a report: curves by uPlot, the timeline's lanes, all on one linked time axis.
// `page` is the model from page_model.py, `numbers` the float32 block (see packed_numbers.py).

const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const seriesColour = (i) => colour(`--s${i % 12}`);
const NULL_EXPAND = 2; // a null stays a gap even between the samples of other curves
const DECADES = 5; // shown by a logarithmic axis below its largest value
const LIMIT_NAME = /^(gate|threshold|[+-]3 sigma)/;

const decoded = new Map(); // time axes by their place: curves of one message share one

// `block` identifies the block of numbers.
function decodeTimes(place, numbers, block = "") {
  const key = `${block} ${place.offset} ${place.step} ${place.n} ${place.at}`;
  if (decoded.has(key)) return decoded.get(key);
  const t = new Float64Array(place.n);
  for (let i = 0; i < place.n; i++) t[i] = place.offset + place.step * i;
  if (place.at !== undefined) for (let i = 0; i < place.n; i++) t[i] += numbers[place.at + i];
  decoded.set(key, t);
  return t;
}

function decodeValues(place, numbers, log) {
  const y = new Array(place.n);
  for (let i = 0; i < place.n; i++) {
    const value = numbers[place.at + i];
    y[i] = Number.isFinite(value) && (!log || value > 0) ? value : null;
  }
  return y;
}

function axes(unit, axis, extra) {
  const common = { stroke: colour("--faint"), grid: { stroke: colour("--grid"), width: 1 },
    ticks: { stroke: colour("--grid"), width: 1 }, font: "12px system-ui, sans-serif" };
  return [
    { ...common, incrs: STEPS_S, space: axis.form === "s" ? 56 : 84, values: (u, ticks) => ticks.map((t) => axis.text(t, ticks[1] - ticks[0] < 1 ? 4 : 0)) },
    // Nine digits: uPlot by itself rounds to three decimals.
    { ...common, size: 62, label: unit || " ", labelSize: 18, values: (u, ticks) => ticks.map((y) => y === null ? "" : String(+y.toPrecision(9))),
      labelFont: "12px system-ui, sans-serif", ...extra },
  ];
}

function options(area, axis, height, more) {
  return {
    width: plotWidth(area), height,
    pxAlign: 0,
    cursor: {
      y: false,
      sync: { key: "time", scales: ["x", null] }, drag: { x: true, y: false, setScale: false },
      bind: { dblclick: () => () => { axis.reset(); return null; } },
    },
    ...more,
    scales: { x: { time: false, range: () => axis.range.slice() }, ...more.scales },
    hooks: {
      ...more.hooks,
      setSelect: [(u) => {
        if (u.select.width < 3) return;
        const min = u.posToVal(u.select.left, "x");
        const max = u.posToVal(u.select.left + u.select.width, "x");
        u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
        axis.set(min, max);
      }],
      setCursor: [(u) => { if (u.cursor.left >= 0) axis.at(u.posToVal(u.cursor.left, "x")); },
        ...(more.hooks?.setCursor || [])],
    },
  };
}

// Spans drawn as bands behind every plot, by kind, and events drawn as lines.
const BANDS = { injected: "--injected", flag: "--flagged", fail: "--flagged", warn: "--warned" };
const MARKS = {
  "faults, flags, modes": { bands: ["injected", "flag"], lines: ["mode"] },
  "all with checks and messages": { bands: ["injected", "flag", "fail", "warn"], lines: ["mode", "text", "error", "fault", "flag", "reset", "fusion"] },
  "injected faults": { bands: ["injected"], lines: [] },
  "none": { bands: [], lines: [] },
};

function shade(u, page) {
  const { ctx, bbox } = u, chosen = MARKS[page.shown];
  ctx.save();
  for (const span of page.spans) {
    if (!chosen.bands.includes(span.kind)) continue;
    const left = Math.max(bbox.left, u.valToPos(span.start, "x", true));
    const right = Math.min(bbox.left + bbox.width, u.valToPos(span.end, "x", true));
    ctx.fillStyle = colour(BANDS[span.kind]);
    if (right >= left) ctx.fillRect(left, bbox.top, Math.max(1, right - left), bbox.height);
  }
  ctx.lineWidth = devicePixelRatio;
  ctx.font = `${10 * devicePixelRatio}px system-ui, sans-serif`;
  ctx.textBaseline = "top";
  let free = -Infinity; // labels stand only where they do not cover one another
  for (const mark of page.marks) {
    if (!chosen.lines.includes(mark.kind)) continue;
    const x = u.valToPos(mark.t_s, "x", true);
    if (x < bbox.left || x > bbox.left + bbox.width) continue;
    const loud = mark.severity <= 4 && mark.kind !== "mode";
    ctx.strokeStyle = ctx.fillStyle = colour(loud ? "--fail" : "--faint");
    ctx.globalAlpha = 0.55;
    ctx.setLineDash([2 * devicePixelRatio, 3 * devicePixelRatio]);
    ctx.beginPath(); ctx.moveTo(x, bbox.top); ctx.lineTo(x, bbox.top + bbox.height); ctx.stroke();
    const text = mark.text.replace(/^mode /, "").slice(0, 24);
    if (x < free || x + ctx.measureText(text).width > bbox.left + bbox.width) continue;
    ctx.globalAlpha = 0.9;
    ctx.fillText(text, x + 3 * devicePixelRatio, bbox.top + 2 * devicePixelRatio);
    free = x + ctx.measureText(text).width + 10 * devicePixelRatio;
  }
  ctx.restore();
}

function limitLines(u, limits) {
  const { ctx, bbox } = u;
  ctx.save();
  ctx.setLineDash([6, 4]);
  for (const limit of limits) {
    const y = u.valToPos(limit.value, "y", true);
    if (y < bbox.top || y > bbox.top + bbox.height) continue;
    ctx.strokeStyle = ctx.fillStyle = colour(limit.kind === "fail" ? "--fail" : "--warn");
    ctx.beginPath(); ctx.moveTo(bbox.left, y); ctx.lineTo(bbox.left + bbox.width, y); ctx.stroke();
    ctx.font = `${11 * devicePixelRatio}px system-ui, sans-serif`;
    ctx.textAlign = "left";
    ctx.textBaseline = "bottom";
    ctx.fillText(limit.text, bbox.left + 6, y - 2);
  }
  ctx.restore();
}

function logRange(u, min, max, decades = DECADES) {
  if (!(max > 0)) return [0.1, 1];
  const high = Math.ceil(Math.log10(max));
  return [10 ** Math.max(Math.floor(Math.log10(min > 0 ? min : max)), high - decades), 10 ** high];
}

function powerOfTen(tick) {
  if (tick == null) return ""; // omitted by uPlot
  const power = Math.log10(tick);
  if (Math.abs(power - Math.round(power)) > 1e-6) return "";
  return Math.abs(power) > 3 ? tick.toExponential(0) : String(+tick.toPrecision(1));
}

function plotWidth(area) { return Math.max(280, area.clientWidth); }

// `curves` are the panel's curves with times and values.
function drawPanel(area, panel, page, curves, axis) {
  const tables = curves.map(({ t, y }) => [t, y]);
  const same = tables.every((table) => table[0] === tables[0][0]);
  const data = same ? [tables[0][0], ...tables.map((table) => table[1])] : uPlot.join(tables, tables.map(() => [0, NULL_EXPAND]));
  const digits = (value) => value == null ? "–" : Math.abs(value) >= 1e5 || (value && Math.abs(value) < 1e-3)
    ? value.toExponential(3) : String(+value.toPrecision(6));
  const setup = options(area, axis, panel.height || 230, {
    scales: { y: panel.log ? { distr: 3, range: (u, min, max) => logRange(u, min, max) } : {} },
    axes: axes(panel.unit, axis, panel.log ? { values: (u, ticks) => ticks.map(powerOfTen) } : {}),
    series: [
      { label: "t", value: (u, t) => t == null ? "–" : axis.text(t, 3) },
      ...panel.series.map((s, i) => ({
        label: s.name, stroke: () => seriesColour(s.colour), width: LIMIT_NAME.test(s.name) ? 1 : 1.3, spanGaps: false,
        dash: LIMIT_NAME.test(s.name) ? [6, 4] : undefined, value: (u, value) => digits(value),
        points: { show: tables[i][1].filter((y) => y != null).length < 60 },
      })),
    ],
    hooks: { drawClear: [(u) => shade(u, page)], draw: [(u) => limitLines(u, panel.limits || [])] },
  });
  const plot = new uPlot(setup, data, area);
  axis.plots.add(plot);
  return labelled(plot, `${panel.title}: ${panel.series.map((s) => s.name).join(", ")}`);
}

// Labels a plot for screen readers.
function labelled(plot, text) {
  plot.ctx.canvas.setAttribute("role", "img");
  plot.ctx.canvas.setAttribute("aria-label", text);
  return plot;
}
