"use strict";
// The timeline: a lane for modes, for each fault, flag and alarm.

const KIND = { injected: "--s1", detected: "--s0", flag: "--fail", fail: "--fail", warn: "--warn", mode: "--none" };

function drawLanes(area, page, axis, readout) {
  const lanes = [...new Set(page.spans.map((span) => span.lane))];
  const height = 60 + 22 * lanes.length;
  const pen = document.createElement("canvas").getContext("2d");
  pen.font = "12px system-ui, sans-serif";
  const widest = Math.max(...lanes.map((lane) => pen.measureText(lane).width));
  const room = Math.min(widest + 16, area.clientWidth / 2);
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
      here.map((s) => `${s.lane}: ${s.text} (${axis.text(s.start, 2)} to ${axis.text(s.end, 2)})`).join("; ");
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
    axes: axes("", axis, { label: undefined, labelSize: 0, size: room, splits: () => lanes.map((_, i) => i + 0.5),
      values: () => lanes.map(fitted).reverse(), grid: { show: false } }),
    series: [{}, { label: "", stroke: "transparent" }],
    hooks: { draw: [paint], setCursor: [pick] },
  });
  const plot = new uPlot(setup, [axis.full, [null, null]], area);
  axis.plots.add(plot);
  return labelled(plot, `Timeline with lanes for ${lanes.join(", ")}`);
}
