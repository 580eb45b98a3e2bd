"use strict";
// A form made from a JSON Schema. Each part is {element, value()}; value() is undefined when empty. Text that is not a
// number is sent unchanged: the server's check reports the error.

const UNITS = { _s: "s", _m: "m", _hz: "Hz", _rad: "rad", _mps: "m/s", _deg: "deg", _db: "dB" };
// Labels of the entry's own keys; inside a profile `at_s` and `for_s` are the function's own time.
const LABELS = { at_s: "start in, s (0: now)", for_s: "duration, s (empty: until disarmed)", id: "name", when: "when (condition)", via: "direction" };
const RARE_KEYS = ["id", "when", "after", "repeat", "where", "probability", "via"];
let numbered = 0;

function spelled(key) {
  const end = Object.keys(UNITS).find((suffix) => key.endsWith(suffix));
  return (end ? `${key.slice(0, -end.length)}, ${UNITS[end]}` : key).replaceAll("_", " ");
}

function resolved(schema, defs) {
  if (schema.$ref) return { ...defs[schema.$ref.split("/").pop()], default: schema.default };
  if (!schema.anyOf) return schema;
  const choices = schema.anyOf.map((one) => resolved(one, defs)).filter((one) => one.type !== "null");
  const plain = choices.find((one) => ["number", "integer", "string"].includes(one.type)) || choices[0];
  return { ...plain, default: schema.default, several: choices.some((one) => one.type === "array") };
}

function scalar(text, schema) {
  if (!["number", "integer"].includes(schema.type)) return text;
  const number = Number(text);
  return Number.isFinite(number) ? number : text;
}

function labelled(key, control) {
  control.id = control.id || `field-${++numbered}`;
  const label = make("label", { htmlFor: control.id, textContent: spelled(key) });
  return make("div", { className: "field" }, label, control);
}

function textPart(key, schema) {
  const list = schema.type === "array" || schema.several;
  const items = schema.type === "array" ? schema.items || {} : schema;
  const input = make("input", { type: "text", spellcheck: false });
  input.dataset.key = key;
  if (schema.default != null && !(Array.isArray(schema.default) && !schema.default.length)) {
    input.placeholder = String(schema.default);
  }
  return {
    element: labelled(key, input),
    value() {
      const text = input.value.trim();
      if (!text) return undefined;
      if ("[{".includes(text[0])) { try { return JSON.parse(text); } catch { return text; } }
      if (!list || (schema.type !== "array" && !text.includes(","))) return scalar(text, schema);
      return text.split(",").map((one) => scalar(one.trim(), items));
    },
  };
}

function choicePart(key, schema) {
  const select = make("select", {}, make("option", { value: "", textContent: "–" }),
    ...schema.enum.map((one) => make("option", { value: one, textContent: one })));
  select.dataset.key = key;
  return { element: labelled(key, select), value: () => select.value || undefined };
}

function switchPart(key, schema) {
  const box = make("input", { type: "checkbox", checked: Boolean(schema.default) });
  return { element: labelled(key, box), value: () => box.checked === Boolean(schema.default) ? undefined : box.checked };
}

function objectPart(key, schema, defs) {
  const inner = fieldsOf(schema.properties, defs);
  const box = make("details", {}, make("summary", { textContent: spelled(key) }), make("div", {}, ...inner.elements));
  return { element: box, value: inner.value };
}

// A constant value or a function of time: one selection, and only the fields it needs.
const SHAPES = { segments: "straight segments", sine: "sine", impulses: "impulses", table: "series from a file", live: "live, by slider" };

function shapePart(value, profile, defs) {
  const { properties } = resolved(profile, defs);
  const select = make("select", {}, make("option", { value: "", textContent: "constant" }),
    ...Object.entries(SHAPES).map(([kind, text]) => make("option", { value: kind, textContent: text })));
  select.dataset.key = "shape";
  const constant = partOf("value", value, defs);
  const area = make("div", { className: "shape" });
  let inner = null, kind = "";
  const layOut = () => {
    kind = select.value;
    inner = kind ? fieldsOf({ mode: properties.mode, [kind]: properties[kind] }, defs) : null;
    area.replaceChildren(...inner ? inner.elements : [constant.element]);
    for (const fold of area.querySelectorAll(":scope > details")) fold.open = true;
    area.querySelector("button.more")?.click();
  };
  select.addEventListener("change", layOut);
  layOut();
  const profiled = () => ({ [kind]: kind === "segments" ? [] : {}, ...inner.value() });
  return {
    element: make("div", {}, labelled("changes over time", select), area),
    value: () => inner ? { profile: profiled() } : constant.value() === undefined ? {} : { value: constant.value() },
  };
}

function rowsPart(key, items, defs) {
  const rows = new Set();
  const list = make("div");
  const add = () => {
    const inner = fieldsOf(items.properties, defs);
    const remove = make("button", { type: "button", textContent: "Remove" });
    const row = make("div", { className: "row" }, ...inner.elements, remove);
    remove.onclick = () => { rows.delete(inner); row.remove(); box.dispatchEvent(new Event("input", { bubbles: true })); };
    rows.add(inner);
    list.append(row);
    row.querySelector("input")?.focus();
  };
  const more = make("button", { type: "button", className: "more", textContent: `Add to ${spelled(key)}`, onclick: add });
  const box = make("details", {}, make("summary", { textContent: spelled(key) }), make("div", {}, list, more));
  return { element: box, value: () => rows.size ? [...rows].map((row) => row.value() || {}) : undefined };
}

function partOf(key, given, defs) {
  const schema = resolved(given, defs);
  if (schema.enum) return choicePart(key, schema);
  if (schema.type === "boolean") return switchPart(key, schema);
  if (schema.type === "object" && schema.properties) return objectPart(key, schema, defs);
  if (schema.type === "array") {
    const items = resolved(schema.items || {}, defs);
    if (items.properties) return rowsPart(key, items, defs);
    return textPart(key, { ...schema, items });
  }
  return textPart(key, schema);
}

function fieldsOf(properties, defs) {
  const parts = Object.entries(properties).map(([key, schema]) => [key, partOf(key, schema, defs)]);
  return {
    elements: parts.map(([, part]) => part.element),
    value() {
      const filled = parts.map(([key, part]) => [key, part.value()]).filter(([, value]) => value !== undefined);
      return filled.length ? Object.fromEntries(filled) : undefined;
    },
  };
}

// The form of one fault or preset: main keys first, rarely used keys folded away.
function faultForm(area, schema, defs) {
  const { fault, preset, ...keys } = schema.properties;
  const shaped = keys.value && keys.profile ? shapePart(keys.value, keys.profile, defs) : null;
  const own = Object.keys(keys).filter((key) => ![...RARE_KEYS, "target", "at_s", "for_s"].includes(key) && !(shaped && ["value", "profile"].includes(key)));
  const some = (names) => fieldsOf(Object.fromEntries(names.filter((key) => key in keys).map((key) => [key, keys[key]])), defs);
  const target = some(["target"]), main = some([...own, "at_s", "for_s"]);
  const later = fieldsOf(Object.fromEntries(RARE_KEYS.filter((key) => key in keys).map((key) => [key, keys[key]])), defs);
  const fold = make("details", {}, make("summary", { textContent: "more: name, condition, repetition, which frames" }), make("div", {}, ...later.elements));
  area.replaceChildren(...target.elements, ...shaped ? [shaped.element] : [], ...main.elements, fold);
  for (const [key, text] of Object.entries(LABELS)) {
    const own = area.querySelector(`:scope > .field > [data-key=${key}], :scope > details:last-child > div > .field > [data-key=${key}]`);
    if (own) own.previousSibling.textContent = text;
  }
  area.querySelector("[data-key=target]")?.setAttribute("list", "targets");
  return () => ({ ...target.value(), ...shaped?.value(), ...main.value(), ...later.value() });
}
