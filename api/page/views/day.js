// A day of a press, in pressings and between them: the lowest and highest reading of each step of time.
import { get } from "../api.js";
import { COLOURS, GROUPS, groupName, roleOf } from "../channels.js";
import { TimeChart, key } from "../charts.js";
import { el, midnight, number, table } from "../dom.js";
import { inWords, locale, text } from "../words.js";

const STEPS = 600; // two pixels each on a wide screen
const BRIDGE_S = 600; // of old days every hundredth idle scan is kept: a line goes on through such silences
const PLACES = Object.keys(GROUPS);

const written = (date) => `${date.getFullYear()}-${String(date.getMonth() + 1).padStart(2, "0")}-${String(date.getDate()).padStart(2, "0")}`;
const beside = (day, days) => written(new Date(midnight(day, days)));

export async function showDay(place, context, asked) {
  const day = /^\d{4}-\d{2}-\d{2}$/.test(asked ?? "") && midnight(asked, 0) ? asked : written(new Date());
  const [from, to] = [midnight(day, 0), midnight(day, 1)];
  const go = (chosen) => { if (chosen) location.hash = `#/runs/day/${chosen}`; };
  const says = (seconds, timeStyle = "short") => new Intl.DateTimeFormat(locale(), { timeStyle }).format(Date.parse(from) + 1000 * seconds);
  const holder = el("div", {}, el("p", { class: "empty" }, text("page-loading")));
  const missing = el("div", {});
  const list = el("div", {});
  place.append(el("section", { class: "card", "data-testid": "day" },
    el("div", { class: "head" }, el("h1", {}, text("page-day-of", { press: context.press ?? "–" })), el("div", { class: "row" },
      el("a", { class: "button", href: `#/runs/day/${beside(day, -1)}`, "aria-label": text("page-day-before") }, "←"),
      el("input", { type: "date", value: day, "aria-label": text("page-day"), onchange: (event) => go(event.target.value) }),
      el("a", { class: "button", href: `#/runs/day/${beside(day, 1)}`, "aria-label": text("page-day-after") }, "→"),
      el("a", { class: "button", href: "#/runs" }, text("page-back")))),
    holder, missing), el("section", { class: "card", "data-testid": "day-runs" }, el("h2", {}, text("page-nav-runs")), list));
  if (!context.press) { holder.replaceChildren(el("p", { class: "empty" }, text("page-no-press"))); return null; }

  const read = (begin, end) => get("/scans", { press: context.press, from: begin, to: end, points: STEPS });
  const scans = await readPart(await read(from, to), read);
  const runs = (await get("/search", { press: context.press, from: new Date(Date.parse(from) - 3600e3).toISOString(), to, limit: 500 })).items
    .filter((run) => run.started_utc && Date.parse(run.ended_utc ?? run.started_utc) >= Date.parse(from)).sort((a, b) => Date.parse(a.started_utc) - Date.parse(b.started_utc));
  holder.replaceChildren();
  const whole = curves(scans, from);
  const chart = draw(holder, { whole, phases: phasesOf(runs, from, speedOf(context.press, await get("/health"))), says, label: text("page-day-of", { press: context.press }) });
  let turn = 0;
  // A part looked at is read anew, in steps as much finer.
  chart.onRange = async (min, max) => {
    const mine = ++turn;
    if (!chart.held) { if (chart.data !== whole) chart.set(whole); return; }
    await new Promise((resolve) => setTimeout(resolve, 300));
    const edge = (at) => new Date(Math.min(Math.max(Date.parse(from) + 1000 * at, Date.parse(from)), Date.parse(to))).toISOString();
    const [begin, end] = [edge(min), edge(max)];
    if (mine !== turn || begin >= end) return;
    const part = await read(begin, end).catch(() => null); // the whole day stays
    if (part && mine === turn && chart.held && chart.plot) chart.set(curves(part, from));
  };
  missing.replaceChildren(...scans.unread.map(({ run, why, why_said }) => el("p", { class: "small warn-text" }, `${run}: ${inWords(why_said, why)}`)));
  list.replaceChildren(pressings(runs, from, says));
  return null;
}

// Of a day with readings in a part of it, that part, in steps as much finer.
async function readPart(day, read) {
  const [first, last] = [day.scans.findIndex((count) => count > 0), day.scans.findLastIndex((count) => count > 0)];
  if (first < 0 || last - first > 0.9 * day.scans.length) return day;
  const edge = (step) => new Date(Date.parse(day.from_utc) + 1000 * day.step_s * step).toISOString();
  const part = await read(edge(first), edge(last + 1));
  return { ...part, unread: day.unread };
}

// [seconds from midnight, then of each group the highest and the lowest of all its channels]
function curves(scans, from) {
  const zero = (Date.parse(scans.from_utc) - Date.parse(from)) / 1000;
  const extreme = (role, side, better) => scans.scans.map((_, i) => {
    const known = Object.entries(scans.columns).filter(([name]) => roleOf(name) === role).map(([, column]) => column[side][i]).filter((value) => value !== null);
    return known.length ? better(...known) : null;
  });
  return [scans.scans.map((_, i) => zero + (i + 0.5) * scans.step_s), ...PLACES.flatMap((role) => [extreme(role, "high", Math.max), extreme(role, "low", Math.min)])];
}

// How much faster than the clock a press runs: only a demonstration's does.
const speedOf = (press, { processes }) => processes.flatMap(({ details }) => details.presses ?? []).find((one) => one.press === press && one.speed)?.speed ?? 1;

// When a panel lay in the press, and when that was closed. [s from the day's beginning]
export function phasesOf(runs, from, speed) {
  const at = (utc) => (Date.parse(utc) - Date.parse(from)) / 1000;
  return runs.flatMap((run) => {
    const begin = at(run.started_utc);
    const after = (moment) => begin + moment / speed; // moments are in the press's own time
    const end = run.ended_utc ? at(run.ended_utc) : after(run.opened_s ?? run.closed_s ?? 0);
    const closed = run.closed_s === null || after(run.opened_s ?? run.closed_s) > end ? [] : [{ state: "closed", from_s: after(run.closed_s), to_s: run.opened_s === null ? end : after(run.opened_s) }];
    return [{ state: "open", from_s: begin, to_s: end, run: run.run }, ...closed];
  });
}

function draw(holder, { whole, phases, says, label }) {
  const chart = new TimeChart(holder, {
    series: PLACES.flatMap((role) => [["page-highest"], ["page-lowest", [4, 3]]].map(([end, dash]) => ({ name: `${groupName(role)}: ${text(end)}`, colour: COLOURS[role], kind: "line", dash }))),
    height: 420, label, xLabel: text("page-started"), xSays: says, xSteps: [1, 5, 15, 60, 300, 900, 1800, 3600, 7200, 10800, 14400, 21600, 43200],
    phases, bridge: BRIDGE_S, release: text("page-day-whole"),
  });
  chart.tipHead = (x) => [says(x, "medium"), phases.find((phase) => phase.run && phase.from_s <= x && x <= phase.to_s)?.run].filter(Boolean).join(" · ");
  chart.set(whole);
  holder.append(key(PLACES.map((role) => ({ name: groupName(role), colour: COLOURS[role] }))), el("p", { class: "small faint" }, text("page-day-hint")));
  return chart;
}

function pressings(runs, from, says) {
  if (!runs.length) return el("p", { class: "faint" }, text("page-no-runs"));
  const cell = (value, digits, unit) => el("span", { class: "num" }, (value ?? null) === null ? "–" : `${number(value, digits)} ${unit}`);
  return table(text("page-nav-runs"), [{ text: text("page-started") }, { text: text("page-run") }, { text: text("page-material") }, { text: text("page-pressed"), class: "right" }, { text: text("page-core-at-opening"), class: "right" }],
    runs.map((run) => [el("span", { class: "num" }, says((Date.parse(run.started_utc) - Date.parse(from)) / 1000, "medium")), el("a", { href: `#/runs/${encodeURIComponent(run.run)}` }, run.run),
      run.material || "–", cell(run.numbers.press_time_s, 1, "s"), cell(run.numbers.core_at_opening_C, 1, "°C")]));
}
