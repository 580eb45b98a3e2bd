"use strict";
// Heat map of a campaign: one table per subject; a click lists a cell's flights and their curves.

const model = JSON.parse(document.getElementById("model").textContent);
const plots = []; // of the curves shown, with their places
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

function element(name, text, parent, style) {
  const made = document.createElement(name);
  if (text !== undefined) made.textContent = text; // never as HTML: names come from a file
  if (style) made.style.background = style;
  if (parent) parent.append(made);
  return made;
}

// A scrollable box for a table that may be wider than the screen.
function wide(parent, label) {
  const box = element("div", undefined, parent);
  Object.assign(box, { className: "wide", tabIndex: 0, role: "group", ariaLabel: label });
  return box;
}

function chosen(node, selector) {
  for (const one of document.querySelectorAll(selector)) one.classList.remove("chosen");
  node.classList.add("chosen");
}

function numbers(result) {
  const texts = [
    ["excursion_deg", "deg beyond the reference flight"], ["excursion_m", "m beyond the reference flight"],
    ["detected_s", "s until detected"], ["failsafe_s", "s until the failsafe"],
    ["recovery_s", "s to recover"],
  ];
  return texts.filter(([key]) => result[key] !== null)
    .map(([key, text]) => `${result[key]} ${text}`).join(", ");
}

// Seconds, or a phase of flight, an event or a condition.
function onset(value) { return typeof value === "number" ? `${value} s` : value; }

function monitored(result) {
  const isolated = result.blamed ? `: ${result.blamed}` : "";
  const after = result.verdict_s === null ? "" : ` after ${result.verdict_s} s`;
  return result.verdict + isolated + after;
}

function legend() {
  const shown = new Set(model.rows.flatMap((row) => row.cells.map((cell) => cell.outcome)));
  for (const name of [...model.ranks, "aborted"]) {
    if (shown.has(name)) element("span", name, document.getElementById("legend"), `var(--${name.replace(" ", "-")})`);
  }
}

function heatMap() {
  const map = document.getElementById("map");
  for (const subject of new Set(model.rows.map((row) => row.subject))) {
    const part = element("section", undefined, map);
    element("h2", subject, part);
    const body = element("tbody", undefined, element("table", undefined, part));
    body.parentElement.className = "heat";
    for (const row of model.rows.filter((one) => one.subject === subject)) {
      const line = element("tr", undefined, body);
      element("th", row.fault, line);
      for (const cell of row.cells) heatCell(row, cell, line);
    }
  }
}

function heatCell(row, cell, line) {
  const shown = element("td", undefined, line, `var(--${cell.outcome.replace(" ", "-")})`);
  const button = element("button", cell.size || "-", shown); // for the keyboard
  const total = Object.values(cell.counts).reduce((a, b) => a + b, 0);
  const share = total > 1 ? ` ${cell.counts[cell.outcome]}/${total}` : "";
  element("small", cell.outcome + share, button);
  const counts = Object.entries(cell.counts).map(([name, count]) => `${count} ${name}`).join(", ");
  const worst = cell.results.length ? model.results[cell.results[0]] : null;
  shown.title = `${row.fault} ${cell.size}: ${counts}` +
    (worst ? `\nworst: ${numbers(worst)} ${worst.detected_by} ${worst.note}` : "");
  shown.dataset.cell = [row.subject, row.fault, cell.magnitude].join("|");
  shown.addEventListener("click", () => { chosen(shown, ".heat td"); detail(row, cell); location.replace(`#${encodeURIComponent(shown.dataset.cell)}`); });
}

function detail(row, cell) {
  const place = document.getElementById("detail");
  place.replaceChildren();
  element("h2", `${row.subject}: ${row.fault} ${cell.size}`, place);
  const table = element("table", undefined, wide(place, "Flights of the cell"));
  const head = element("tr", undefined, element("thead", undefined, table));
  for (const name of ["outcome", "scenario", "onset", "duration, s", "seed", "measured", "monitor"]) element("th", name, head);
  const body = element("tbody", undefined, table);
  const below = element("div", undefined, place);
  cell.results.forEach((number, i) => {
    const result = model.results[number];
    const line = element("tr", undefined, body);
    const facts = [numbers(result), result.detected_by, result.note, ...result.requirements].filter(Boolean).join("; ");
    element("button", result.outcome, element("td", undefined, line));
    for (const text of [result.scenario, onset(result.onset), result.duration_s, result.seed, facts, monitored(result)]) element("td", text, line);
    line.addEventListener("click", () => { chosen(line, "#detail tr"); curves(number, below); });
    if (i === 0) { line.classList.add("chosen"); curves(number, below); }
  });
  if (!cell.results.length) element("p", "The page does not list these flights; see cells.csv.", place);
}

function curves(number, place) {
  place.replaceChildren();
  plots.length = 0;
  const result = model.results[number], faulty = model.curves[number];
  if (result.again) {
    const line = element("p", "Repeat this flight: ", place);
    element("code", result.again, line);
  }
  if (!faulty) { element("p", "The page has no curves of this flight.", place); return; }
  const reference = model.twins[`${result.subject}|${result.scenario}|${result.seed}`] || {};
  for (const [name, [t, value]] of Object.entries(faulty)) {
    const healthy = reference[name] ? joined(t, ...reference[name]) : t.map(() => null);
    element("h3", name, place);
    const axis = { stroke: colour("--faint"), grid: { stroke: colour("--grid") } };
    const plot = new uPlot({
      ...plotSize(place), scales: { x: { time: false } },
      series: [{ label: "t", value: (u, t) => t === null ? "–" : `${t} s` }, { label: "with the fault", stroke: colour("--s1"), width: 1.6 },
        { label: "reference", stroke: colour("--s0"), width: 1.4 }],
      axes: [{ ...axis, values: (u, ticks) => ticks.map((t) => `${t} s`) }, axis],
      hooks: { drawClear: [(u) => shade(u, result)] },
    }, [t, value, healthy], element("div", undefined, place));
    plots.push([plot, place]);
  }
}

function plotSize(place) { return { width: Math.min(1100, place.clientWidth || 1100), height: 240 }; }
// Plots must not stay wider than a window that has become narrow.
addEventListener("resize", () => { for (const [plot, place] of plots) plot.setSize(plotSize(place)); });

// The reference flight's values at the flight's times.
function joined(t, times, values) {
  let i = 0;
  return t.map((now) => {
    while (i + 1 < times.length && times[i + 1] <= now) i++;
    return values[i] ?? null;
  });
}

function shade(u, result) {
  const from = u.valToPos(result.onset_s, "x", true);
  const to = u.valToPos(result.onset_s + result.duration_s, "x", true);
  u.ctx.fillStyle = colour("--injected");
  u.ctx.fillRect(from, u.bbox.top, to - from, u.bbox.height);
}

legend();
heatMap();
// Select the cell that was open before a reload, or that a link names.
const cells = [...document.querySelectorAll(".heat td")], wanted = decodeURIComponent(location.hash.slice(1));
(cells.find((one) => one.dataset.cell === wanted) || cells[0])?.click();
if (model.reload_s) setTimeout(() => location.reload(), model.reload_s * 1000);
