"use strict";
// Spectra: densities over frequency, spectrograms by time (on the shared axis) and by throttle.

const COLOURS = [[13, 8, 80], [84, 39, 143], [158, 59, 120], [222, 95, 72], [252, 165, 54], [240, 249, 33]]; // dark to bright

const SPECTRUM_DECADES = 8;

function drawSpectrum(area, panel, page, numbers, axis) {
  const tables = panel.series.map((s) => [decodeTimes(s.t, numbers), decodeValues(s.y, numbers, true)]);
  const highest = Math.max(...tables.map(([f]) => f[f.length - 1]));
  const marks = page.frequencies.filter(([hz]) => hz <= highest);
  const plot = new uPlot({
    width: plotWidth(area), height: 250, pxAlign: 0, cursor: { y: false, drag: { x: true, y: false } },
    scales: { x: { time: false }, y: { distr: 3, range: (u, min, max) => logRange(u, min, max, SPECTRUM_DECADES) } },
    axes: axes(panel.unit, axis, { values: (u, ticks) => ticks.map(powerOfTen) })
      .map((one, i) => i ? one : { ...one, incrs: undefined, space: 50, values: (u, ticks) => ticks.map((f) => `${+f.toFixed(3)} Hz`) }),
    series: [{ label: "f", value: (u, f) => f == null ? "–" : `${f.toFixed(1)} Hz` },
      ...panel.series.map((s, i) => ({ label: s.name, stroke: () => seriesColour(s.colour), width: 1.3, spanGaps: true,
        points: { show: false }, value: (u, value) => value == null ? "–" : value.toExponential(2) }))],
    hooks: { draw: [(u) => markFrequencies(u, marks, "x")] },
  }, uPlot.join(tables), area);
  return labelled(plot, `Spectrum, ${panel.title}: ${panel.series.map((s) => s.name).join(", ")}`);
}

// Filters and motors as dashed lines, over a spectrum (along x) or over a spectrogram (along y),
// which lies between `left` and `right`.
function markFrequencies(u, marks, scale, left, right) {
  const { ctx, bbox } = u;
  ctx.save();
  ctx.setLineDash([5, 4]);
  ctx.font = `${11 * devicePixelRatio}px system-ui, sans-serif`;
  ctx.textAlign = "left";
  ctx.textBaseline = "alphabetic";
  ctx.strokeStyle = ctx.fillStyle = scale === "x" ? colour("--ink") : "#ffffff";
  marks.forEach(([hz, text], number) => {
    const at = u.valToPos(hz, scale, true), label = `${text} ${+hz.toFixed(1)} Hz`;
    ctx.beginPath();
    if (scale === "x") { ctx.moveTo(at, bbox.top); ctx.lineTo(at, bbox.top + bbox.height); } else { ctx.moveTo(left, at); ctx.lineTo(right, at); }
    ctx.stroke();
    if (scale === "x") {
      ctx.textAlign = at > bbox.left + bbox.width * 0.7 ? "right" : "left";
      ctx.fillText(label, at + (ctx.textAlign === "left" ? 4 : -4), bbox.top + (12 + 13 * (number % 4)) * devicePixelRatio);
    } else ctx.fillText(label, left + 6, at + (number % 2 ? 13 : -4) * devicePixelRatio);
  });
  ctx.restore();
}

// A value from 0 to 1 as red, green and blue, dark to bright.
function heat(share) {
  const level = share * (COLOURS.length - 1), low = Math.min(COLOURS.length - 2, Math.floor(level));
  return COLOURS[low].map((part, k) => Math.round(part + (COLOURS[low + 1][k] - part) * (level - low)));
}

function picture(image, numbers) {
  const columns = image.y.n / image.rows, canvas = document.createElement("canvas");
  canvas.width = columns; canvas.height = image.rows;
  const ctx = canvas.getContext("2d"), data = ctx.createImageData(columns, image.rows);
  for (let row = 0; row < image.rows; row++) {
    for (let column = 0; column < columns; column++) {
      const level = numbers[image.y.at + row * columns + column] / 255;
      if (level >= 0) data.data.set([...heat(level), 255], 4 * ((image.rows - 1 - row) * columns + column));
    }
  }
  ctx.putImageData(data, 0, 0);
  return canvas;
}

function drawSpectrogram(area, panel, image, page, numbers, axis) {
  const drawn = picture(image, numbers), byTime = image.axis === "time";
  const marks = page.frequencies.filter(([hz]) => hz <= image.hz);
  const paint = (u) => {
    const { ctx, bbox } = u, left = u.valToPos(image.start, "x", true), right = u.valToPos(image.end, "x", true);
    const top = u.valToPos(image.hz, "y", true), bottom = u.valToPos(0, "y", true);
    ctx.save();
    ctx.beginPath(); ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height); ctx.clip();
    ctx.imageSmoothingEnabled = false;
    ctx.drawImage(drawn, left, top, right - left, bottom - top);
    ctx.restore();
    markFrequencies(u, marks, "y", Math.max(left, bbox.left), Math.min(right, bbox.left + bbox.width));
  };
  const shared = byTime ? options(area, axis, 230, {}) : { width: plotWidth(area), height: 230, cursor: { drag: { x: false, y: false } },
    scales: { x: { time: false, range: () => [image.start, image.end] } } };
  const plot = new uPlot({
    ...shared, legend: { show: false },
    scales: { ...shared.scales, y: { range: () => [0, image.hz] } },
    axes: axes("Hz", axis, {}).map((one, i) => i || byTime ? one : { ...one, incrs: undefined, values: (u, ticks) => ticks.map((x) => `${x} %`) }),
    series: [{}, { label: "", stroke: "transparent" }],
    hooks: { ...shared.hooks, draw: [paint] },
  }, [byTime ? axis.full : [image.start, image.end], [null, null]], area);
  const note = document.createElement("p");
  note.className = "note";
  note.textContent = `sum of the curves, ${image.low.toFixed(0)} (dark) to ${image.high.toFixed(0)} dB of ${panel.unit}${byTime ? "" : ", mean of all windows at that throttle"}`;
  area.append(note);
  if (byTime) axis.plots.add(plot);
  return labelled(plot, `Spectrogram ${image.title}, ${panel.title}`);
}
