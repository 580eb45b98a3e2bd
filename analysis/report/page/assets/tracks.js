"use strict";
// The tracks of a report on a canvas: from above (a map without tiles) and in space.
// Drag to move (from above) or to turn (in space), wheel to zoom, double click to reset.

const ELLIPSE_SIGMAS = 2.448; // contain 95 % of normally distributed horizontal errors
const ELLIPSES = 12; // along the shown part of a track

class TrackView {
  constructor(canvas, tracks, axis, solid, faults) {
    Object.assign(this, { canvas, tracks, axis, solid, faults, t: null, value: null, hidden: new Set() });
    this.reset();
    canvas.addEventListener("pointerdown", (e) => { this.from = [e.clientX, e.clientY]; canvas.setPointerCapture(e.pointerId); });
    canvas.addEventListener("pointerup", () => { this.from = null; });
    canvas.addEventListener("pointermove", (e) => this.drag(e));
    canvas.addEventListener("dblclick", () => { this.reset(); this.draw(); });
    canvas.addEventListener("wheel", (e) => { e.preventDefault(); this.zoom *= e.deltaY < 0 ? 1.15 : 1 / 1.15; this.draw(); }, { passive: false });
    axis.listeners.add(({ t }) => { if (t !== undefined) this.t = t; this.later(); });
  }
  reset() { this.zoom = 1; this.move = [0, 0]; this.turn = this.solid ? [-0.6, 0.45] : [0, Math.PI / 2]; }
  later() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => { this.waiting = false; this.draw(); });
  }
  drag(e) {
    if (!this.from) return;
    const step = [e.clientX - this.from[0], e.clientY - this.from[1]];
    this.from = [e.clientX, e.clientY];
    if (this.solid) {
      this.turn[0] += step[0] * 0.01;
      this.turn[1] = Math.min(Math.PI / 2, Math.max(0, this.turn[1] + step[1] * 0.01));
    } else this.move = [this.move[0] + step[0], this.move[1] + step[1]];
    this.later();
  }
  bounds() {
    const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
    for (const track of this.tracks) {
      if (this.hidden.has(track.name)) continue;
      [track.e, track.n, track.u].forEach((values, k) => {
        for (const value of values) {
          if (value < low[k]) low[k] = value;
          if (value > high[k]) high[k] = value;
        }
      });
    }
    return Number.isFinite(low[0]) ? [low, high] : [[-1, -1, -1], [1, 1, 1]];
  }
  draw() {
    const ratio = devicePixelRatio || 1, { canvas } = this;
    const width = canvas.clientWidth, height = canvas.clientHeight;
    if (!width) return;
    canvas.width = width * ratio; canvas.height = height * ratio;
    const ctx = canvas.getContext("2d");
    ctx.scale(ratio, ratio);
    const [low, high] = this.bounds();
    const middle = low.map((v, k) => (v + high[k]) / 2);
    const spanXY = Math.max(high[0] - low[0], high[1] - low[1], 1);
    const lift = this.solid ? Math.min(8, Math.max(1, 0.35 * spanXY / Math.max(high[2] - low[2], 1))) : 1;
    const reach = this.solid ? Math.hypot(high[0] - low[0], high[1] - low[1], lift * (high[2] - low[2])) : spanXY;
    const scale = this.zoom * 0.86 * (this.solid ? Math.min(width, height * 1.2) / reach
      : Math.min(width / Math.max(high[0] - low[0], 1), height / Math.max(high[1] - low[1], 1)));
    const [a, b] = this.turn, ca = Math.cos(a), sa = Math.sin(a), cb = Math.cos(b), sb = Math.sin(b);
    const place = (e, n, u) => {
      const x = e - middle[0], y = n - middle[1], z = (u - middle[2]) * lift;
      const across = x * ca - y * sa, along = x * sa + y * ca;
      return [width / 2 + this.move[0] + scale * across, height / 2 + this.move[1] - scale * (along * sb + z * cb)];
    };
    this.ground(ctx, place, low, high, scale, width, height, lift);
    this.tracks.forEach((track) => { if (!this.hidden.has(track.name)) this.path(ctx, place, track, seriesColour(track.colour)); });
  }
  ground(ctx, place, low, high, scale, width, height, lift) {
    const raw = 90 / scale, power = 10 ** Math.floor(Math.log10(raw));
    const step = [1, 2, 5, 10].map((m) => m * power).find((s) => s >= raw);
    ctx.strokeStyle = colour("--grid"); ctx.fillStyle = colour("--faint"); ctx.lineWidth = 1;
    ctx.font = "12px system-ui, sans-serif";
    const base = low[2], margin = this.solid ? 0 : Math.max(width, height) / scale;
    const range = (k) => [Math.floor((low[k] - margin) / step) * step, Math.ceil((high[k] + margin) / step) * step];
    const [e0, e1] = range(0), [n0, n1] = range(1);
    const line = (p, q) => { ctx.beginPath(); ctx.moveTo(...p); ctx.lineTo(...q); ctx.stroke(); };
    for (let e = e0; e <= e1 + step / 2; e += step) line(place(e, n0, base), place(e, n1, base));
    for (let n = n0; n <= n1 + step / 2; n += step) line(place(e0, n, base), place(e1, n, base));
    ctx.strokeStyle = colour("--ink");
    line([14, height - 16], [14 + step * scale, height - 16]);
    ctx.fillText(`${+step.toPrecision(3)} m` + (this.solid ? `   (up drawn ×${lift.toFixed(1)}, ${(high[2] - low[2]).toFixed(1)} m)` : "   north up"), 14, height - 22);
  }
  line(ctx, place, track, shown, stroke) {
    ctx.strokeStyle = stroke;
    ctx.beginPath();
    let pen = false;
    for (let i = 0; i < track.t.length; i++) {
      if (!shown(i)) { pen = false; continue; }
      const p = place(track.e[i], track.n[i], track.u[i]);
      if (pen) ctx.lineTo(...p); else ctx.moveTo(...p);
      pen = true;
    }
    ctx.stroke();
  }
  // By value: one stroke per run of similar colour.
  coloured(ctx, place, track, shown) {
    const { low, high, at } = this.value;
    let last = null, step = -1;
    for (let i = 0; i < track.t.length; i++) {
      if (!shown(i)) { last = null; continue; }
      const p = place(track.e[i], track.n[i], track.u[i]), value = at(track.t[i]);
      if (last && Number.isFinite(value)) {
        const now = Math.round(Math.max(0, Math.min(1, (value - low) / (high - low || 1))) * 24);
        if (now !== step) { step = now; ctx.strokeStyle = `rgb(${heat(step / 24).join(" ")})`; }
        ctx.beginPath(); ctx.moveTo(...last); ctx.lineTo(...p); ctx.stroke();
      }
      last = p;
    }
  }
  path(ctx, place, track, stroke) {
    const [from, to] = this.axis.range;
    for (const inside of [false, true]) {
      ctx.globalAlpha = inside ? 1 : 0.18; ctx.lineWidth = inside ? 1.8 : 1;
      const shown = (i) => (track.t[i] >= from && track.t[i] <= to) === inside && track.e[i] != null;
      if (this.value) this.coloured(ctx, place, track, shown);
      else this.line(ctx, place, track, shown, stroke);
      if (inside) for (const [start, end] of this.faults) {
        ctx.lineWidth = 7; ctx.globalAlpha = 0.35;
        this.line(ctx, place, track, (i) => shown(i) && track.t[i] >= start && track.t[i] <= end, colour("--s1"));
      }
    }
    ctx.globalAlpha = 1;
    if (track.sn) for (let k = 0; k < ELLIPSES; k++) this.ellipse(ctx, place, track, placeAt(track.t, from + (to - from) * (k + 0.5) / ELLIPSES), stroke, 0.45);
    if (this.t == null || this.t < track.t[0] || this.t > track.t[track.t.length - 1]) return;
    const i = placeAt(track.t, this.t);
    if (track.sn) this.ellipse(ctx, place, track, i, stroke, 1);
    ctx.fillStyle = stroke; ctx.beginPath();
    ctx.arc(...place(track.e[i], track.n[i], track.u[i]), 4.5, 0, 7); ctx.fill();
  }
  // The 95 % region, from the accuracy in the log.
  ellipse(ctx, place, track, i, stroke, alpha) {
    const east = ELLIPSE_SIGMAS * track.se[i], north = ELLIPSE_SIGMAS * track.sn[i];
    if (track.e[i] == null || !(east * north > 0)) return;
    ctx.strokeStyle = stroke; ctx.globalAlpha = alpha; ctx.lineWidth = 1;
    ctx.beginPath();
    for (let turn = 0; turn < 49; turn++) {
      const angle = turn * Math.PI / 24;
      ctx.lineTo(...place(track.e[i] + east * Math.cos(angle), track.n[i] + north * Math.sin(angle), track.u[i]));
    }
    ctx.stroke();
    ctx.globalAlpha = 1;
  }
}

// The last index of a time axis that is not after `time`.
function placeAt(t, time) {
  let i = 0, j = t.length - 1;
  while (j - i > 1) { const k = (i + j) >> 1; if (t[k] <= time) i = k; else j = k; }
  return i;
}

function trackViews(page, numbers, axis) {
  if (!page.tracks.length) return [];
  const paths = page.tracks.map((track) => ({
    name: track.name, colour: track.colour, t: decodeTimes(track.t, numbers), e: decodeValues(track.e, numbers),
    n: decodeValues(track.n, numbers), u: decodeValues(track.u, numbers),
    ...(track.sn && { sn: decodeValues(track.sn, numbers), se: decodeValues(track.se, numbers) }),
  }));
  const faults = page.spans.filter((span) => span.kind === "injected").map((span) => [span.start, span.end]);
  const views = [["map", false], ["space", true]].map(([id, solid]) => new TrackView(document.getElementById(id), paths, axis, solid, faults));
  const key = document.getElementById("track-key");
  for (const track of paths) {
    const label = document.createElement("label"), box = document.createElement("input"), line = document.createElement("i");
    box.type = "checkbox"; box.checked = true; line.style.background = `var(--s${track.colour})`;
    box.addEventListener("change", () => views.forEach((view) => {
      if (box.checked) view.hidden.delete(track.name); else view.hidden.add(track.name);
      view.draw();
    }));
    label.append(box, line, track.name);
    key.append(label);
  }
  key.append(valueChoice(page, numbers, views));
  new ResizeObserver(() => views.forEach((view) => view.later())).observe(views[0].canvas);
  return views;
}

// Selects any curve of the report as the colour of the tracks.
function valueChoice(page, numbers, views) {
  const label = document.createElement("label"), list = document.createElement("select"), scale = document.createElement("span");
  list.id = "track-value";
  list.append(new Option("by track", ""));
  page.panels.forEach((panel, p) => {
    const group = document.createElement("optgroup");
    group.label = panel.title;
    panel.series.forEach((s, i) => group.append(new Option(s.name, `${p} ${i}`)));
    list.append(group);
  });
  list.addEventListener("change", () => {
    const [p, i] = list.value.split(" ").map(Number), panel = page.panels[p];
    const value = list.value ? curveAt(decodeTimes(panel.series[i].t, numbers), decodeValues(panel.series[i].y, numbers, false)) : null;
    scale.textContent = value ? ` ${+value.low.toPrecision(4)} (dark) to ${+value.high.toPrecision(4)} ${panel.unit} (bright)` : "";
    for (const view of views) { view.value = value; view.draw(); }
  });
  label.append("colour ", list, scale);
  return label;
}

// A curve as a function of time, and the range of 90 % of its values.
function curveAt(t, y) {
  const sorted = y.filter((value) => value !== null).sort((one, other) => one - other);
  return { low: sorted[Math.floor(0.05 * (sorted.length - 1))], high: sorted[Math.ceil(0.95 * (sorted.length - 1))],
    at: (time) => y[placeAt(t, time)] ?? NaN };
}
