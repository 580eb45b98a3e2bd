"use strict";
// The aircraft in space with its tracks: where it is, where it is told to be, where fusion has it.
// Points are east, north, up in metres from the first position. Drag or arrow keys turn, + and - zoom.

const A_M = 6378137, E2 = 6.69437999014e-3; // WGS 84
const TRACK_POINTS = 3000, TRACK_STEP_US = 200000, TRACK_GAP_US = 3e6;
const TRACKS = [
  { name: "truth", stroke: "--s2", from: ["HIL_STATE_QUATERNION"] },
  { name: "GPS as sent on", stroke: "--s1", from: ["HIL_GPS", "GPS_RAW_INT"] },
  { name: "autopilot", stroke: "--s0", from: ["GLOBAL_POSITION_INT"] },
  { name: "fusion", stroke: "--s3", from: ["fusion"] },
];
// Triangles in body axes (forward, right, down), in parts of the aircraft's size.
const WINGED = [
  [[1, 0, 0], [-0.9, 0.1, -0.05], [-0.9, -0.1, -0.05]], [[1, 0, 0], [-0.2, 0.13, 0.12], [-0.2, -0.13, 0.12]],
  [[0.25, 0, -0.06], [-0.15, 1.15, -0.08], [-0.4, 1.15, -0.08]], [[0.25, 0, -0.06], [-0.4, 1.15, -0.08], [-0.3, 0, -0.06]],
  [[0.25, 0, -0.06], [-0.15, -1.15, -0.08], [-0.4, -1.15, -0.08]], [[0.25, 0, -0.06], [-0.4, -1.15, -0.08], [-0.3, 0, -0.06]],
  [[-0.65, 0, -0.05], [-0.95, 0.42, -0.05], [-0.95, -0.42, -0.05]], [[-0.6, 0, -0.05], [-0.95, 0, -0.45], [-0.95, 0, -0.05]],
];
const ARM = (x, y) => [[0.08 * Math.sign(x), 0, 0], [x, y, -0.08], [0, 0.08 * Math.sign(y), 0]];
const DISC = (x, y) => [0, 1, 2, 3, 4, 5].map((n) => {
  const at = (k) => [x + 0.38 * Math.cos(k * Math.PI / 3), y + 0.38 * Math.sin(k * Math.PI / 3), -0.1];
  return [[x, y, -0.1], at(n), at(n + 1)];
});
const ROTORS = [[0.7, 0.7], [0.7, -0.7], [-0.7, 0.7], [-0.7, -0.7]].flatMap(([x, y]) => [ARM(x, y), ...DISC(x, y)])
  .concat([[[0.55, 0, 0], [0.1, 0.14, -0.05], [0.1, -0.14, -0.05]]]);
const WITH_WINGS = new Set([0, 1, 19, 20, 21, 22, 23, 24, 25, 28]); // MAV_TYPE

const dot = (one, other) => one[0] * other[0] + one[1] * other[1] + one[2] * other[2];
const less = (one, other) => [one[0] - other[0], one[1] - other[1], one[2] - other[2]];

function ecef([lat, lon, alt]) {
  const n = A_M / Math.sqrt(1 - E2 * Math.sin(lat) ** 2), flat = (n + alt) * Math.cos(lat);
  return [flat * Math.cos(lon), flat * Math.sin(lon), (n * (1 - E2) + alt) * Math.sin(lat)];
}

class Scene {
  constructor(canvas) {
    this.canvas = canvas;
    Object.assign(this, { azimuth: 0.6, elevation: 0.45, distance: 350 });
    this.clear();
    this.listen();
  }
  clear() {
    this.origin = null;
    this.ground = null;
    this.tracks = TRACKS.map((track) => ({ ...track, points: [], newest_us: -Infinity }));
  }
  listen() {
    const { canvas } = this;
    let from = null;
    canvas.addEventListener("pointerdown", (event) => { from = [event.clientX, event.clientY]; canvas.setPointerCapture(event.pointerId); });
    canvas.addEventListener("pointerup", () => { from = null; });
    canvas.addEventListener("pointermove", (event) => {
      if (!from) return;
      this.turn((from[0] - event.clientX) / 150, (event.clientY - from[1]) / 150);
      from = [event.clientX, event.clientY];
    });
    canvas.addEventListener("wheel", (event) => {
      if (document.activeElement !== canvas) return; // the page scrolls until the view is chosen
      event.preventDefault();
      this.zoom(event.deltaY > 0 ? 1.15 : 1 / 1.15);
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => {
      const turns = { ArrowLeft: [0.1, 0], ArrowRight: [-0.1, 0], ArrowUp: [0, 0.08], ArrowDown: [0, -0.08] };
      if (event.key in turns) this.turn(...turns[event.key]);
      else if (event.key === "+" || event.key === "-") this.zoom(event.key === "-" ? 1.2 : 1 / 1.2);
      else return;
      event.preventDefault();
    });
  }
  turn(azimuth, elevation) {
    this.azimuth += azimuth;
    this.elevation = Math.max(0.03, Math.min(1.57, this.elevation + elevation));
    this.dirty = true;
  }
  zoom(factor) {
    this.distance = Math.max(20, Math.min(50000, this.distance * factor));
    this.dirty = true;
  }
  // East, north and up of a position on the earth, by its latitude and longitude in radians.
  place(position) { return this.local(ecef(position)); }
  local(point) {
    const [lat, lon] = this.origin;
    const d = less(point, this.base);
    const [sa, ca, so, co] = [Math.sin(lat), Math.cos(lat), Math.sin(lon), Math.cos(lon)];
    return [dot(d, [-so, co, 0]), dot(d, [-sa * co, -sa * so, ca]), dot(d, [ca * co, ca * so, sa])];
  }
  gather() {
    for (const track of this.tracks) {
      for (const name of track.from) {
        const table = store.tables.get(name);
        if (table?.sent.length) { this.follow(track, table); break; }
      }
    }
    const home = store.tables.get("GLOBAL_POSITION_INT");
    if (this.origin && home?.sent.length) this.ground = (home.newest("alt") - home.newest("relative_alt")) / 1e3 - this.origin[2];
  }
  follow(track, table) {
    const rows = table.sent;
    if (rows.at(-1)[0] < track.newest_us - 1e6) { track.points = []; track.newest_us = -Infinity; }
    let first = rows.length;
    while (first && rows[first - 1][0] > track.newest_us) first--;
    for (const row of rows.slice(first)) {
      if (row[0] - track.newest_us < TRACK_STEP_US) continue;
      const point = this.point(table, row);
      if (!point) continue;
      if (row[0] - track.newest_us > TRACK_GAP_US) track.points.push(null);
      track.newest_us = row[0];
      track.points.push(point);
    }
    if (track.points.length > TRACK_POINTS * 1.1) track.points = track.points.slice(-TRACK_POINTS);
  }
  point(table, row) {
    const read = (field) => row[table.place(field)];
    if (table.label === "fusion") return this.origin && this.local([read("x_m"), read("y_m"), read("z_m")]);
    if (!read("lat") && !read("lon")) return null; // no fix
    const position = [read("lat") / 1e7 / DEGREES, read("lon") / 1e7 / DEGREES, read("alt") / 1e3];
    if (!this.origin) { this.origin = position; this.base = ecef(position); }
    return this.place(position);
  }
  draw(attitude, type) {
    this.gather();
    const [ctx, width, height] = fitted(this.canvas);
    ctx.clearRect(0, 0, width, height);
    const main = this.tracks.find((track) => track.points.at(-1));
    if (!main) return;
    const here = main.points.at(-1);
    const ground = this.ground ?? Math.min(...main.points.filter(Boolean).map((point) => point[2])) - 30;
    const project = this.camera(here, width, height);
    const path = (points) => this.path(ctx, project, points);
    ctx.lineWidth = 1;
    ctx.strokeStyle = colour("--grid3d");
    this.grid(here, ground).forEach(path);
    ctx.setLineDash([3, 4]);
    ctx.strokeStyle = colour("--faint");
    path([here, [here[0], here[1], ground]]);
    ctx.setLineDash([]);
    ctx.lineWidth = 2;
    for (const track of [...this.tracks].reverse()) {
      ctx.strokeStyle = colour(track.stroke);
      path(track.points);
    }
    if (attitude) this.aircraft(ctx, project, here, attitude, WITH_WINGS.has(type ?? 0) ? WINGED : ROTORS);
  }
  camera(target, width, height) {
    const [sa, ca, se, ce] = [Math.sin(this.azimuth), Math.cos(this.azimuth), Math.sin(this.elevation), Math.cos(this.elevation)];
    const forward = [sa * ce, ca * ce, -se], right = [ca, -sa, 0], up = [sa * se, ca * se, ce];
    const eye = less(target, forward.map((one) => one * this.distance));
    const focal = 1.1 * Math.min(width, 1.4 * height);
    return (point) => {
      const d = less(point, eye), depth = dot(d, forward);
      if (depth < this.distance / 50) return null;
      return [width / 2 + dot(d, right) * focal / depth, height / 2 - dot(d, up) * focal / depth, depth];
    };
  }
  path(ctx, project, points) {
    ctx.beginPath();
    let joined = false;
    for (const point of points) {
      const seen = point && project(point);
      if (seen && joined) ctx.lineTo(seen[0], seen[1]);
      else if (seen) ctx.moveTo(seen[0], seen[1]);
      joined = Boolean(seen);
    }
    ctx.stroke();
  }
  grid([east, north], ground) {
    const step = 10 ** Math.round(Math.log10(this.distance / 3)), reach = 12;
    const [e0, n0] = [Math.round(east / step), Math.round(north / step)];
    const lines = [];
    for (let n = -reach; n <= reach; n++) {
      const along = Array.from({ length: 2 * reach + 1 }, (_, k) => k - reach);
      lines.push(along.map((k) => [(e0 + k) * step, (n0 + n) * step, ground]), along.map((k) => [(e0 + n) * step, (n0 + k) * step, ground]));
    }
    return lines;
  }
  aircraft(ctx, project, here, [w, x, y, z], mesh) {
    const size = this.distance * 0.09;
    const turn = ([fx, fy, fz]) => { // body to east, north, up
      const [a, b, c] = [y * fz - z * fy + w * fx, z * fx - x * fz + w * fy, x * fy - y * fx + w * fz];
      const ned = [fx + 2 * (y * c - z * b), fy + 2 * (z * a - x * c), fz + 2 * (x * b - y * a)];
      return [ned[1], ned[0], -ned[2]];
    };
    const faces = mesh.map((face) => face.map((corner) => {
      const turned = turn(corner);
      return project([0, 1, 2].map((k) => here[k] + turned[k] * size));
    })).filter((face) => face.every(Boolean));
    faces.sort((one, other) => Math.max(...other.map((p) => p[2])) - Math.max(...one.map((p) => p[2])));
    ctx.lineWidth = 1;
    ctx.lineJoin = "round";
    ctx.strokeStyle = colour("--paper");
    ctx.fillStyle = colour("--ink");
    for (const face of faces) {
      ctx.beginPath();
      face.forEach(([px, py], number) => number ? ctx.lineTo(px, py) : ctx.moveTo(px, py));
      ctx.closePath();
      ctx.fill();
      ctx.stroke();
    }
  }
  legend() {
    return this.tracks.filter((track) => track.points.length);
  }
}
