"use strict";
// The plots of a report: curves by uPlot, the timeline's lanes, all on one linked time axis.
// `page` is the model that page.py wrote, `numbers` the float32 block (see pack.py).

const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const seriesColour = (i) => colour(`--s${i % 12}`);
const NULL_EXPAND = 2; // a null stays a gap even between the samples of other curves
const DECADES = 5; // that a logarithmic axis shows below its largest value
const KIND = { injected: "--s1", detected: "--s0", flag: "--fail", fail: "--fail", warn: "--warn", mode: "--none" };

const decoded = new Map(); // time axes by where they stand: curves of one message share one

function decodeTimes(place, numbers) {
  const key = `${place.offset} ${place.step} ${place.n} ${place.at}`;
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

class TimeAxis {
  // The stretch of time that every plot and both tracks show.
  constructor(start, end) {
    this.full = [start, end];
    this.range = [start, end];
    this.plots = new Set();
    this.listeners = new Set();
    this.busy = false;
  }
  set(min, max) {
    if (this.busy || !(max > min)) return;
    this.busy = true;
    this.range = [min, max];
    for (const plot of this.plots) plot.setScale("x", { min, max });
    for (const listen of this.listeners) listen({ range: this.range });
    this.busy = false;
  }
  reset() { this.set(...this.full); }
  at(t) { for (const listen of this.listeners) listen({ t }); }
}

function axes(unit, extra) {
  const common = { stroke: colour("--faint"), grid: { stroke: colour("--grid"), width: 1 },
    ticks: { stroke: colour("--grid"), width: 1 }, font: "12px system-ui, sans-serif" };
  return [
    { ...common, values: (u, ticks) => ticks.map((t) => `${+t.toFixed(6)} s`) },
    { ...common, size: 62, label: unit || " ", labelSize: 18,
      labelFont: "12px system-ui, sans-serif", ...extra },
  ];
}

function options(area, axis, height, more) {
  return {
    width: Math.max(300, area.clientWidth), height,
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

function shade(u, spans) {
  const { ctx, bbox } = u;
  ctx.save();
  ctx.fillStyle = colour("--injected");
  for (const span of spans) {
    const left = Math.max(bbox.left, u.valToPos(span.start, "x", true));
    const right = Math.min(bbox.left + bbox.width, u.valToPos(span.end, "x", true));
    if (right > left) ctx.fillRect(left, bbox.top, Math.max(1, right - left), bbox.height);
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

function logRange(u, min, max) {
  if (!(max > 0)) return [0.1, 1];
  const high = Math.ceil(Math.log10(max));
  return [10 ** Math.max(Math.floor(Math.log10(min > 0 ? min : max)), high - DECADES), 10 ** high];
}

function powerOfTen(tick) {
  const power = Math.log10(tick);
  return Math.abs(power - Math.round(power)) < 1e-6 ? String(+tick.toPrecision(1)) : "";
}

function drawPanel(area, panel, page, numbers, axis) {
  const tables = panel.series.map((s) => [decodeTimes(s.t, numbers), decodeValues(s.y, numbers, panel.log)]);
  const same = tables.every((table) => table[0] === tables[0][0]);
  const data = same ? [tables[0][0], ...tables.map((table) => table[1])] : uPlot.join(tables, tables.map(() => [0, NULL_EXPAND]));
  const injected = page.spans.filter((span) => span.kind === "injected");
  const digits = (value) => value == null ? "–" : Math.abs(value) >= 1e5 || (value && Math.abs(value) < 1e-3)
    ? value.toExponential(3) : String(+value.toPrecision(6));
  const setup = options(area, axis, panel.height || 230, {
    scales: { y: panel.log ? { distr: 3, range: logRange } : {} },
    axes: axes(panel.unit, panel.log ? { values: (u, ticks) => ticks.map(powerOfTen) } : {}),
    series: [
      { label: "t", value: (u, t) => t == null ? "–" : `${t.toFixed(3)} s` },
      ...panel.series.map((s, i) => ({
        label: s.name, stroke: () => seriesColour(i), width: 1.3, spanGaps: false,
        dash: s.name === "threshold" ? [6, 4] : undefined, value: (u, value) => digits(value),
        points: { show: tables[i][1].filter((y) => y != null).length < 60 },
      })),
    ],
    hooks: { drawClear: [(u) => shade(u, injected)], draw: [(u) => limitLines(u, panel.limits || [])] },
  });
  const plot = new uPlot(setup, data, area);
  axis.plots.add(plot);
  return plot;
}

function drawLanes(area, page, axis, readout) {
  const lanes = [...new Set(page.spans.map((span) => span.lane))];
  const height = 60 + 22 * lanes.length;
  const pen = document.createElement("canvas").getContext("2d");
  pen.font = "12px system-ui, sans-serif";
  const widest = Math.max(...lanes.map((lane) => pen.measureText(lane).width));
  const room = Math.min(widest + 16, area.clientWidth * 0.4);
  const fitted = (lane) => {
    let text = lane;
    while (pen.measureText(text).width > room - 14 && text.length > 4) text = `${text.slice(0, -2)}…`;
    return text;
  };
  const pick = (u) => {
    const t = u.posToVal(u.cursor.left, "x");
    const lane = lanes[lanes.length - 1 - Math.floor(u.posToVal(u.cursor.top, "y"))];
    const here = page.spans.filter((s) => s.lane === lane && s.start <= t && t <= s.end);
    readout.textContent = u.cursor.left < 0 || !here.length ? "" :
      here.map((s) => `${s.lane}: ${s.text} (${s.start.toFixed(2)} to ${s.end.toFixed(2)} s)`).join("; ");
  };
  const paint = (u) => {
    const { ctx, bbox } = u;
    ctx.save();
    ctx.beginPath(); ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height); ctx.clip();
    ctx.font = `${11 * devicePixelRatio}px system-ui, sans-serif`;
    ctx.textBaseline = "middle";
    ctx.textAlign = "left";
    for (const span of page.spans) {
      const row = lanes.length - 1 - lanes.indexOf(span.lane);
      const top = u.valToPos(row + 0.86, "y", true), bottom = u.valToPos(row + 0.14, "y", true);
      const left = u.valToPos(span.start, "x", true), right = u.valToPos(span.end, "x", true);
      const width = Math.max(2, right - left);
      ctx.fillStyle = colour(KIND[span.kind] || "--none");
      ctx.globalAlpha = span.kind === "mode" ? 0.28 : 0.75;
      ctx.fillRect(left, top, width, bottom - top);
      ctx.globalAlpha = 1;
      if (span.kind === "mode") {
        ctx.fillStyle = colour("--paper");
        ctx.fillRect(left, top, 1.5 * devicePixelRatio, bottom - top);
      }
      if (span.kind === "mode" && ctx.measureText(span.text).width < width - 8) {
        ctx.fillStyle = colour("--ink");
        ctx.fillText(span.text, Math.max(left, bbox.left) + 4, (top + bottom) / 2);
      }
    }
    ctx.restore();
  };
  const setup = options(area, axis, height, {
    legend: { show: false },
    scales: { y: { range: () => [0, lanes.length] } },
    axes: axes("", { label: undefined, labelSize: 0, size: room, splits: () => lanes.map((_, i) => i + 0.5),
      values: () => lanes.map(fitted).reverse(), grid: { show: false } }),
    series: [{}, { label: "", stroke: "transparent" }],
    hooks: { draw: [paint], setCursor: [pick] },
  });
  const plot = new uPlot(setup, [axis.full, [null, null]], area);
  axis.plots.add(plot);
  return plot;
}
