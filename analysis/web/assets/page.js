"use strict";
// The page: messages of the socket go to their part of the page, which is drawn once per frame.

const RETRY_MS = 1000;
let ended = null; // the result of a run that has ended together with this page's server
let run = null, lostRun = null, there = false, socket = null, requestedMessages = new Set();

// -- the socket -------------------------------------------------------------------------------

// Request the values of messages, in addition to those always shown.
function requestMessages(messages) {
  requestedMessages = new Set([...ALWAYS, ...messages]);
  if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify([...requestedMessages]));
}

function showStatus(news) {
  if (ended) return;
  const coming = news.coming?.join(", ");
  $("connection").className = news.run ? "there" : run && !coming ? "gone" : "";
  $("connection").textContent = news.run ? `connected to ${news.run}` : coming ? `${coming} is starting…`
    : `${run ? "The proxy has disconnected; waiting for it to return" : "No proxy or run yet; waiting"} on ${news.url}`;
  $("connection").title = news.url;
  showRuns(news);
  if (!news.run && run && !news.runs.includes(run)) lostRun = run;
  if (news.run && !there) begin();
  if (!news.run && run) showFaults({ faults: [] });
  run = news.run || run;
  there = Boolean(news.run);
  $("start").hidden = there || run !== null || Boolean(coming);
  document.body.classList.toggle("lost", !there);
}

// With several runs, a row of buttons with the state of each; a press shows that run.
function showRuns({ run: joined, runs = [], rows: summaries = {} }) {
  $("runs").hidden = runs.length < 2;
  if (runs.length < 2) return;
  const buttons = [...$("runs").children];
  if (buttons.map((one) => one.value).join() !== runs.join()) {
    $("runs").replaceChildren(...runs.map((value) => make("button", { type: "button", value, disabled: !token,
      onclick: () => attempt("schedule-message", () => post("run", value).then(() => "")) })));
  }
  for (const button of $("runs").children) {
    const { faults = 0, acting = [], blamed = [] } = summaries[button.value] || {};
    const doing = acting.length ? `${shorten(acting)} active` : `${faults} fault${faults === 1 ? "" : "s"}`;
    button.textContent = `${button.value}: ${doing}${blamed.length ? `, ⚠ ${shorten(blamed)}` : ""}`;
    button.className = blamed.length ? "bad" : "";
    button.setAttribute("aria-pressed", String(button.value === joined));
  }
}

// A run starts: clear the data of the previous one.
function begin() {
  clearDetection();
  store.clear();
  scene.clear();
  $("events").replaceChildren();
  showFaults({ faults: [] });
  showRecording({});
  if (lostRun) offerRestore(lostRun);
  else clearRestore(); // another run was chosen
  lostRun = null;
}

// The last message of a page beside a run: its result stays, in the place of the forms that no server answers now.
async function showEnd(news) {
  ended = news;
  const place = $("connection");
  place.className = "there";
  document.body.classList.remove("lost");
  document.body.classList.add("ended");
  verdicts.finish();
  $("result").append(...[...news.vehicle ? [`vehicle ${news.vehicle}`] : [], ...news.reasons].map((textContent) => make("p", { textContent })));
  $("faults").replaceChildren(...news.faults.map(resultRow));
  place.textContent = `The flight has ended: ${news.verdict}. `;
  if (news.report) place.append("Report: ", make("code", { textContent: news.report }));
  try {
    if (news.report) {
      const href = URL.createObjectURL(await (await fetch("/api/report")).blob()), download = news.report.split("/").slice(-2).join("-");
      place.append(" ", make("a", { textContent: "open it", target: "_blank", href }), " ", make("a", { textContent: "save it", download, href }));
    }
  } catch { /* the server has left: the path remains */ }
  place.append(". Fly again: ", make("code", { textContent: news.again }));
}

// A fault and what was found of it, as in the report.
function resultRow(one) {
  const acted = `${one.target}, ${one.start_s.toFixed(2)} to ${one.end_s === null ? "the end" : one.end_s.toFixed(2)} s, ${one.frames} frames`;
  const found = [one.delay_s === null ? "not detected" : `detected after ${one.delay_s.toFixed(2)} s`, ...one.isolated.length ? [`isolated: ${one.isolated.join(", ")}`] : [], ...one.remarks];
  const lines = [acted, found.join("; ")].map((textContent) => make("span", { className: "what note", textContent }));
  return make("li", { className: one.verdict === "isolated" ? "done" : "active" },
    make("span", {}, make("b", { textContent: one.id }), " ", make("span", { className: "state", textContent: one.verdict })), ...lines);
}

const HANDLERS = {
  "page/end": showEnd,
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
  if (key in HANDLERS) HANDLERS[key](value);
  else if (/^fdi\/.*\/stat$/.test(key)) showSensor(value);
  else if (key.startsWith("att/")) showError(value);
}

function connect() {
  socket = new WebSocket(`ws://${location.host}/api/live?token=${encodeURIComponent(token)}`);
  socket.onopen = () => requestMessages(requestedMessages);
  socket.onmessage = (message) => {
    const show = () => {
      for (const [key, value] of JSON.parse(message.data)) take(key, value);
      verdicts.update();
    };
    if (pressed) released.then(show);
    else show();
  };
  socket.onclose = () => {
    if (ended) return; // the server has left with its run, as it should
    $("connection").className = "gone";
    $("connection").textContent = "The page's server does not respond; reconnecting";
    document.body.classList.add("lost");
    setTimeout(connect, RETRY_MS);
  };
}

// -- start ------------------------------------------------------------------------------------

$("csv").onclick = () => download("received.csv", store.csv(), "text/csv");

const AXIS_MS = 100; // the time axis moves at this interval or by one bin: each move redraws the plots
let moved_ms = 0, drawnLast = 0;

// The end of the time axis follows the newest sample.
function moveAxis(now_ms) {
  if (now_ms - moved_ms < Math.max(AXIS_MS, 1e3 * shown.span_s / BINS) || store.newest_us === null) return;
  moved_ms = now_ms;
  shown.end_s = store.seconds(store.newest_us);
}

$("span").onchange = () => { shown.span_s = Number($("span").value); moved_ms = 0; shown.end_s = -Infinity; };

// One plot per frame, in turn: drawing all at once would stutter.
function drawNext() {
  const plots = [statistic, others, attitude, ...signals.shown.values()];
  for (let n = 0; n < plots.length; n++) {
    drawnLast = (drawnLast + 1) % plots.length;
    if (plots[drawnLast].draw()) return;
  }
}

function frame(now_ms) {
  requestAnimationFrame(frame);
  if (pressed) return;
  moveAxis(now_ms);
  drawVerdicts();
  drawVehicle(now_ms);
  signals.begin();
  drawNext();
}

$("viewing").hidden = Boolean(token);
for (const id of ["stop", "save", "load", "arm", "add-fault", "add-step", "open-sequence", "open-kept"]) $(id).disabled = !token;
requestMessages([]);
offer();
loadPermissions();
connect();
requestAnimationFrame(frame);
