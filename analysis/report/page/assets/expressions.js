"use strict";
// Expressions over fields, such as `deg(ATTITUDE.roll) - mean(ATTITUDE.pitch, 2)`: parsed, and evaluated
// at the times of the first field; others are interpolated.

const FIELD = /^[A-Za-z_][\w@]*(?:\.\w+(?:\[\d+\])?)+/;
const FUNCTIONS = { abs: Math.abs, sqrt: Math.sqrt, sin: Math.sin, cos: Math.cos, tan: Math.tan, asin: Math.asin, acos: Math.acos,
  atan2: Math.atan2, hypot: Math.hypot, min: Math.min, max: Math.max, log: Math.log, exp: Math.exp,
  deg: (x) => x * 180 / Math.PI, rad: (x) => x * Math.PI / 180 };
const OVER_TIME = { diff, mean };

function diff(t, y) {
  return y.map((value, i) => i && t[i] > t[i - 1] ? (value - y[i - 1]) / (t[i] - t[i - 1]) : NaN);
}

// The mean of the last seconds.
function mean(t, y, seconds) {
  let first = 0, sum = 0, count = 0;
  return y.map((value, i) => {
    if (Number.isFinite(value)) { sum += value; count++; }
    while (t[first] < t[i] - seconds[i]) { if (Number.isFinite(y[first])) { sum -= y[first]; count--; } first++; }
    return count ? sum / count : NaN;
  });
}

// An expression as a tree: {field}, {number} or {call, of}.
function parse(text) {
  let rest = text.trim();
  const eat = (pattern) => {
    const found = rest.match(pattern);
    if (found) rest = rest.slice(found[0].length).trimStart();
    return found && found[0];
  };
  const sum = () => {
    let tree = product();
    for (let sign; (sign = eat(/^[+-]/));) tree = { call: sign, of: [tree, product()] };
    return tree;
  };
  const product = () => {
    let tree = signed();
    for (let sign; (sign = eat(/^[*/]/));) tree = { call: sign, of: [tree, signed()] };
    return tree;
  };
  const signed = () => eat(/^-/) ? { call: "-", of: [{ number: 0 }, signed()] } : power();
  const power = () => {
    const base = term();
    return eat(/^\^/) ? { call: "^", of: [base, signed()] } : base;
  };
  const term = () => {
    if (eat(/^\(/)) {
      const inside = sum();
      if (!eat(/^\)/)) throw new Error("a bracket is not closed");
      return inside;
    }
    const number = eat(/^\d+(?:\.\d*)?(?:e[+-]?\d+)?/i);
    if (number) return { number: Number(number) };
    const field = eat(FIELD);
    if (field) return { field };
    const name = eat(/^[a-z]\w*/i);
    if (name === "pi") return { number: Math.PI };
    if (!name || !(name in FUNCTIONS || name in OVER_TIME)) throw new Error(`${JSON.stringify(name || rest || text)} is not a field, number or function`);
    if (!eat(/^\(/)) throw new Error(`${name} needs arguments in brackets`);
    const of = [sum()];
    while (eat(/^,/)) of.push(sum());
    if (!eat(/^\)/)) throw new Error("a bracket is not closed");
    return { call: name, of };
  };
  const tree = sum();
  if (rest) throw new Error(`${JSON.stringify(rest)} is not expected after the expression`);
  return tree;
}

// Splits a text at commas outside brackets into expressions.
function parts(text) {
  const found = [""];
  let depth = 0;
  for (const sign of text) {
    depth += (sign === "(") - (sign === ")");
    if (sign === "," && depth === 0) found.push(""); else found[found.length - 1] += sign;
  }
  return found.map((part) => part.trim()).filter(Boolean);
}

function fieldsOf(tree) {
  return tree.field ? [tree.field] : (tree.of || []).flatMap(fieldsOf);
}

const SIGNS = { "+": (a, b) => a + b, "-": (a, b) => a - b, "*": (a, b) => a * b, "/": (a, b) => a / b, "^": (a, b) => a ** b };

// `curves` holds {t, y} by field; the result has the times of the first field.
function evaluate(tree, curves) {
  const { t } = curves.get(fieldsOf(tree)[0]);
  const work = (node) => {
    if (node.field) return interpolated(curves.get(node.field), t);
    if (node.number !== undefined) return new Array(t.length).fill(node.number);
    const of = node.of.map(work);
    if (node.call in OVER_TIME) return OVER_TIME[node.call](t, ...of);
    const each = SIGNS[node.call] || FUNCTIONS[node.call];
    return of[0].map((_, i) => each(...of.map((values) => values[i])));
  };
  return { t, y: work(tree) };
}

function interpolated(curve, t) {
  if (curve.t === t) return Array.from(curve.y, (value) => value ?? NaN);
  let k = 0;
  return Array.from(t, (at) => {
    while (k < curve.t.length - 2 && curve.t[k + 1] < at) k++;
    if (at < curve.t[0] || at > curve.t[curve.t.length - 1]) return NaN;
    const span = curve.t[k + 1] - curve.t[k], share = span > 0 ? (at - curve.t[k]) / span : 0;
    return curve.y[k] + share * ((curve.y[k + 1] ?? curve.y[k]) - curve.y[k]);
  });
}
