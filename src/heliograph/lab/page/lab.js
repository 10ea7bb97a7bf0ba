// The page's own doings: which experiment is open, what its controls say, and what the engine answered.
// @ts-check
import { motion, play, show } from "./charts.js";

/** @typedef {{name: string, label: string, default: number | string | boolean, low: number, high: number, step: number,
 *   unit: string, choices: string[], live: boolean}} Control */
/** @typedef {{name: string, title: string, chapter: string, question: string, command: string, code: string,
 *   controls: Control[], actions: {name: string, label: string, hint: string}[],
 *   worked: {text: string, value: number, digits: number}[]}} Experiment */

/** @param {string} id */
const at = (id) => /** @type {HTMLElement} */ (document.getElementById(id));
const state = {
  /** @type {Experiment[]} */ experiments: [],
  /** @type {Experiment | null} */ open: null,
  run: 0,
  busy: false,
  auto: false,
  done: false,
  /** @type {string | null} */ waiting: null,
  /** @type {any} */ view: null,
  milliseconds: 0,
};

/** Asks the engine; its refusals come back as an error in words.
 * @param {string} path
 * @param {object} body */
async function ask(path, body) {
  const began = performance.now();
  const answer = await fetch(path, { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify(body) });
  const found = await answer.json();
  state.milliseconds = performance.now() - began;
  if (!answer.ok) throw new Error(found.error ?? answer.statusText);
  return found;
}

function settings() {
  /** @type {Record<string, any>} */
  const found = {};
  for (const control of state.open?.controls ?? []) {
    if (control.choices.length) {
      const chosen = /** @type {HTMLInputElement} */ (document.querySelector(`input[name="${control.name}"]:checked`));
      found[control.name] = chosen.value;
    } else {
      const field = /** @type {HTMLInputElement} */ (at(`control-${control.name}`));
      found[control.name] = field.type === "checkbox" ? field.checked : Number(field.value);
    }
  }
  return found;
}

/** Does one thing at a time: "begin", "show" or an action. What comes meanwhile waits; the last one counts.
 * @param {string} what */
async function act(what) {
  if (!state.open) return;
  if (state.busy) {
    state.waiting = what === "begin" || state.waiting !== "begin" ? what : "begin";
    return;
  }
  state.busy = true;
  const asked = state.open;
  const stage = at("stage");
  try {
    let found = what === "begin"
      ? await ask("api/runs", { experiment: asked.name, settings: settings() })
      : await ask(`api/runs/${state.run}`, { action: what, settings: settings() });
    while (found.pending && asked === state.open && state.waiting !== "begin") {
      state.run = found.run;
      stage.setAttribute("aria-busy", "true");
      say(found.view.message, false);
      found = await ask(`api/runs/${found.run}`, { action: "show", settings: settings() });
    }
    stage.setAttribute("aria-busy", "false");
    if (asked === state.open && !found.pending) {
      state.run = found.run;
      render(found.view);
      if (what !== "show") play(at("charts"), found.view.charts);
    }
  } catch (error) {
    say(error instanceof Error ? error.message : String(error), true);
    setAuto(false);
  }
  state.busy = false;
  const next = state.waiting;
  state.waiting = null;
  if (next) await act(next);
  else if (state.auto && !state.done) requestAnimationFrame(() => { if (state.auto && state.open) act(state.open.actions[0].name); });
}

/** @param {string} message
 * @param {boolean} error */
function say(message, error) {
  at("message").textContent = message;
  at("message").classList.toggle("error", error);
}

/** @param {any} view */
function render(view) {
  state.view = view;
  state.done = view.done;
  say(view.message, false);
  at("readings").replaceChildren(...view.readings.map(reading));
  show(at("charts"), view.charts);
  for (const button of document.querySelectorAll("#buttons button[data-action]")) {
    const first = button.getAttribute("data-action") === state.open?.actions[0].name;
    /** @type {HTMLButtonElement} */ (button).disabled = view.done && first && !isOneShot();
  }
  if (view.done) setAuto(false);
}

/** An experiment that is done at once is solved anew whenever asked. */
function isOneShot() {
  return state.open?.actions[0].name === "solve";
}

/** @param {{name: string, label: string, value: number | string | null, digits: number, unit: string}} item */
function reading(item) {
  const box = document.createElement("div");
  box.dataset.reading = item.name;
  const [term, value, unit] = [document.createElement("dt"), document.createElement("dd"), document.createElement("small")];
  term.textContent = item.label;
  value.textContent = item.value === null ? "–" : typeof item.value === "string" ? item.value : item.value.toFixed(item.digits);
  value.dataset.value = String(item.value);
  unit.textContent = item.unit ? ` ${item.unit}` : "";
  value.append(unit);
  box.append(term, value);
  return box;
}

/** @param {boolean} on */
function setAuto(on) {
  state.auto = on;
  const button = document.getElementById("auto");
  button?.setAttribute("aria-pressed", String(on));
  if (button) button.textContent = on ? "Pause" : "Auto";
}

/** @param {Control} control */
function field(control) {
  const box = document.createElement("div");
  box.className = "field";
  if (control.choices.length) {
    const set = document.createElement("fieldset");
    const legend = document.createElement("legend");
    const choices = document.createElement("div");
    legend.textContent = control.label;
    choices.className = "choices";
    for (const word of control.choices) {
      const label = document.createElement("label");
      const input = document.createElement("input");
      Object.assign(input, { type: "radio", name: control.name, value: word, checked: word === control.default });
      label.append(input, word);
      choices.append(label);
    }
    set.append(legend, choices);
    box.append(set);
  } else {
    const label = document.createElement("label");
    const input = document.createElement("input");
    input.id = label.htmlFor = `control-${control.name}`;
    input.name = control.name;
    if (typeof control.default === "boolean") {
      Object.assign(input, { type: "checkbox", checked: control.default });
      label.className = "switch";
      label.append(input, control.label);
      box.append(label);
    } else {
      const shown = document.createElement("output");
      Object.assign(input, { type: "range", min: control.low, max: control.high, step: control.step });
      input.value = String(control.default);
      const tell = () => {
        shown.textContent = `${Number(input.value)}${control.unit ? ` ${control.unit}` : ""}`;
        input.setAttribute("aria-valuetext", shown.textContent);
      };
      input.addEventListener("input", tell);
      tell();
      label.append(control.label, shown);
      box.append(label, input);
    }
  }
  box.addEventListener("input", () => act(control.live ? "show" : "begin"));
  return box;
}

function buttons() {
  const made = (state.open?.actions ?? []).map((action, index) => {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = action.label;
    button.title = action.hint;
    button.dataset.action = action.name;
    button.className = index === 0 ? "main" : "";
    button.addEventListener("click", () => act(action.name));
    return button;
  });
  const auto = document.createElement("button");
  Object.assign(auto, { type: "button", id: "auto", textContent: "Auto", title: "step again and again", hidden: isOneShot() });
  auto.addEventListener("click", toggleAuto);
  const again = document.createElement("button");
  Object.assign(again, { type: "button", id: "again", textContent: "Begin again", title: "with the controls as they are" });
  again.addEventListener("click", () => { setAuto(false); act("begin"); });
  return [...made, auto, again];
}

function toggleAuto() {
  setAuto(!state.auto);
  if (state.auto && state.open) act(state.done ? "begin" : state.open.actions[0].name);
}

function open() {
  const name = location.hash.slice(1);
  const experiment = state.experiments.find((one) => one.name === name) ?? state.experiments[0];
  setAuto(false);
  state.open = experiment;
  document.title = `${experiment.title} · Heliograph lab`;
  at("chapter").textContent = `Chapter ${experiment.chapter}`;
  for (const key of /** @type {const} */ (["title", "question", "command", "code"])) at(key).textContent = experiment[key];
  at("controls").replaceChildren(...experiment.controls.map(field));
  at("buttons").replaceChildren(...buttons());
  show(at("charts"), []);
  at("readings").replaceChildren();
  at("worked").replaceChildren(...experiment.worked.map((number) => {
    const row = document.createElement("tr");
    for (const text of [number.text, number.value.toFixed(number.digits)]) row.insertCell().textContent = text;
    row.cells[1].dataset.value = String(number.value);
    return row;
  }));
  at("worked").closest("section")?.toggleAttribute("hidden", experiment.worked.length === 0);
  for (const link of document.querySelectorAll("nav a")) {
    const here = link.getAttribute("href") === `#${experiment.name}`;
    if (here) {
      link.setAttribute("aria-current", "page");
      link.scrollIntoView({ block: "nearest", inline: "center" }); // the row is wider than a phone
    } else link.removeAttribute("aria-current");
  }
  act("begin");
}

/** @param {KeyboardEvent} event */
function onKey(event) {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const target = /** @type {HTMLElement} */ (event.target);
  const typing = ["INPUT", "BUTTON", "A", "TEXTAREA"].includes(target.tagName);
  if (event.key === " " && !typing && state.open) {
    event.preventDefault();
    if (!state.done) act(state.open.actions[0].name);
  } else if (event.key.toLowerCase() === "a" && !isOneShot()) toggleAuto();
  else if (event.key.toLowerCase() === "r") at("again").click();
  else if (/^[1-9]$/.test(event.key) && state.experiments[Number(event.key) - 1]) {
    location.hash = state.experiments[Number(event.key) - 1].name;
  }
}

async function start() {
  state.experiments = await (await fetch("api/experiments")).json();
  at("experiments").replaceChildren(...state.experiments.map((experiment) => {
    const item = document.createElement("li");
    const link = document.createElement("a");
    link.href = `#${experiment.name}`;
    link.textContent = experiment.title;
    item.append(link);
    return item;
  }));
  at("controls").addEventListener("submit", (event) => event.preventDefault());
  document.addEventListener("keydown", onKey);
  addEventListener("hashchange", open);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { if (state.view) show(at("charts"), state.view.charts); });
  open();
}

// For tests, and for the curious: what the page holds.
Object.assign(globalThis, { heliographLab: { state, act, settings, motion } });
start().catch((error) => say(`The lab does not answer: ${error.message}`, true));
