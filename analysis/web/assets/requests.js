"use strict";
// DOM helpers, requests to the server, and messages of their results.

const $ = (id) => document.getElementById(id);

function make(tag, properties = {}, ...children) {
  const element = Object.assign(document.createElement(tag), properties);
  element.append(...children);
  return element;
}

const printed = new URLSearchParams(location.hash.slice(1)).get("token");
if (printed) {
  sessionStorage.setItem("token", printed);
  history.replaceState(null, "", location.pathname);
}
const token = sessionStorage.getItem("token") || "";

// While a button is held down nothing on the page moves: a click that ends beside its button is lost.
let pressed = false, released = Promise.resolve(), release = () => {};
addEventListener("pointerdown", (event) => {
  if (event.button || !event.target.closest("button, summary, label, a")) return;
  pressed = true;
  released = new Promise((resolve) => { release = resolve; });
}, true);
for (const type of ["pointerup", "pointercancel"])
  addEventListener(type, () => setTimeout(() => { pressed = false; release(); }), true); // after the click

async function post(path, body = "") {
  let reply;
  try {
    reply = await fetch(`/api/${path}`, { method: "POST", headers: { "X-Token": token }, body });
  } catch {
    throw new Error("the page's server does not answer; is it still running?");
  }
  const value = await reply.json();
  await released;
  if (!reply.ok) throw new Error(value.error);
  return value;
}

function showMessage(id, text, fine = false) {
  $(id).textContent = text;
  $(id).hidden = !text;
  $(id).classList.toggle("fine", fine);
}

async function attempt(id, act) {
  try { showMessage(id, await act() || "", true); } catch (error) { showMessage(id, error.message); }
}

function download(name, text, type) {
  const link = make("a", { download: name, href: URL.createObjectURL(new Blob([text], { type })) });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}
