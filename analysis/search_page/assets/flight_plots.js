"use strict";
// The curves of a flight on one time axis: zooming one zooms all, and the current time is marked in each.

const ANGLES = ["roll", "pitch", "yaw"];
const PLOTS = [
  ...ANGLES.map((name, n) => ({ title: `${name}, degrees`, curves: [["truth", "--ink", "truth", n], ["estimate", "--s1", "estimate", n]] })),
  { title: "error of the estimate, degrees", curves: ANGLES.map((name, n) => [name, `--s${n}`, "error", n]) },
  { title: "gyro, degrees per second", curves: ["p", "q", "r"].map((name, n) => [name, `--s${n}`, "gyro", n]) },
  { title: "accelerometer, m/s²", curves: ["x", "y", "z"].map((name, n) => [name, `--s${n}`, "accel", n]) },
];

class FlightPlot {
  constructor(area, { title, curves }) {
    this.curves = curves;
    this.area = area.appendChild(make("div", { className: "plot" }));
    this.area.append(make("h3", { textContent: title }));
    this.mark = make("div", { className: "instant" });
    new ResizeObserver(() => this.plot?.setSize(this.size())).observe(this.area);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.plot?.redraw());
  }
  size() { return { width: Math.max(240, this.area.clientWidth), height: 190 }; }
  // `chosen` is called with the index of the sample under the pointer.
  show(flight, chosen) {
    const data = [flight.t[0], ...this.curves.map(([, , name, n]) => flight[name][n])];
    if (this.plot) return this.plot.setData(data);
    this.plot = new uPlot({
      ...this.size(), pxAlign: 0, cursor: { sync: SYNC, drag: { x: true, y: false } },
      scales: { x: { time: false } }, axes: plotAxes(),
      hooks: { drawClear: [shadeFaults], draw: [() => this.at(this.instant)],
        setCursor: [({ cursor }) => { if (cursor.event && cursor.idx != null) chosen(cursor.idx); }] },
      series: [{ label: "t", value: (u, t) => t == null ? "–" : `${t.toFixed(2)} s` },
        ...this.curves.map(([label, stroke]) => ({ label, stroke: () => colour(stroke), width: 1.4, points: { show: false },
          value: (u, value) => value == null ? "–" : value.toFixed(2) }))],
    }, data, this.area);
    this.plot.over.setAttribute("aria-hidden", "true");
    this.plot.over.append(this.mark);
  }
  at(t) {
    this.instant = t;
    const x = this.plot.valToPos(t ?? 0, "x");
    this.mark.hidden = !(x >= 0 && x <= this.plot.over.clientWidth);
    this.mark.style.transform = `translateX(${x.toFixed(1)}px)`;
  }
}
