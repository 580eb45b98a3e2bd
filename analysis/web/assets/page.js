"use strict";
// The page: what the socket brings is handed to its part, and drawn at the screen's pace.

const RETRY_MS = 1000;
let run = null, gone = null, there = false, socket = null, wished = new Set();

// -- the socket -------------------------------------------------------------------------------

// Say which messages this page wants the values of, besides those it always shows.
function wish(messages) {
  wished = new Set([...ALWAYS, ...messages]);
  if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify([...wished]));
}

function showStatus(news) {
  const coming = news.coming?.join(", ");
  $("connection").className = news.run ? "there" : run && !coming ? "gone" : "";
  $("connection").textContent = news.run ? `connected to ${news.run}` : coming ? `${coming} is getting ready…`
    : `${run ? "The proxy is gone; waiting for it to come back" : "No proxy or run yet; waiting"} on ${news.url}`;
  $("connection").title = news.url;
  showRuns(news);
  if (!news.run && run && !news.runs.includes(run)) gone = run;
  if (news.run && !there) begin();
  if (!news.run && run) showFaults({ faults: [] });
  run = news.run || run;
  there = Boolean(news.run);
  $("start").hidden = there || run !== null || Boolean(coming);
  document.body.classList.toggle("lost", !there);
}

// Where there are several runs, a row of buttons: what each is doing; a press shows that one.
function showRuns({ run: joined, runs = [], rows: told = {} }) {
  $("runs").hidden = runs.length < 2;
  if (runs.length < 2) return;
  const buttons = [...$("runs").children];
  if (buttons.map((one) => one.value).join() !== runs.join()) {
    $("runs").replaceChildren(...runs.map((value) => make("button", { type: "button", value, disabled: !token,
      onclick: () => attempt("schedule-said", () => ask("run", value).then(() => "")) })));
  }
  for (const button of $("runs").children) {
    const { faults = 0, acting = [], blamed = [] } = told[button.value] || {};
    const doing = acting.length ? `${briefly(acting)} act${acting.length > 1 ? "" : "s"}` : `${faults} fault${faults === 1 ? "" : "s"}`;
    button.textContent = `${button.value}: ${doing}${blamed.length ? `, ⚠ ${briefly(blamed)}` : ""}`;
    button.className = blamed.length ? "bad" : "";
    button.setAttribute("aria-pressed", String(button.value === joined));
  }
}

// A run begins: what the one before has left is wiped away.
function begin() {
  clearDetection();
  store.clear();
  scene.clear();
  $("events").replaceChildren();
  showFaults({ faults: [] });
  showRecording({});
  if (gone) offerFaults(gone);
  else forgetFaults(); // another was chosen
  gone = null;
}

const TAKERS = {
  "page/picture": () => { $("events").replaceChildren(); clearDetection(); },
  "page/status": showStatus,
  "schedule/state": showFaults,
  "proxy/labels": showLabel,
  "proxy/stats": showLinks,
  "proxy/recording": showRecording,
  "proxy/watched": (batch) => { store.take(batch); showAnswers(batch); },
  "fdi/events": showEvent,
  "fdi/main/stat": showDecision,
  "fusion/state": showFused,
};

function take(key, value) {
  if (key in TAKERS) TAKERS[key](value);
  else if (/^fdi\/.*\/stat$/.test(key)) showSensor(value);
  else if (key.startsWith("att/")) showError(value);
}

function connect() {
  socket = new WebSocket(`ws://${location.host}/api/live`);
  socket.onopen = () => wish(wished);
  socket.onmessage = (message) => {
    for (const [key, value] of JSON.parse(message.data)) take(key, value);
    verdicts.follow();
  };
  socket.onclose = () => {
    $("connection").className = "gone";
    $("connection").textContent = "The page's server is gone; trying again";
    document.body.classList.add("lost");
    setTimeout(connect, RETRY_MS);
  };
}

// -- what it begins with -----------------------------------------------------------------------

$("csv").onclick = () => download("received.csv", store.csv(), "text/csv");

const AXIS_MS = 100; // the time axis moves so often, or by one of BINS: plots are drawn anew for it
let moved_ms = 0, drawnLast = 0;

// The end of the time axis follows what is newest.
function moveAxis(now_ms) {
  if (now_ms - moved_ms < Math.max(AXIS_MS, 1e3 * shown.span_s / BINS) || store.newest_us === null) return;
  moved_ms = now_ms;
  shown.end_s = store.seconds(store.newest_us);
}

$("span").onchange = () => { shown.span_s = Number($("span").value); moved_ms = 0; shown.end_s = -Infinity; };

// One plot in a frame, each in its turn: all at once would be seen as a jerk.
function drawNext() {
  const plots = [statistic, others, attitude, ...signals.shown.values()];
  for (let n = 0; n < plots.length; n++) {
    drawnLast = (drawnLast + 1) % plots.length;
    if (plots[drawnLast].draw()) return;
  }
}

function frame(now_ms) {
  moveAxis(now_ms);
  drawVerdicts();
  drawVehicle(now_ms);
  signals.begin();
  drawNext();
  requestAnimationFrame(frame);
}

$("viewing").hidden = Boolean(token);
for (const id of ["stop", "save", "load", "arm", "add-fault", "add-step", "open-sequence", "open-kept"]) $(id).disabled = !token;
wish([]);
offer();
askAllowed();
connect();
requestAnimationFrame(frame);
