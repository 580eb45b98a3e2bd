"use strict";
// The search's page: the displayed test, its flight in space and over time, and the buttons.

const POLL_MS = 1000, FLYING_MS = 150; // between two polls of the search's state
const LONGEST_S = 20; // longest duration of an animation
const AIRCRAFT_SHARE = 0.9; // viewing distance as a share of the path's extent
let flight = null, sample = 0, playing = null;

class FlightSpace extends Space {
  changed() { this.draw(); }
  draw() {
    const [ctx, width, height] = fitCanvas(this.canvas);
    ctx.clearRect(0, 0, width, height);
    if (!flight) return;
    const point = (k) => flight.path.map((column) => column[k]);
    const here = point(sample), low = Math.min(...flight.path[2].map((up) => up ?? 0)) - this.distance / 8;
    const project = this.camera(here, width, height), path = (points) => this.path(ctx, project, points);
    ctx.lineWidth = 1;
    ctx.strokeStyle = colour("--grid3d");
    this.grid(here, low).forEach(path);
    ctx.setLineDash([3, 4]);
    ctx.strokeStyle = colour("--faint");
    path([here, [here[0], here[1], low]]);
    ctx.setLineDash([]);
    ctx.lineWidth = 2;
    ctx.strokeStyle = colour("--s2");
    const every = Math.max(1, Math.floor(flight.path[0].length / 600));
    path(flight.path[0].map((_, k) => k).filter((k) => k % every === 0).map(point));
    const mesh = flight.rotors ? ROTORS : WINGED, turned = (name) => flight[name].map((column) => column[sample]);
    this.aircraft(ctx, project, here, turned("q"), mesh);
    if (turned("believed").every(Number.isFinite)) this.aircraft(ctx, project, here, turned("believed"), mesh, true);
  }
}

const space = new FlightSpace($("space"));
const plots = PLOTS.map((one) => new FlightPlot($("plots"), one));

// -- one test ----------------------------------------------------------------------------------

function row(tag, cells) { return make("tr", {}, ...cells.map((cell) => make(tag, { textContent: cell }))); }

function showFlight() {
  const t = flight.t[0], extent = Math.max(...flight.path.map((column) => Math.max(...column) - Math.min(...column)));
  space.distance = Math.max(20, extent * AIRCRAFT_SHARE);
  faultIntervals.clear();
  flight.faults.forEach(({ at_s, for_s }, n) => faultIntervals.set(`${n}`, [at_s, for_s == null ? null : at_s + for_s]));
  $("title").textContent = flight.title;
  document.title = `${flight.title} – mavproxy-fault search`;
  $("acting").replaceChildren(...flight.faults.map(({ what, at_s, for_s }) =>
    make("li", { textContent: `${what} from ${at_s.toFixed(2)} s${for_s == null ? " on" : ` for ${for_s.toFixed(2)} s`}` })));
  const digits = (value) => typeof value === "number" ? String(+value.toPrecision(5)) : value;
  const range = ({ name, low, high }) => name.endsWith(".target") ? "" : `${digits(low)} to ${digits(high)}`;
  $("values").replaceChildren(make("thead", {}, row("th", ["parameter", "value", "searched"])),
    make("tbody", {}, ...flight.parameters.map((one) => row("td", [one.name, digits(one.value), range(one)]))));
  $("step").hidden = flight.step === 1;
  $("step").textContent = `One of ${flight.step} samples is shown; the saved data have all.`;
  for (const one of plots) one.show(flight, choose);
  $("time").max = t.at(-1);
  $("animate").disabled = false;
  stop();
  at(0);
}

// Show aircraft, markers and angles of one sample.
function at(k) {
  sample = k;
  const t = flight.t[0][k];
  space.draw();
  for (const one of plots) one.at(t);
  $("time").value = t;
  $("instant").textContent = `${t.toFixed(2)} s`;
  const cells = ANGLES.map((name, n) => [name, ...["truth", "estimate", "error"].map((kind) => flight[kind][n][k]?.toFixed(2) ?? "–")]);
  $("angles").replaceChildren(make("thead", {}, row("th", ["degrees", "truth", "estimate", "error"])), make("tbody", {}, ...cells.map((one) => row("td", one))));
}

function sampleAt(t_s) {
  const { length } = flight.t[0];
  return Math.max(0, Math.min(length - 1, Math.round(t_s / flight.t[0].at(-1) * (length - 1)) || 0));
}

function choose(k) { if (flight && playing === null && k !== sample) at(k); }

// -- animation ---------------------------------------------------------------------------------

function stop() {
  if (playing !== null) cancelAnimationFrame(playing);
  playing = null;
  $("animate").textContent = "Animate";
}

function play(from_s, begin_ms = null) {
  const last_s = flight.t[0].at(-1), pace = Math.max(1, last_s / LONGEST_S);
  playing = requestAnimationFrame((now_ms) => {
    begin_ms ??= now_ms;
    const t_s = from_s + (now_ms - begin_ms) / 1e3 * pace;
    at(sampleAt(t_s));
    if (t_s < last_s) play(from_s, begin_ms);
    else stop();
  });
}

$("animate").onclick = () => {
  if (playing !== null) return stop();
  $("animate").textContent = "Stop";
  // Continue from the current time, or restart at the end.
  play(sample === flight.t[0].length - 1 ? 0 : flight.t[0][sample]);
};
$("time").oninput = () => { stop(); if (flight) at(sampleAt(Number($("time").value))); };

// -- state of the search ----------------------------------------------------------------------

function showState(state) {
  const { flying, failed, number } = state;
  $("flying").textContent = flying ? "flying…" : failed ? "the flight failed; see the terminal for the reason" : "";
  $("next").disabled = flying || !token;
  $("save").disabled = flying || !token || number === null;
}

// JSON from the server; undefined if it does not respond.
async function getJson(path) {
  try { return (await fetch(`/api/${path}`, { headers: { "X-Token": token } })).json(); } catch { return undefined; }
}

function showEnd() {
  $("flying").textContent = "the search has ended; start it again to continue";
  for (const id of ["next", "save"]) $(id).disabled = true;
}

let timer = 0;

async function poll() {
  clearTimeout(timer);
  const state = await getJson("state");
  if (state && state.number !== null && state.number !== flight?.number) {
    flight = await getJson("flight") ?? flight;
    if (flight) showFlight();
  }
  if (state) showState(state);
  else showEnd();
  clearTimeout(timer); // of another poll meanwhile
  timer = setTimeout(poll, state?.flying ? FLYING_MS : POLL_MS);
}

$("next").onclick = () => {
  showState({ flying: true, number: null });
  attempt("message", () => post("next").then(poll).then(() => ""));
};
$("save").onclick = () => attempt("message", () => post("save").then(({ files }) => `saved:\n${files.join("\n")}`));
$("viewing").hidden = Boolean(token);

const drawn = new ResizeObserver(() => space.draw());
drawn.observe($("space"));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => space.draw());
window.addEventListener("beforeprint", () => space.draw());
poll();
