// Runs side by side: any quantity from closing on, as it is or against one of them; what differs; any number over any other.
import { get } from "../api.js";
import { TimeChart, straight } from "../charts.js";
import { el, figure, table } from "../dom.js";
import { numberName, text } from "../words.js";
import { inPlainWords } from "./metadata.js";
import { scatter } from "./scatter.js";

const QUANTITIES = {
  core: { name: ["page-core-predicted"] }, top: { name: ["page-sensors-top"] }, bottom: { name: ["page-sensors-bottom"] }, platen: { name: ["page-platens"] },
  heat: { name: ["page-energy"], simulated: true, unit: "kJ/m²" },
  residual_top: { name: ["page-residual", "page-sensors-top"], simulated: true, unit: "K", place: "panel.top" }, residual_bottom: { name: ["page-residual", "page-sensors-bottom"], simulated: true, unit: "K", place: "panel.bottom" },
};
const nameOf = (quantity) => QUANTITIES[quantity].name.map((code) => text(code)).join(", ");
const STEP_S = 0.5; // all runs are read off at the same times: a difference has both

export async function compare(place, ids) {
  const runs = await Promise.all(ids.map(load));
  const shown = { quantity: "core", reference: "", off: new Set() };
  const holder = el("div", {});
  const legend = el("div", { class: "row legend" });
  const without = el("p", { class: "small faint", role: "status" });
  const select = (label, options, done) => el("label", { class: "row small" }, el("span", { class: "faint" }, label), el("select", { onchange: (event) => { done(event.target.value); draw(); } }, options));
  place.append(el("section", { class: "card" }, el("div", { class: "head" }, el("h1", {}, text("page-compare")),
    el("div", { class: "row" },
      select(text("page-quantity"), Object.keys(QUANTITIES).map((value) => el("option", { value }, nameOf(value))), (value) => { shown.quantity = value; }),
      select(text("page-reference"), [el("option", { value: "" }, "–"), ...ids.map((id) => el("option", { value: id }, id))], (value) => { shown.reference = value; }),
      el("a", { class: "button", href: "#/runs" }, text("page-back")))), holder, without, legend), differences(runs), scatter(runs));
  let chart = null;
  let turn = 0;
  async function draw() {
    const mine = ++turn;
    const { simulated, unit: own = "°C" } = QUANTITIES[shown.quantity];
    without.textContent = simulated ? text("page-simulating") : "";
    if (simulated) await Promise.all(runs.map(simulate));
    if (mine !== turn || !holder.isConnected) return;
    const none = runs.filter((run) => !run[shown.quantity].times.length).map(({ id }) => id);
    const loose = runs.filter((run) => run.closed === null).map(({ id }) => id);
    without.textContent = [none.length && text("page-compare-without", { runs: none.join(", ") }), loose.length && text("page-compare-loose", { runs: loose.join(", ") })].filter(Boolean).join(" · ");
    const visible = runs.filter(({ id }) => !shown.off.has(id));
    const reference = runs.find(({ id }) => id === shown.reference);
    const from = Math.floor(Math.min(...runs.map((run) => run.from)) / STEP_S);
    const to = Math.ceil(Math.max(...runs.map((run) => run.to)) / STEP_S);
    const times = Array.from({ length: Math.max(to - from + 1, 1) }, (_, i) => (from + i) * STEP_S);
    const base = reference && reading(reference, shown.quantity, times);
    const curves = visible.map((run) => reading(run, shown.quantity, times).map((v, i) => (!base || v === null ? v : base[i] === null ? null : v - base[i])));
    chart?.close();
    holder.replaceChildren();
    const unit = base && own === "°C" ? "K" : own;
    chart = new TimeChart(holder, {
      series: visible.map((run) => ({ name: run.id, colour: colourOf(runs.indexOf(run), runs.length), kind: "line", unit, digits: unit === "K" ? 2 : 1 })),
      height: 420, label: `${text("page-compare")}: ${nameOf(shown.quantity)}`, xLabel: text("page-time-from-closing"), yLabel: unit,
    });
    chart.set([times, ...curves]);
    legend.replaceChildren(...runs.map(({ id }, i) => el("label", { class: "row small" },
      el("input", { type: "checkbox", checked: !shown.off.has(id), onchange: (event) => { if (event.target.checked) shown.off.delete(id); else shown.off.add(id); draw(); } }),
      el("span", { style: `color:${colourOf(i, runs.length)}`, "aria-hidden": "true" }, "■"), el("a", { href: `#/runs/${encodeURIComponent(id)}` }, id))));
  }
  draw();
  return null;
}

// Hues evenly round the circle but for red, which says that something is wrong.
const colourOf = (i, count) => `hsl(${Math.round(35 + (310 * i) / Math.max(count, 1))} 65% 45%)`;

async function load(id) {
  const path = `/runs/${encodeURIComponent(id)}`;
  const [detail, fit, samples, core, found] = await Promise.all([get(path), get(`${path}/fit`).catch(() => null), get(`${path}/samples`, { max_points: 3000 }), coreOf(path), get("/search", { q: id, limit: 500 })]);
  const closed = detail.closed_s ?? fit?.closed_s ?? null; // of an imported run the fit finds it
  const zero = closed ?? 0;
  const face = (start) => Object.entries(samples.columns).filter(([name]) => name.startsWith(start)).map(([, values]) => values);
  const middle = (columns) => samples.time_s.map((_, i) => {
    const good = columns.map((values) => values[i]).filter((v) => v !== null).sort((a, b) => a - b);
    return good.length ? good[Math.floor(good.length / 2)] : null;
  });
  const curve = (times, values) => ({ times: times.map((t) => t - zero), values });
  return {
    id, detail, numbers: found.items.find((item) => item.run === id)?.numbers ?? {},
    from: (samples.time_s[0] ?? 0) - zero, to: (samples.time_s.at(-1) ?? 0) - zero,
    core: curve(core.time_s, core.core_C.map((v, i) => (core.valid[i] ? v : null))),
    zero, closed, platen: curve(samples.time_s, middle(face("platen"))), top: curve(samples.time_s, middle(face("top"))), bottom: curve(samples.time_s, middle(face("bottom"))),
  };
}

// What the run's own coefficients give, asked for when it is looked at; of a run without any, nothing.
async function simulate(run) {
  if (run.heat) return;
  const { time_s, positions, measured, profile_time_s: at, profile_heat_kJ_m2: heat } = await get(`/runs/${encodeURIComponent(run.id)}/simulation`).catch(() => ({ time_s: [], positions: {}, measured: {}, profile_time_s: [], profile_heat_kJ_m2: [] }));
  run.heat = { times: at.map((t) => t - run.zero), values: heat };
  for (const [quantity, { place }] of Object.entries(QUANTITIES).filter(([, one]) => one.place)) {
    const there = positions[place] && measured[place] ? time_s : [];
    run[quantity] = { times: there.map((t) => t - run.zero), values: there.map((_, i) => (positions[place][i] === null || measured[place][i] === null ? null : measured[place][i] - positions[place][i])) };
  }
}

// The core as estimated live; of a run nobody followed live, as simulated with its fit.
async function coreOf(path) {
  const live = await get(`${path}/estimates`, { max_points: 3000 });
  if (live.rows) return live;
  const { time_s, core_C } = await get(`${path}/simulation`).catch(() => ({ time_s: [], core_C: [] }));
  return { time_s, core_C, valid: core_C.map((value) => value !== null) };
}

// A curve at given times; a gap of more than 5 s is one.
const reading = (run, quantity, at) => straight(run[quantity].times, run[quantity].values, at, 5);

// Settings and results, a row each; what is not the same in all runs that have it stands out.
function differences(runs) {
  const keys = [...new Set(runs.flatMap(({ detail, numbers }) => [...Object.keys(detail.header).filter((key) => key !== "run"), ...Object.keys(numbers)]))].sort();
  const value = ({ detail, numbers }, key) => detail.header[key] ?? numbers[key] ?? null;
  const shown = (key, one) => (typeof one === "number" ? figure(one) : inPlainWords(key, one));
  const rows = keys.map((key) => {
    const values = runs.map((run) => value(run, key));
    const cells = values.map((one) => shown(key, one));
    return { key, cells, differs: new Set(cells.filter((_, i) => values[i] !== null)).size > 1 };
  }).sort((a, b) => Number(b.differs) - Number(a.differs));
  return el("section", { class: "card", "data-testid": "differences" }, el("h2", {}, text("page-differences")), table(text("page-differences"),
    [{ text: text("page-name") }, ...runs.map(({ id }) => ({ text: id, class: "right" }))],
    rows.map(({ key, cells, differs }) => [el(differs ? "b" : "span", { title: key }, `${differs ? "≠ " : ""}${numberName(key)}`), ...cells.map((cell) => el("span", { class: differs ? "num" : "num faint" }, cell))])));
}
