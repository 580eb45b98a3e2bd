"use strict";
// Unpack the numbers, then draw each plot when it comes into view (all of them before printing).

async function unpack(text) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Float32Array(await new Response(stream).arrayBuffer());
}

async function main() {
  const page = JSON.parse(document.getElementById("model").textContent);
  const numbers = await unpack(document.getElementById("numbers").textContent.trim());
  const axis = new TimeAxis(page.start, page.end);
  const pending = new Map(), drawn = new Map();
  const draw = (area) => {
    const make = pending.get(area);
    if (!make) return;
    pending.delete(area);
    drawn.set(area, { make, plot: make() });
    area.dataset.drawn = "yes";
  };
  const seen = new IntersectionObserver((entries) => {
    for (const entry of entries) if (entry.isIntersecting) draw(entry.target);
  }, { rootMargin: "500px" });
  for (const panel of page.panels) {
    const area = document.getElementById(`plot-${panel.key}`);
    pending.set(area, () => drawPanel(area, panel, page, numbers, axis));
  }
  const timeline = document.getElementById("timeline");
  if (timeline) pending.set(timeline, () => drawLanes(timeline, page, axis, document.getElementById("timeline-readout")));
  for (const area of pending.keys()) seen.observe(area);
  const views = tracks(page, numbers, axis);

  const all = () => { for (const area of [...pending.keys()]) draw(area); };
  const again = () => {
    for (const [area, entry] of drawn) {
      axis.plots.delete(entry.plot);
      entry.plot.destroy();
      entry.plot = entry.make();
    }
    views.forEach((view) => view.draw());
  };
  window.addEventListener("resize", () => {
    clearTimeout(main.timer);
    main.timer = setTimeout(() => {
      for (const [area, { plot }] of drawn) plot.setSize({ width: Math.max(300, area.clientWidth), height: plot.height });
      views.forEach((view) => view.draw());
    }, 120);
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", again);
  window.addEventListener("beforeprint", () => { document.documentElement.dataset.theme = "light"; all(); again(); });
  window.addEventListener("afterprint", () => { delete document.documentElement.dataset.theme; again(); });
  document.getElementById("reset").addEventListener("click", () => axis.reset());
  window.report = { axis, all, numbers, page };
  document.documentElement.dataset.ready = "yes";
}

function tracks(page, numbers, axis) {
  if (!page.tracks.length) return [];
  const paths = page.tracks.map((track) => ({
    name: track.name, t: decodeTimes(track.t, numbers), e: decodeValues(track.e, numbers),
    n: decodeValues(track.n, numbers), u: decodeValues(track.u, numbers),
  }));
  const views = [new TrackView(document.getElementById("map"), paths, axis, false),
    new TrackView(document.getElementById("space"), paths, axis, true)];
  const key = document.getElementById("track-key");
  paths.forEach((track, i) => {
    const label = document.createElement("label"), box = document.createElement("input"), line = document.createElement("i");
    box.type = "checkbox"; box.checked = true; line.style.background = `var(--s${i % 12})`;
    box.addEventListener("change", () => views.forEach((view) => {
      if (box.checked) view.hidden.delete(track.name); else view.hidden.add(track.name);
      view.draw();
    }));
    label.append(box, line, track.name);
    key.append(label);
  });
  views.forEach((view) => view.draw());
  return views;
}

main();
