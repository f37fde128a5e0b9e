// Runs: filter and compare; one run measured against simulated, its residual, the profile through the panel, its fit.
import { download, get, url } from "../api.js";
import { TimeChart, calmRange, key } from "../charts.js";
import { began, duration, el, number, table, when, warningsOf } from "../dom.js";
import { inWords, language, placeName, text } from "../words.js";
import { COLOURS, groupName, roleOf } from "../channels.js";
import { coefficientTable } from "./coefficients.js";
import { cureOf, steamOf } from "./answer.js";
import { showBlisters } from "./blisters.js";
import { compare } from "./compare.js";
import { showDay } from "./day.js";
import { notesOf } from "./journal.js";
import { metadataCard } from "./metadata.js";
import { profilePicture } from "./profile.js";
import { asked, showScatter } from "./scatter.js";
import { whatIfCard } from "./whatif.js";

export async function show(place, context, [id, ...rest]) {
  if (id === "compare") return compare(place, rest);
  if (id === "day") return showDay(place, context, rest[0]);
  if (id === "blisters") return showBlisters(place, context);
  if (id === "scatter") return showScatter(place, context, FILTERS);
  if (id) return detail(place, context, id);
  return list(place, context);
}

const FILTERS = ["q", "where", "verdict", "status", "from", "to", "sort"];

async function list(place, context) {
  const chosen = new Set();
  const filter = Object.fromEntries(FILTERS.map((name) => [name, context.query.get(name) ?? ""]));
  let items = [];
  let cursor = null;
  let lacking = [];
  const body = el("div", {});
  const more = el("button", { type: "button", class: "button", onclick: () => load(true) }, text("page-more"));
  const compareLink = el("a", { class: "button", href: "#/runs", "aria-disabled": "true" }, text("page-compare"));
  const scatterLink = el("a", { class: "button", href: `#/runs/scatter?${context.query}` }, text("page-scatter"));
  const field = (name, label, control) => {
    control.value = filter[name];
    control.addEventListener("input", () => { filter[name] = control.value; keep(); load(false); });
    return el("label", { class: "row small" }, el("span", { class: "faint" }, label), control);
  };
  const options = (values, code) => el("select", {}, el("option", { value: "" }, text("page-all")), values.map((value) => el("option", { value }, text(`${code}${value}`))));
  place.append(el("section", { class: "card" },
    el("div", { class: "head" }, el("h1", {}, text("page-nav-runs")), el("div", { class: "row" }, el("a", { class: "button", href: "#/runs/day" }, text("page-day-view")), scatterLink, compareLink)),
    el("div", { class: "row", style: "margin-bottom:.8rem" },
      field("q", text("page-search"), el("input", { type: "search", size: 18 })),
      field("where", text("page-search-bounds"), el("input", { type: "search", size: 40, placeholder: "panel.thickness_mm=16 rmse_K<1" })),
      field("verdict", text("page-number-panel-verdict"), options(["good", "blister", "undercured", "scrap"], "page-panel-")),
      field("status", text("page-status"), options(["open", "closed", "interrupted"], "page-run-")),
      field("from", text("page-from"), el("input", { type: "date" })),
      field("to", text("page-to"), el("input", { type: "date" }))),
    body, el("div", { class: "row", style: "justify-content:center;margin-top:.8rem" }, more)));

  // What is looked for stands in the address: it can be kept as a bookmark and sent to somebody.
  function keep() {
    const query = new URLSearchParams(FILTERS.filter((name) => filter[name]).map((name) => [name, filter[name]])).toString();
    history.replaceState(null, "", query ? `#/runs?${query}` : "#/runs");
    scatterLink.href = query ? `#/runs/scatter?${query}` : "#/runs/scatter";
  }

  let turn = 0;
  async function load(next) {
    const mine = ++turn;
    try {
      const page = await get("/search", {
        ...asked(filter, context), sort: filter.sort, limit: 50, cursor: next ? cursor : "",
      });
      if (mine !== turn) return;
      items = next ? items.concat(page.items) : page.items;
      cursor = page.next_cursor;
      lacking = page.lacking;
    } catch (error) {
      if (error.status !== 422) throw error;
      if (mine === turn) body.replaceChildren(el("p", { class: "small bad-text", role: "alert" }, error.message)); // a bound half typed
      return;
    }
    more.hidden = !cursor;
    draw();
  }

  // A column's head sorts by its number: the largest first, the smallest first, the newest first again.
  function sorting(name, label) {
    const [largest, smallest] = [`-${name}`, name];
    const next = filter.sort === largest ? smallest : filter.sort === smallest ? "" : largest;
    const arrow = filter.sort === largest ? " ↓" : filter.sort === smallest ? " ↑" : "";
    return el("button", { type: "button", class: "quiet sort", onclick: () => { filter.sort = next; keep(); load(false); } }, label + arrow);
  }

  function draw() {
    if (!items.length) { body.replaceChildren(el("div", { class: "empty" }, text("page-no-runs"), lacking.length ? ` ${text("page-no-runs-lacking", { names: lacking.join(", ") })}` : "")); return; }
    const cell = (value, digits, unit) => el("span", { class: "num" }, value === null || value === undefined ? "–" : `${number(value, digits)} ${unit}`);
    const columns = [["press_time_s", "page-pressed", 1, "s"], ["core_at_opening_C", "page-core-at-opening", 1, "°C"], ["core_peak_C", "page-core-peak", 1, "°C"], ["band_at_opening_K", "page-band-at-opening", 1, "K"], ["rmse_K", "page-rmse", 2, "K"]];
    body.replaceChildren(table(text("page-nav-runs"), [
      { text: text("page-run") }, { text: text("page-started") }, { text: text("page-material"), class: "hide-narrow" },
      { text: sorting("panel.thickness_mm", text("page-thickness")), class: "right hide-narrow" },
      ...columns.map(([name, code]) => ({ text: sorting(name, text(code)), class: ["core_peak_C", "band_at_opening_K"].includes(name) ? "right hide-narrow" : "right" })),
      { text: text("page-number-panel-verdict") }, { text: text("page-status") },
    ], items.map((run) => [
      el("div", { class: "chosen" },
        el("input", { type: "checkbox", checked: chosen.has(run.run), "aria-label": `${text("page-compare")} ${run.run}`, onchange: (event) => pick(run.run, event.target.checked) }),
        el("a", { href: `#/runs/${encodeURIComponent(run.run)}` }, run.run)),
      run.started_utc ? when(run.started_utc) : began(null), run.material || "–", cell(run.thickness_mm, 1, "mm"),
      ...columns.map(([name, , digits, unit]) => (name === "rmse_K" && run.described === false
        ? el("div", {}, cell(run.numbers[name], digits, unit), el("p", {}, el("span", { class: "pill bad wraps" }, text("page-not-described")))) : cell(run.numbers[name], digits, unit))),
      run.verdict ? el("span", { class: `pill ${run.verdict === "good" ? "good" : "bad"}` }, text(`page-panel-${run.verdict}`)) : "–",
      run.damage ? el("span", { class: "pill bad", title: inWords(run.damage_said, run.damage) }, text("page-run-damaged")) : statusPill(run.status),
    ]), { cards: true, sort: text("page-sort-by"), pick: (i) => { location.hash = `#/runs/${encodeURIComponent(items[i].run)}`; } }));
  }

  function pick(run, on) {
    if (on) chosen.add(run); else chosen.delete(run);
    const usable = chosen.size > 1;
    compareLink.setAttribute("aria-disabled", String(!usable));
    compareLink.className = usable ? "button primary" : "button";
    compareLink.href = usable ? `#/runs/compare/${[...chosen].map(encodeURIComponent).join("/")}` : "#/runs";
    compareLink.textContent = chosen.size ? `${text("page-compare")} (${chosen.size})` : text("page-compare");
  }

  await load(false);
  for (const name of ["run", "fit"]) context.on(name, () => { if (!cursor || items.length <= 50) load(false).catch(() => {}); });
  return null;
}

// A record that is complete is no good pressing: green is for what was judged.
function statusPill(status) {
  const tone = { open: "open", closed: "idle", interrupted: "warn" }[status] ?? "";
  return el("span", { class: `pill ${tone}` }, text(`page-run-${status}`));
}

async function detail(place, context, id) {
  const path = `/runs/${encodeURIComponent(id)}`;
  const run = await get(path);
  const [samples, estimates, fit] = await Promise.all([
    get(`${path}/samples`, { max_points: 3000 }), get(`${path}/estimates`, { max_points: 3000 }), get(`${path}/fit`).catch(() => null),
  ]);
  const waiting = el("section", { class: "card empty" }, text("page-simulating"));
  place.append(headCard(run, path, estimates), measuredCard(run, samples, estimates, fit), waiting, run.status === "open" ? "" : whatIfCard(path), el("div", { class: "pair" }, fitCard(fit, run), metadataCard(run, path)));
  get(`${path}/simulation`).then((simulation) => {
    if (waiting.isConnected) waiting.replaceWith(simulationCard(run, simulation), profileCard(run, simulation));
  }).catch((error) => waiting.replaceChildren(text("page-no-simulation"), el("p", { class: "small" }, error.message)));
  context.on("fit", (data) => { if (data.run === id && !fit) dispatchEvent(new HashChangeEvent("hashchange")); });
  return null;
}

// What was sure of cure and steam last before the press opened; nothing without a resin file.
function atOpening({ opened_s: opened }, estimates) {
  const row = estimates.time_s.findLastIndex((time, i) => time <= opened && estimates.state[i] === "closed" && estimates.valid[i]);
  if (opened === null || row < 0) return null;
  const [low, high] = [estimates.cure_low[row], estimates.steam_high_kPa[row]];
  const parts = [low !== null && `${text("page-cure")} ${cureOf(low, estimates.grade[row])}`, high !== null && `${text("page-steam")} ${steamOf(high)}`].filter(Boolean);
  return parts.length ? el("p", { "data-testid": "at-opening" }, `${text("page-at-opening")}: ${parts.join(" · ")}`) : null;
}

function headCard(run, path, estimates) {
  const link = (label, href, file) => el("a", { class: "button", href, download: file, onclick: download }, label);
  return el("section", { class: "card" },
    el("div", { class: "head" },
      el("div", { class: "row" }, el("h1", {}, `${text("page-run")} ${run.run}`), statusPill(run.status)),
      el("div", { class: "row small" }, link("CSV", url(`${path}/samples`, { format: "csv" }), `${run.run}.csv`), link("Parquet", url(`${path}/samples`, { format: "parquet" }), `${run.run}.parquet`),
        link("SVG", url(`${path}/figure.svg`, { language: language() }), `${run.run}.svg`), el("a", { class: "button", href: "#/runs" }, text("page-back")))),
    el("p", { class: "faint" }, [run.material, run.thickness_mm && `${number(run.thickness_mm, 1)} mm`, run.platen_temperature_C && `${number(run.platen_temperature_C, 0)} °C`,
      run.closed_s !== null && run.opened_s !== null && `${text("page-pressed")} ${duration(run.opened_s - run.closed_s)}`, began(run.started_utc), `${run.scans} ${text("page-scans")}`]
      .filter(Boolean).join(" · ")),
    atOpening(run, estimates),
    run.remark ? el("p", { class: "next", dir: "auto", style: "white-space:pre-line" }, run.remark) : null);
}

// Sensors the fit leaves out because they do not follow their face.
const STRAY = ["channel-loose", "channel-drifting", "channel-swapped"];

function measuredCard(run, samples, estimates, fit) {
  const stray = new Set((fit?.warnings_said ?? []).filter(({ code }) => STRAY.includes(code)).map((one) => one.arguments.column));
  const names = Object.keys(samples.columns).filter((name) => name !== "closed");
  const series = [...names.map((name) => (stray.has(name) ? { name, colour: "--bad", kind: "stray", dash: [3, 4], note: text("page-sensor-stray") }
    : { name, colour: COLOURS[roleOf(name)], kind: roleOf(name) === "core" ? "line" : "thin", group: groupName(roleOf(name)) })),
    { name: "low", kind: "band-low" }, { name: "high", kind: "band-high" }, { name: text("page-core-predicted"), colour: "--core", kind: "core", spanGaps: true }];
  const { times, lift } = grid(samples.time_s, estimates.time_s);
  const ok = (values) => values.map((value, i) => (estimates.valid[i] ? value : null));
  const data = [times, ...names.map((name) => lift(samples.time_s, samples.columns[name])), lift(estimates.time_s, ok(estimates.core_low_C)),
    lift(estimates.time_s, ok(estimates.core_high_C)), lift(estimates.time_s, ok(estimates.core_C))];
  const holder = el("div", {});
  const card = el("section", { class: "card" }, el("h2", {}, text("page-measured-and-core")), holder, key([
    { name: text("page-core-predicted"), colour: "--core" }, { name: text("page-band95"), class: "band" }, { name: text("page-sensors-top"), colour: "--top" },
    { name: text("page-sensors-bottom"), colour: "--bottom" }, { name: text("page-platens"), colour: "--platen" },
    ...names.filter((name) => stray.has(name)).map((name) => ({ name: `${name}: ${text("page-sensor-stray")}`, colour: "--bad", class: "dots" }))]), leftOut(samples.quality));
  const why = (name, time) => samples.quality.find((span) => (span.column === name || span.column === "*") && span.from_s <= time && time <= span.to_s);
  later(holder, () => Object.assign(new TimeChart(holder, { series, height: 360, label: text("page-measured-and-core"), phases: run.phases, sync: "run",
    why: (name, time) => { const span = names.includes(name) && why(name, time); return span ? text(`page-quality-${span.quality}`) : null; } }), { marks: notesOf(run) }).set(data));
  return card;
}

const MOST_LEFT_OUT = 12;

// What was not simply measured, and why: one line for each cause and all channels that missed the same.
function leftOut(spans) {
  const causes = new Map();
  for (const span of spans) {
    const id = `${span.column} ${span.quality}`;
    const known = causes.get(id) ?? { ...span, rows: 0 };
    causes.set(id, { ...known, rows: known.rows + span.rows, from_s: Math.min(known.from_s, span.from_s), to_s: Math.max(known.to_s, span.to_s) });
  }
  const groups = new Map();
  for (const { column, quality, rows, from_s: from, to_s: to } of [...causes.values()].sort((a, b) => b.rows - a.rows)) {
    const what = `${text(`page-quality-${quality}`)}, ${number(rows, 0)} ${text("page-scans")}, ${number(from, 1)} – ${number(to, 1)} s`;
    groups.set(what, [...(groups.get(what) ?? []), column === "*" ? text("page-all-channels") : column]);
  }
  const lines = [...groups].map(([what, columns]) => `${columns.join(", ")}: ${what}`);
  if (!lines.length) return null;
  return el("div", { class: "small", "data-testid": "left-out" }, el("h3", {}, text("page-left-out")), el("ul", {},
    lines.slice(0, MOST_LEFT_OUT).map((line) => el("li", {}, line)),
    lines.length > MOST_LEFT_OUT ? el("li", {}, text("page-and-more", { count: lines.length - MOST_LEFT_OUT })) : null));
}

function simulationCard(run, simulation) {
  const places = Object.keys(simulation.positions);
  const colour = (name, i) => (name.endsWith("top") ? "--top" : name.endsWith("bottom") ? "--bottom" : ["--good", "--accent"][i % 2]);
  const residual = places.map((name) => simulation.positions[name].map((value, i) =>
    (simulation.measured[name]?.[i] == null || value === null ? null : simulation.measured[name][i] - value)));
  const above = el("div", {});
  const below = el("div", {});
  const shown = places.filter((name) => simulation.measured[name]?.some((value) => value !== null));
  const card = el("section", { class: "card", "data-testid": "simulation" },
    el("h2", {}, text("page-measured-simulated")), above, el("h3", {}, text("page-residual")), below, key([
      ...shown.map((name, i) => ({ name: `${placeName(name)} · RMSE ${number(simulation.rmse_K[name], 2)} K`, colour: colour(name, i) })),
      { name: text("page-dots-measured"), colour: "--measured", class: "dots" }, { name: text("page-core-simulated"), colour: "--core" }]),
    el("p", { class: "small faint" }, text("page-rmse-hint")));
  const index = shown.map((name) => places.indexOf(name));
  later(above, () => {
    new TimeChart(above, {
      series: [...shown.map((name, i) => ({ name: `${placeName(name)} ${text("page-simulated")}`, colour: colour(name, i), kind: "line" })),
        ...shown.map((name, i) => ({ name: `${placeName(name)} ${text("page-measured")}`, colour: colour(name, i), kind: "dots" })),
        { name: text("page-core-simulated"), colour: "--core", kind: "core" }],
      height: 320, label: text("page-measured-simulated"), phases: run.phases, sync: "run",
    }).set([simulation.time_s, ...index.map((i) => simulation.positions[places[i]]), ...index.map((i) => simulation.measured[places[i]]), simulation.core_C]);
    new TimeChart(below, {
      series: shown.map((name, i) => ({ name: placeName(name), colour: colour(name, i), kind: "line", unit: "K", digits: 2 })), height: 170, label: text("page-residual"), yLabel: "K", phases: run.phases, sync: "run", yRange: calmRange(index.map((i) => residual[i])),
    }).set([simulation.time_s, ...index.map((i) => residual[i])]);
  });
  return card;
}

function profileCard(run, simulation) {
  return el("section", { class: "card" }, el("h2", {}, text("page-profile")), profilePicture(simulation, run.phases));
}

function fitCard(fit, { described }) {
  if (!fit) return el("section", { class: "card" }, el("h2", {}, text("page-fit")), el("p", { class: "faint" }, text("page-no-fit")));
  const whole = [fit.initial_rmse_K, fit.rmse_K], still = [fit.initial_rmse_still_K, fit.rmse_still_K];
  const known = still.every(Number.isFinite); // one row amid the closing, some ms off, may be most of the whole run's
  const [before, after] = (known ? still : whole).map((value) => Number((value ?? NaN).toFixed(2))); // as shown below
  const state = described === false ? ["bad", "page-not-described"] : !fit.converged ? ["warn", "page-not-converged"] : after > before ? ["warn", "page-further-off"] : ["good", "page-converged"];
  // Of a run the model does not describe nothing is known: what a search ended at has no interval.
  const coefficients = described !== false ? fit.coefficients : Object.fromEntries(Object.entries(fit.coefficients).map(([name, c]) => [name, { ...c, ci95: null }]));
  return el("section", { class: "card", "data-testid": "fit" }, el("div", { class: "head" }, el("h2", {}, text("page-fit")),
    el("span", { class: `pill ${state[0]}` }, text(state[1]))),
  coefficientTable(coefficients),
  fitLeft("page-fit-left", whole), known ? fitLeft("page-fit-left-still", still) : null,
  warningsOf(fit));
}

function fitLeft(code, [before, after]) {
  return el("p", { class: "small faint" }, text(code, { before: number(before, 2), after: number(after, 2) }));
}

// Two time axes on one chart: their union, each series lifted onto it.
function grid(...axes) {
  const times = [...new Set(axes.flat().map((t) => Math.round(t * 1000) / 1000))].sort((a, b) => a - b);
  const at = new Map(times.map((t, i) => [t, i]));
  const lift = (axis, values) => {
    const out = new Array(times.length).fill(null);
    axis.forEach((t, i) => { out[at.get(Math.round(t * 1000) / 1000)] = values[i]; });
    return out;
  };
  return { times, lift };
}

// Runs once the element stands in the page and has a width.
function later(node, work) {
  requestAnimationFrame(() => { if (node.isConnected) work(); else setTimeout(() => { if (node.isConnected) work(); }, 50); });
}
