"use strict";
// The time window of all plots, the format of times, and the page address that stores both.

const STEPS_S = [1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300,
  600, 900, 1800, 3600, 7200, 14400, 43200, 86400];

class TimeAxis {
  constructor({ start, end, t0_us, utc0_us }) {
    Object.assign(this, { full: [start, end], range: [start, end], boot_s: t0_us / 1e6, utc_s: utc0_us / 1e6 });
    this.form = "s";
    this.plots = new Set();
    this.listeners = new Set();
    this.busy = false;
  }
  forms() {
    return [["s", "seconds"], ["hms", "h:mm:ss"], ["boot", "since boot"], ...this.utc_s ? [["utc", "UTC"]] : []];
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
  write(form) {
    this.form = form;
    for (const plot of this.plots) plot.redraw(true, true);
    for (const listen of this.listeners) listen({ form });
  }
  // A time in the selected format, with `digits` decimals of a second.
  text(t, digits = 3) {
    if (this.form === "s") return `${+t.toFixed(digits)} s`;
    if (this.form === "boot") return `${+(t + this.boot_s).toFixed(digits)} s`;
    if (this.form === "utc") {
      const iso = new Date((t + this.utc_s) * 1000).toISOString();
      return iso.slice(11, digits ? 20 + Math.min(3, digits) : 19);
    }
    const whole = Math.abs(t), pad = (value) => String(Math.floor(value)).padStart(2, "0");
    const part = digits ? (whole % 1).toFixed(digits).slice(1).replace(/\.?0+$/, "") : "";
    return `${t < 0 ? "−" : ""}${Math.floor(whole / 3600)}:${pad(whole / 60 % 60)}:${pad(whole % 60)}${part}`;
  }
}

// `#t=67,73&plot=IMU.AccX&time=utc`: a link reproduces the view.
class Address {
  constructor(axis) {
    this.axis = axis;
    this.plots = [];
    axis.listeners.add(({ range, form }) => { if (range || form) this.later(); });
  }
  later() {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.keep(), 150);
  }
  keep() {
    const { range, full, form } = this.axis, parts = [];
    if (range[0] !== full[0] || range[1] !== full[1]) parts.push(`t=${range.map((t) => +t.toFixed(4)).join(",")}`);
    parts.push(...this.plots.map((text) => `plot=${encodeURIComponent(text)}`));
    if (form !== "s") parts.push(`time=${form}`);
    history.replaceState(null, "", parts.length ? `#${parts.join("&")}` : location.pathname + location.search);
  }
  read() {
    const asked = new URLSearchParams(location.hash.slice(1));
    const [from, to] = (asked.get("t") || "").split(",").map(Number);
    const form = asked.get("time");
    return { range: to > from ? [from, to] : null, plots: asked.getAll("plot"),
      form: this.axis.forms().some(([name]) => name === form) ? form : "s" };
  }
}
