"use strict";
// A slider and a number for the value of an active fault. A streamed value is sent repeatedly, because the proxy
// forwards the healthy value when none arrives.

const SLIDER_MS = 80;

class LiveValue {
  // `value` is undefined if unknown; `timeout_s` is given if values are streamed.
  constructor(id, unit, value, timeout_s) {
    Object.assign(this, { id, timeout_s, wanted: null, busy: false, timer: 0 });
    const reach = Math.abs(value ?? 0) * 3 || 1;
    this.range = make("input", { type: "range", min: -reach, max: reach, step: reach / 300, value: value ?? 0, disabled: !token, hidden: value === undefined, ariaLabel: `Value of ${id}, slider` });
    this.number = make("input", { type: "number", step: "any", value: value ?? "", placeholder: "value", disabled: !token, ariaLabel: `Value of ${id}` });
    this.range.oninput = () => { this.number.value = this.range.value; this.set(Number(this.range.value)); };
    this.number.onchange = () => { if (this.number.value !== "") { this.reach(Number(this.number.value)); this.set(Number(this.number.value)); } };
    this.element = make("div", { className: "live" }, this.range, this.number, unit || "");
    if (timeout_s) this.element.append(this.streaming());
  }
  streaming() {
    this.toggle = make("button", { type: "button", className: "small", textContent: "Stream", disabled: !token, ariaLabel: `Stream the value of ${this.id}` });
    this.toggle.onclick = () => this.stream(!this.timer);
    this.stream(false);
    return this.toggle;
  }
  stream(on) {
    clearInterval(this.timer);
    if (!on) this.wanted = null; // a value that is still queued is not sent after the stop
    this.timer = on ? setInterval(() => this.set(Number(this.range.value)), this.timeout_s * 1000 / 3) : 0;
    this.toggle.setAttribute("aria-pressed", String(on));
    this.toggle.textContent = on ? "Stop streaming" : "Stream";
  }
  // Extend the slider's range to a number that was typed.
  reach(value) {
    this.range.hidden = false;
    const reach = Math.max(Number(this.range.max), Math.abs(value) * 1.5);
    Object.assign(this.range, { min: -reach, max: reach, step: reach / 300, value });
  }
  set(value) {
    this.wanted = value;
    if (this.toggle && !this.timer) this.stream(true);
    this.send();
  }
  async send() {
    if (this.busy || this.wanted === null) return;
    this.busy = true;
    const value = this.wanted;
    this.wanted = null;
    await attempt("schedule-message", () => post(`ctl/fault/${encodeURIComponent(this.id)}/value`, JSON.stringify({ value })).then(() => ""));
    setTimeout(() => { this.busy = false; this.send(); }, SLIDER_MS);
  }
  // Show the value set by another viewer.
  show(fault) {
    const value = fault.value ?? (typeof fault.parameters?.value === "number" ? fault.parameters.value : null);
    if (value === null || this.busy || this.element.contains(document.activeElement) || Number(this.number.value) === value) return;
    this.reach(value);
    this.number.value = value;
  }
  close() { clearInterval(this.timer); }
}
