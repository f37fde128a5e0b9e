// The journal: what processes, presses and people did, newest first; what repeats within minutes is one line.
import { announce } from "../announce.js";
import { get, post } from "../api.js";
import { byHand, clock, duration, el, table, when } from "../dom.js";
import { inWords, text } from "../words.js";
import { refuse } from "./alarms.js";

const TOGETHER_S = 300;
const PAGE = 100;
const PRESS = "press"; // what the presses did, beside what processes wrote

// What happened at a time nobody knows comes last.
const at = (one) => (one.utc ? Date.parse(one.utc) : 0);

export async function show(place, context) {
  const asked = { level: context.query.get("level") ?? "", process: context.query.get("process") ?? "", press: context.query.get("press") ?? "" };
  const rows = el("div", { "data-testid": "journal" });
  const more = el("button", { type: "button", class: "button", hidden: true, onclick: () => load(true) }, text("page-more"));
  const { processes } = await get("/health");
  const offered = new Set([PRESS, ...processes.map(({ name }) => name), asked.process].filter(Boolean));
  const byProcess = choice("process", "page-process", [...offered].map((one) => [one, one === PRESS ? text("page-press-events") : one]));
  const filters = el("div", { class: "row" },
    choice("level", "page-level", ["info", "warning", "alarm"].map((one) => [one, text(`page-level-${one}`)])),
    byProcess,
    context.presses.length > 1 ? choice("press", "page-press", context.presses.map((one) => [one, one])) : null);
  place.append(el("section", { class: "card" }, el("div", { class: "head" }, el("h1", {}, text("page-nav-journal")), filters),
    context.press ? noteForm(context, () => load(false)) : "", rows, more));

  function choice(name, label, options) {
    return el("label", { class: "row small" }, text(label), el("select", { onchange: (event) => {
      asked[name] = event.target.value;
      history.replaceState(null, "", `#/journal?${new URLSearchParams(Object.entries(asked).filter(([, value]) => value))}`);
      load(false);
    } }, [["", text("page-all")], ...options].map(([value, words]) => el("option", { value, selected: value === asked[name] }, words))));
  }

  let lines, pressed, cursors, turn = 0;
  async function load(further) {
    const mine = ++turn;
    const before = further ? { lines, pressed, cursors } : { lines: [], pressed: [], cursors: {} };
    const [level, press] = [asked.level, asked.press];
    const nothing = { items: [], next_cursor: null };
    const over = (list) => further && !before.cursors[list]; // read to its end before
    const entries = asked.process === PRESS || over("lines") ? nothing : await get("/events", { level, press, process: asked.process, cursor: before.cursors.lines, limit: PAGE });
    const doings = ["", PRESS].includes(asked.process) && ["", "info"].includes(level) && !over("pressed") ? await get("/events", { kind: "press", press, cursor: before.cursors.pressed, limit: PAGE }) : nothing;
    if (mine !== turn) return;
    lines = [...before.lines, ...entries.items];
    pressed = [...before.pressed, ...doings.items];
    cursors = { lines: entries.next_cursor, pressed: doings.next_cursor };
    more.hidden = !cursors.lines && !cursors.pressed;
    offer();
    draw();
  }

  // Who wrote in the journal need not be one of the processes that run: an import, somebody's notes.
  function offer() {
    for (const { process } of lines) {
      if (offered.has(process)) continue;
      offered.add(process);
      byProcess.querySelector("select").append(el("option", { value: process }, process));
    }
  }

  function draw() {
    // Of what is older than one of the two lists reaches, only half is known.
    const reach = Math.max(...[[lines, cursors.lines], [pressed, cursors.pressed]].map(([items, next]) => (next ? at(items.at(-1)) : 0)));
    const all = [...lines, ...pressed].filter((one) => at(one) >= reach).sort((a, b) => at(b) - at(a));
    const heads = [{ text: text("page-when") }, { text: text("page-process") }, { text: text("page-what"), class: "wide" }, { text: text("page-run"), class: "names" }];
    rows.replaceChildren(all.length ? table(text("page-nav-journal"), heads, together(all).map(row), { cards: true }) : el("p", { class: "faint" }, text("page-journal-empty")));
  }

  await load(false);
  for (const name of ["press", "run", "fit"]) context.on(name, () => { if (Math.max(lines.length, pressed.length) <= PAGE && !rows.contains(document.activeElement)) load(false).catch(() => {}); });
}

const DONE = "journal-press-";
const ofPress = (one) => one.message_said.code.startsWith(DONE);

// Entries of one kind, newest first, that follow each other within minutes; what a press did with one panel.
function together(entries) {
  const open = new Map();
  const groups = [];
  for (const one of entries) {
    const { code } = one.message_said;
    const kind = [one.level, one.process, one.press, ofPress(one) ? DONE : code].join("|");
    const group = open.get(kind);
    const soon = group && at(group.at(-1)) - at(one) < 1000 * TOGETHER_S;
    const samePanel = group && code !== `${DONE}removed` && group.at(-1).message_said.code !== `${DONE}inserted`;
    if (ofPress(one) ? samePanel : soon && code !== "journal-note") group.push(one);
    else {
      groups.push([one]);
      open.set(kind, groups.at(-1));
    }
  }
  return groups;
}

const shown = (one) => inWords(one.message_said, one.message);

// Scans that were left out are added up; of all else that repeats the newest stands for the others.
function row(group) {
  const [newest] = group;
  const code = newest.message_said.code;
  const words = ofPress(newest) ? [...group].reverse().map((one) => `${shown(one)} ${clock(one.utc, false)}`).join(" · ") : code === "scans-left-out"
    ? inWords({ code, arguments: { ...newest.message_said.arguments, count: group.reduce((sum, one) => sum + one.message_said.arguments.count, 0) } }) : shown(newest);
  const span = (at(newest) - at(group.at(-1))) / 1000;
  const runs = [...new Set(group.map(({ run }) => run).filter(Boolean))];
  return [when(newest.utc), `${newest.process}${newest.press ? ` · ${newest.press}` : ""}`,
    el("div", {}, newest.level === "info" ? "" : [el("span", { class: `pill ${newest.level === "alarm" ? "bad" : "warn"}` }, text(`page-level-${newest.level}`)), " "], byHand(words),
      group.length > 1 && !ofPress(newest) ? el("details", { class: "small" }, el("summary", {}, text("page-repeated", { count: group.length, time: duration(span) })),
        el("ul", {}, group.map((one) => el("li", {}, when(one.utc), " ", byHand(shown(one)))))) : ""),
    runs.length ? el("div", {}, runs.slice(0, 3).map((run) => el("div", { class: "num" }, el("a", { href: `#/runs/${encodeURIComponent(run)}` }, run))), runs.length > 3 ? "…" : "") : "–"];
}

function noteForm({ press }, done) {
  const message = el("p", { role: "status", class: "small" });
  const input = el("input", { type: "text", id: "note", dir: "auto", maxlength: 2000, required: true, autocomplete: "off" });
  const form = el("form", { class: "row note" }, el("label", { for: "note", class: "small" }, text("page-note", { press })), input, el("button", { class: "button" }, text("page-note-keep")));
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    try {
      await post("/events", { press, text: input.value.trim() });
      input.value = "";
      message.textContent = "";
      announce(text("page-note-kept"));
      await done();
    } catch (error) { refuse(message, error); }
  });
  return el("div", {}, form, message);
}

// A run's notes as marks on its time axis.
export const notesOf = (run) => run.changes.map(({ field, after }) => [/^note ([\d.]+) s$/.exec(field), after]).filter(([at]) => at)
  .map(([at, after]) => ({ x: Number(at[1]), name: after.length > 40 ? `${after.slice(0, 39)}…` : after, colour: "--faint" }));
