"use strict";
// Unpack the numbers, then draw each plot when it comes into view (all of them before printing).

const NARROW_PX = 760;
const IDLE_MS = 10; // needed to draw a plot

async function unpack(text) {
  const bytes = Uint8Array.from(atob(text.trim()), (c) => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const planes = new Uint8Array(await new Response(stream).arrayBuffer()), n = planes.length / 4;
  const whole = new Uint8Array(planes.length); // the bytes are stored in four planes (see packed_numbers.py)
  for (let k = 0; k < 4; k++) for (let i = 0; i < n; i++) whole[4 * i + k] = planes[k * n + i];
  return new Float32Array(whole.buffer);
}

class Report {
  constructor(page, numbers) {
    Object.assign(this, { page, numbers, pending: new Map(), drawn: new Map() });
    page.shown = Object.keys(MARKS)[0];
    this.axis = new TimeAxis(page);
    this.address = new Address(this.axis);
    this.seen = new IntersectionObserver((entries) => {
      for (const entry of entries) if (entry.isIntersecting) this.draw(entry.target);
    }, { rootMargin: "500px" });
    for (const panel of page.panels) this.add(`plot-${panel.key}`, (area) => drawPanel(area, panel, page, this.curves(panel), this.axis));
    for (const panel of page.spectra) {
      this.add(`plot-${panel.key}`, (area) => drawSpectrum(area, panel, page, numbers, this.axis));
      for (const image of panel.images) this.add(`plot-${panel.key}-${image.axis}`, (area) => drawSpectrogram(area, panel, image, page, numbers, this.axis));
    }
    this.add("timeline", (area) => drawLanes(area, page, this.axis, document.getElementById("timeline-readout")));
    this.views = trackViews(page, numbers, this.axis);
    this.fields = new Fields(page, this.axis, this.address, (area, title, curves) => this.plotted(area, title, curves));
  }
  curves(panel) {
    return panel.series.map((s) => ({ ...s, t: decodeTimes(s.t, this.numbers), y: decodeValues(s.y, this.numbers, panel.log) }));
  }
  add(id, make) {
    const area = document.getElementById(id);
    if (!area) return;
    this.pending.set(area, () => make(area));
    this.seen.observe(area);
  }
  // Adds a plot of any fields; the returned function removes it.
  plotted(area, title, curves) {
    const panel = { key: title, title, unit: "", series: curves.map(({ name }, colour) => ({ name, colour })) };
    const ready = curves.map((curve, colour) => ({ ...curve, colour, y: curve.y.map((value) => Number.isFinite(value) ? value : null) }));
    this.pending.set(area, () => drawPanel(area, panel, this.page, ready, this.axis));
    this.draw(area);
    return () => {
      const { plot } = this.drawn.get(area);
      this.axis.plots.delete(plot);
      plot.destroy();
      this.drawn.delete(area);
    };
  }
  draw(area) {
    const make = this.pending.get(area);
    if (!make || !area.clientWidth) return;
    this.pending.delete(area);
    this.drawn.set(area, { make, plot: make() });
    area.dataset.drawn = "yes";
  }
  // Draw the rest while idle, for scrolling, searching and screenshots.
  rest() {
    requestIdleCallback((free) => {
      const open = [...this.pending.keys()].filter((area) => area.clientWidth);
      do this.draw(open.shift()); while (open.length && free.timeRemaining() > IDLE_MS);
      if (open.length) this.rest();
    });
  }
  all() {
    for (const section of document.querySelectorAll("details.section")) section.open = true;
    for (const area of [...this.pending.keys()]) this.draw(area);
    this.views.forEach((view) => view.draw());
  }
  again() {
    for (const [area, entry] of this.drawn) {
      this.axis.plots.delete(entry.plot);
      entry.plot.destroy();
      area.replaceChildren();
      entry.plot = entry.make();
    }
    this.views.forEach((view) => view.draw());
  }
  fit() {
    for (const [area, { plot }] of this.drawn) plot.setSize({ width: plotWidth(area), height: plot.height });
    this.views.forEach((view) => view.draw());
  }
  show(id) {
    const target = document.getElementById(id);
    if (!target) return;
    const section = target.closest("details.section");
    if (section) section.open = true;
    target.scrollIntoView({ block: "center" });
  }
}

// -- user input ------ ----------------------------------------------------------------------------

function choices(id, pairs, chosen, changed) {
  const list = document.getElementById(id);
  for (const [value, text] of pairs) list.append(new Option(text, value));
  list.value = chosen;
  list.addEventListener("change", () => changed(list.value));
}

function connect(report) {
  const { axis, page } = report, asked = report.address.read();
  axis.form = asked.form;
  choices("time-form", axis.forms(), axis.form, (form) => axis.write(form));
  choices("mark-form", Object.keys(MARKS).map((name) => [name, name]), page.shown, (name) => { page.shown = name; report.again(); });
  document.getElementById("reset").addEventListener("click", () => axis.reset());
  const buttons = [...document.querySelectorAll("button.moment[data-from]")];
  const name = () => {
    for (const { dataset, ...button } of buttons.map((one) => ({ dataset: one.dataset, one }))) {
      const from = Number(dataset.from), to = Number(dataset.to);
      button.one.textContent = dataset.panel || to - from < 9.9 ? `${axis.text(from, 1)} – ${axis.text(to, 1)}` : axis.text((from + to) / 2, 2);
    }
  };
  name();
  axis.listeners.add(({ form }) => { if (form) name(); });
  document.addEventListener("click", (event) => {
    const { from, to, panel } = event.target.dataset || {};
    if (from !== undefined) {
      const margin = Math.max(1, 0.25 * (to - from));
      axis.set(Number(from) - margin, Number(to) + margin);
      if (panel) report.show(`plot-${panel}`);
    }
    const link = event.target.closest("nav a");
    if (link) { event.preventDefault(); const target = document.querySelector(link.getAttribute("href")); target.open = true; target.scrollIntoView(); }
  });
  const now = document.getElementById("now");
  axis.listeners.add(({ t }) => { if (t !== undefined) now.textContent = `${axis.text(t, 2)}  ${happening(page, t)}`; });
  if (asked.range) axis.set(...asked.range);
  return asked.plots.reduce((before, text) => before.then(() => report.fields.ask(text)), Promise.resolve());
}

// The mode and other spans at a time, and the last message.
function happening(page, t) {
  const spans = page.spans.filter((s) => s.start <= t && t <= s.end).map((s) => s.kind === "mode" ? s.text : s.lane);
  const last = page.marks.filter((mark) => mark.kind === "text" && mark.t_s <= t && mark.t_s > t - 10).at(-1);
  return [...new Set(spans)].slice(0, 5).join(" · ") + (last ? ` · “${last.text}”` : "");
}

function whenPrinted(report) {
  let folded = [];
  window.addEventListener("beforeprint", () => {
    document.documentElement.dataset.theme = "light";
    folded = [...document.querySelectorAll("details:not([open])")];
    folded.forEach((one) => { one.open = true; });
    report.all();
    report.again();
  });
  window.addEventListener("afterprint", () => {
    delete document.documentElement.dataset.theme;
    folded.forEach((one) => { one.open = false; });
    report.again();
  });
}

async function main() {
  const page = JSON.parse(document.getElementById("model").textContent);
  const numbers = await unpack(document.getElementById("numbers").textContent);
  if (window.innerWidth < NARROW_PX) for (const one of document.querySelectorAll("details.section:not([data-narrow])")) one.open = false;
  const report = new Report(page, numbers);
  window.report = Object.assign(report, { page });
  let timer = 0;
  window.addEventListener("resize", () => { clearTimeout(timer); timer = setTimeout(() => report.fit(), 120); });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => report.again());
  whenPrinted(report);
  await connect(report);
  report.rest();
  document.documentElement.dataset.ready = "yes";
}

main();
