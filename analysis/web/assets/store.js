"use strict";
// All data since the page was opened, by time: values received and forwarded by the proxy, and detector results. Source
// of the plots and the CSV file.

const ROWS_KEPT = 30000; // per message: ten minutes at 50 samples a second
const ALWAYS = ["HIL_STATE_QUATERNION", "HIL_SENSOR", "HIL_GPS", "GPS_RAW_INT", "ATTITUDE", "ATTITUDE_QUATERNION",
  "GLOBAL_POSITION_INT", "HEARTBEAT", "SYS_STATUS", "ESTIMATOR_STATUS", "EKF_STATUS_REPORT", "COMMAND_ACK"];

class Table {
  // Rows [t_us, values...] of one source; `sent` holds the same rows where no fault touched them.
  constructor(label, fields) {
    this.label = label;
    this.fields = fields;
    this.places = new Map(fields.map((name, number) => [name, number + 1]));
    this.received = [];
    this.sent = [];
    this.faulted = false;
  }
  add(received, sent) {
    const last = this.received.at(-1)?.[0] ?? -Infinity;
    if (received.length && received[0][0] < last - 1e6) { this.received = []; this.sent = []; } // the clock was reset
    this.faulted ||= Boolean(sent);
    this.received.push(...received);
    this.sent.push(...sent || received);
    if (this.received.length > ROWS_KEPT * 1.1) this.received = this.received.slice(-ROWS_KEPT);
    if (this.sent.length > ROWS_KEPT * 1.1) this.sent = this.sent.slice(-ROWS_KEPT);
  }
  has(field) { return this.places.has(field) || this.places.has(`${field}[0]`); }
  place(field) { return this.places.get(field) ?? this.places.get(`${field}[0]`); }
  newest(field, side = "sent") {
    const row = this[side].at(-1);
    return row && row[this.place(field)];
  }
  // The rows of the last `span_us` before `end_us`.
  window(side, end_us, span_us) {
    const rows = this[side];
    let first = rows.length;
    while (first && rows[first - 1][0] >= end_us - span_us) first--;
    return rows.slice(first);
  }
}

// Satellites rise and set: add columns for new ones, and reorder the rows.
function widen(table, one) {
  for (const name of one.fields) {
    if (table.places.has(name)) continue;
    table.fields.push(name);
    table.places.set(name, table.fields.length);
  }
  const order = (row) => {
    const found = new Array(table.fields.length + 1).fill(null);
    found[0] = row[0];
    one.fields.forEach((name, n) => { found[table.places.get(name)] = row[n + 1]; });
    return found;
  };
  one.received = one.received.map(order);
  one.sent &&= one.sent.map(order);
}

class Store {
  constructor() { this.clear(); }
  clear() {
    this.sources = new Map(); // message/system/component/instance -> Table
    this.tables = new Map(); // label -> Table
    this.newest_us = null;
    this.t0_us = null;
  }
  take(batch) {
    for (const one of batch) {
      const key = `${one.message}/${one.system}/${one.component}/${one.instance}`;
      if (!this.sources.has(key)) this.sources.set(key, this.table(this.label(one), one.fields));
      const table = this.sources.get(key);
      if (one.fields.length !== table.fields.length || one.fields.some((name, n) => name !== table.fields[n])) widen(table, one);
      table.add(one.received, one.sent);
      this.seen(one.received.at(-1)?.[0]);
    }
  }
  // The first source of a message has its name as label; further ones add instance or system and component.
  label(one) {
    if (!this.tables.has(one.message)) return one.message;
    const number = one.instance ? ` ${one.instance}` : "";
    const plain = `${one.message}${number}`;
    return this.tables.has(plain) ? `${plain} of ${one.system}/${one.component}` : plain;
  }
  table(label, fields) {
    if (!this.tables.has(label)) this.tables.set(label, new Table(label, fields));
    return this.tables.get(label);
  }
  // A row that is not a message; rows that repeat after a reconnection, with an old `t_us`, are ignored.
  note(label, t_us, values) {
    const table = this.table(label, Object.keys(values));
    if (t_us <= table.received.at(-1)?.[0]) return;
    table.add([[t_us, ...Object.values(values)]], null);
    this.newest_us = Math.max(this.newest_us ?? t_us, t_us); // results are late: they must not set the clock back
  }
  // The newest time of any message; a jump back is a clock reset.
  seen(t_us) { if (t_us > this.newest_us || t_us < this.newest_us - 1e6) this.newest_us = t_us; }
  seconds(t_us) { return (t_us - (this.t0_us ?? 0)) / 1e6; }

  // One line per time; cells without a value are empty.
  csv() {
    const columns = ["t_s", "t_us"], lines = new Map();
    for (const table of this.tables.values()) {
      for (const side of table.faulted ? ["received", "sent"] : ["received"]) {
        const first = columns.length;
        columns.push(...table.fields.map((field) => `${table.label}.${field}${table.faulted ? ` ${side}` : ""}`));
        for (const [t_us, ...values] of table[side]) {
          if (!lines.has(t_us)) lines.set(t_us, [this.seconds(t_us).toFixed(6), t_us]);
          const line = lines.get(t_us);
          values.forEach((value, number) => { line[first + number] = value; });
        }
      }
    }
    const cell = (value) => value == null ? "" : /[",\n]/.test(value) ? `"${String(value).replaceAll('"', '""')}"` : value;
    const line = (values) => Array.from(columns, (_, number) => cell(values[number])).join(",");
    const sorted = [...lines.keys()].sort((one, other) => one - other);
    return [columns.map(cell).join(","), ...sorted.map((t_us) => line(lines.get(t_us)))].join("\n") + "\n";
  }
}

const store = new Store();
