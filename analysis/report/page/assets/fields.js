"use strict";
// Plots of any field: a message's numbers are unpacked, or loaded from `report-data/`, on demand.

class Fields {
  constructor(page, axis, address, plotted) {
    Object.assign(this, { page, axis, address, plotted, waiting: new Map(), messages: new Map() });
    this.index = new Map(page.fields.map((entry) => [entry.name, entry]));
    this.form = document.getElementById("field-form");
    if (!this.form) return;
    this.text = document.getElementById("field-text");
    this.text.addEventListener("focus", () => this.offer(), { once: true });
    this.form.addEventListener("submit", (event) => { event.preventDefault(); this.ask(this.text.value); });
  }
  offer() {
    const names = document.getElementById("field-names");
    for (const entry of this.index.values()) for (const field of entry.fields) {
      const option = document.createElement("option");
      option.value = `${entry.name}.${field.name}`;
      names.append(option);
    }
  }
  say(text) { document.getElementById("field-said").textContent = text; }
  async ask(text) {
    try {
      this.say("");
      const trees = parts(text).map((part) => [part, parse(part)]);
      if (!trees.length) throw new Error("give a field, such as " + this.example());
      const curves = new Map(), notes = [];
      for (const [part, tree] of trees) {
        const names = fieldsOf(tree);
        if (!names.length) throw new Error(`${part} contains no field`);
        for (const name of names) if (!curves.has(name)) curves.set(name, await this.curve(name, notes));
      }
      this.show(text, trees.map(([part, tree]) => ({ name: part, ...evaluate(tree, curves) })), notes);
      return true;
    } catch (error) {
      this.say(error.message);
      return false;
    }
  }
  example() {
    const entry = this.page.fields.find((one) => one.fields.length);
    return entry ? `${entry.name}.${entry.fields[0].name}` : "ATTITUDE.roll";
  }
  async curve(name, notes) {
    const at = name.indexOf("."), entry = this.index.get(name.slice(0, at));
    if (!entry) throw new Error(`the log has no message ${name.slice(0, at)}`);
    const field = entry.fields.find((one) => one.name === name.slice(at + 1));
    if (!field) throw new Error(`${entry.name} has no field ${name.slice(at + 1)}; it has ${entry.fields.slice(0, 12).map((one) => one.name).join(", ")}`);
    const numbers = await this.numbers(entry);
    if (entry.step > 1) notes.push(`${entry.name}: thinned to every ${entry.step}th of ${entry.rows} rows; --data beside keeps all`);
    const y = decodeValues(field.y, numbers, false);
    if (field.add) for (let i = 0; i < y.length; i++) if (y[i] !== null) y[i] += field.add;
    return { t: entry.times ??= decodeTimes(entry.t, numbers, entry.number), y };
  }
  numbers(entry) {
    if (!this.messages.has(entry.number)) {
      const inside = document.getElementById(`fields-${entry.number}`);
      this.messages.set(entry.number, inside ? unpack(inside.textContent) : this.fetched(entry));
    }
    return this.messages.get(entry.number);
  }
  // A script beside the file passes its numbers to `arrived`: a page opened as a file can load nothing else.
  fetched(entry) {
    return new Promise((resolve, reject) => {
      const script = document.createElement("script");
      this.waiting.set(entry.number, resolve);
      script.src = `report-data/${entry.number}.js`;
      script.onerror = () => { this.messages.delete(entry.number); reject(new Error(`report-data/${entry.number}.js is missing; keep report-data beside this file`)); };
      document.head.append(script);
    });
  }
  arrived(number, text) { unpack(text).then(this.waiting.get(number)); }
  show(text, curves, notes) {
    const place = document.createElement("div"), title = document.createElement("h3"), area = document.createElement("div");
    const close = document.createElement("button");
    place.className = "plot"; area.className = "area"; title.textContent = text;
    close.textContent = "remove"; close.className = "moment"; close.setAttribute("aria-label", `remove the plot of ${text}`);
    title.append(" ", close);
    place.append(title, area);
    if (notes.length) place.append(Object.assign(document.createElement("p"), { className: "note", textContent: notes.join("; ") }));
    document.getElementById("field-plots").append(place);
    this.address.plots.push(text);
    this.address.later();
    const remove = this.plotted(area, text, curves);
    close.onclick = () => {
      remove();
      place.remove();
      this.address.plots.splice(this.address.plots.indexOf(text), 1);
      this.address.later();
    };
  }
}
