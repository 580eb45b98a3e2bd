"use strict";
// The aircraft in space with its tracks: truth, GPS, autopilot and fusion. Positions are relative to the first one.

const A_M = 6378137, E2 = 6.69437999014e-3; // WGS 84
const TRACK_POINTS = 3000, TRACK_STEP_US = 200000, TRACK_GAP_US = 3e6;
const TRACKS = [
  { name: "truth", stroke: "--s2", from: ["HIL_STATE_QUATERNION"] },
  { name: "GPS (forwarded)", stroke: "--s1", from: ["HIL_GPS", "GPS_RAW_INT"] },
  { name: "autopilot", stroke: "--s0", from: ["GLOBAL_POSITION_INT"] },
  { name: "fusion", stroke: "--s3", from: ["fusion"] },
];

function ecef([lat, lon, alt]) {
  const n = A_M / Math.sqrt(1 - E2 * Math.sin(lat) ** 2), flat = (n + alt) * Math.cos(lat);
  return [flat * Math.cos(lon), flat * Math.sin(lon), (n * (1 - E2) + alt) * Math.sin(lat)];
}

class Scene extends Space {
  constructor(canvas) {
    super(canvas);
    this.clear();
  }
  clear() {
    this.origin = null;
    this.ground = null;
    this.tracks = TRACKS.map((track) => ({ ...track, points: [], newest_us: -Infinity }));
  }
  // East, north and up of a geodetic position, latitude and longitude in radians.
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
    const [ctx, width, height] = fitCanvas(this.canvas);
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
  legend() {
    return this.tracks.filter((track) => track.points.length);
  }
}
