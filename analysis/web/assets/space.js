"use strict";
// A view into space: camera, ground, paths and an aircraft. Points are east, north, up in metres. Drag or arrow keys
// rotate, + and - zoom.

// Set a canvas to its size on the screen in device pixels; its context uses CSS pixels.
function fitCanvas(canvas) {
  const ratio = devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const ctx = canvas.getContext("2d");
  ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
  return [ctx, width, height];
}

// Triangles in body axes (forward, right, down), in units of the aircraft's size.
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

class Space {
  constructor(canvas) {
    this.canvas = canvas;
    Object.assign(this, { azimuth: 0.6, elevation: 0.45, distance: 350 });
    this.listen();
  }
  changed() { this.dirty = true; }
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
      if (document.activeElement !== canvas) return; // the page scrolls unless the view has the focus
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
    this.changed();
  }
  zoom(factor) {
    this.distance = Math.max(20, Math.min(50000, this.distance * factor));
    this.changed();
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
  // The true attitude filled, the estimate as an outline.
  aircraft(ctx, project, here, [w, x, y, z], mesh, believed = false) {
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
    ctx.strokeStyle = colour(believed ? "--s1" : "--paper");
    ctx.fillStyle = colour("--ink");
    for (const face of faces) {
      ctx.beginPath();
      face.forEach(([px, py], number) => number ? ctx.lineTo(px, py) : ctx.moveTo(px, py));
      ctx.closePath();
      if (!believed) ctx.fill();
      ctx.stroke();
    }
  }
}
