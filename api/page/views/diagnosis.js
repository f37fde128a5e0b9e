// What the simulation gets wrong: the last diagnosis with cause, evidence and gain; model versions to promote or roll back.
import { get, post } from "../api.js";
import { TimeChart, calmRange, key } from "../charts.js";
import { clock, el, number, plain, table, warningsOf } from "../dom.js";
import { capital, effectCalled, effectName as name, has, inWords, placeName, text } from "../words.js";
import { drawLaw, lawCard, planCard } from "./beyond.js";

export async function show(place, context) {
  const press = context.presses.length > 1 ? context.press : "";
  const [diagnoses, models] = await Promise.all([get("/diagnoses", { press, limit: 20 }), get("/models", { press })]);
  place.append(el("div", { class: "row" }, el("h1", {}, text("page-nav-diagnosis"))));
  if (!diagnoses.items.length) {
    place.append(el("div", { class: "card empty" }, el("p", {}, text("page-no-diagnosis")), el("p", { class: "small" }, text("page-no-diagnosis-hint"))));
  } else {
    const holder = el("div", { class: "stack" });
    place.append(holder);
    drawDiagnosis(holder, diagnoses.items[0]);
    if (diagnoses.items.length > 1) place.append(historyCard(diagnoses.items, (item) => drawDiagnosis(holder, item)));
  }
  place.append(modelsCard(models.items));
  return null;
}

function drawDiagnosis(holder, record) {
  const d = record.diagnosis;
  const tone = { no_effect: "good", named: "note", ambiguous: "warn", unknown_effect: "warn", too_few_runs: "idle", not_described: "warn" }[d.verdict] ?? "idle";
  const predicted = Boolean(d.base?.predicted_rmse_K && d.extended?.predicted_rmse_K); // what decides at night, where it is there
  const judged = (side) => (predicted ? side?.predicted_rmse_K : side?.heldout_rmse_K);
  const gain = judged(d.base) && judged(d.extended) ? 1 - judged(d.extended) / judged(d.base) : null;
  const pair = (label, base, extended) => (base === null || base === undefined ? null
    : el("div", {}, el("b", {}, d.effects.length ? `${number(base, 2)} → ${number(extended, 2)} K` : `${number(base, 2)} K`), el("span", {}, `${label}: ${text(d.effects.length ? "page-plain-extended" : "page-plain-model")}`)));
  const cards = [el("section", { class: "card", "data-testid": "diagnosis" },
    el("div", { class: "row" }, el("span", { class: `pill ${tone}` }, text(`diagnosis-verdict-${d.verdict}`)), el("span", { class: "faint small" }, clock(record.utc))),
    el("p", { class: "verdict" }, sentence(d)),
    ...d.effects.map((effect) => effectBlock(effect, record.parameters)),
    d.suspected?.length ? el("p", { class: "small" }, `${text("page-suspected-causes")}: ${d.suspected.map((effect) => name(effect.name)).join(", ")}`) : null,
    el("div", { class: "gain" },
      pair(text("page-heldout"), d.base?.heldout_rmse_K, d.extended?.heldout_rmse_K), pair(text("page-predicted"), d.base?.predicted_rmse_K, d.extended?.predicted_rmse_K), pair(text("page-all-sensors"), d.base?.rmse_K, d.extended?.rmse_K), pair(text("page-core"), d.base?.core_rmse_K, d.extended?.core_rmse_K),
      gain >= 0.005 && d.effects.length ? el("div", {}, el("b", {}, `${number(100 * gain, 0)} %`), el("span", {}, text(predicted ? "page-gain-predicted" : "page-gain-left-out"))) : null,
      d.noise_floor_K ? el("div", {}, el("b", {}, `${number(d.noise_floor_K, 2)} K`), el("span", {}, text("page-noise-floor"))) : null),
    d.next_measurement ? el("p", { class: "next" }, el("b", {}, `${text("page-next-measurement")}: `), inWords(d.next_measurement_said, d.next_measurement)) : null,
    warningsOf(d))];
  cards.push(el("div", { class: "pair" }, candidatesCard(d), whereCard(d)));
  const curves = record.has_curves ? el("section", { class: "card", "data-testid": "curves" }) : null;
  const law = lawCard(d);
  holder.replaceChildren(...[cards[0], law, planCard(d), curves, ...cards.slice(1)].filter(Boolean));
  if (d.law && law) drawLaw(law, d.law);
  if (curves) drawCurves(curves, record.id);
}

// One run measured and under both models, a chart a place with its residuals below.
async function drawCurves(card, id) {
  const { curves } = await get(`/diagnoses/${id}/curves`);
  if (!card.isConnected) return;
  const models = [["plain", "--faint"], ["extended", "--core"]].filter(([model]) => model === "plain" || curves.core.extended_C);
  const called = (model) => text("figure-model", { model: text(`figure-${model}`) });
  const cores = Object.values(curves.core.measured_C);
  const phases = curves.closed_s === null ? [] : [{ state: "closed", from_s: curves.closed_s, to_s: curves.opened_s }];
  card.append(el("h2", {}, text("page-curves", { run: curves.run })), el("p", { class: "small faint" }, text("page-curves-hint")), key([
    { name: text("figure-mean"), colour: "--measured", class: "dots" }, ...models.map(([model, colour]) => ({ name: called(model), colour })),
    ...models.map(([model, colour]) => ({ name: text("figure-core", { model: text(`figure-${model}`) }), colour, class: "dashes" })), ...(cores.length ? [{ name: text("figure-core-measured"), colour: "--bottom", class: "dots" }] : [])]));
  for (const place of curves.places) {
    const name = capital(placeName(place.place));
    const sync = `curves-${place.place}`;
    const chart = new TimeChart(card, { height: 260, label: name, sync, phases, series: [...models.map(([model, colour]) => ({ name: called(model), colour, kind: "line" })), { name: text("figure-mean"), colour: "--measured", kind: "dots" },
      ...models.map(([model, colour]) => ({ name: text("figure-core", { model: text(`figure-${model}`) }), colour, kind: "thin", dash: [5, 4] })),
      ...cores.map(() => ({ name: text("figure-core-measured"), colour: "--bottom", kind: "dots" }))] });
    chart.set([curves.time_s, ...models.map(([model]) => place[`${model}_C`]), place.measured_C, ...models.map(([model]) => curves.core[`${model}_C`]), ...cores]);
    const off = models.map(([model]) => place[`${model}_residual_K`]);
    const residual = new TimeChart(card, { height: 150, label: text("page-curves-residual", { place: name }), yLabel: "K", sync, phases, yRange: calmRange(off), series: models.map(([model, colour]) => ({ name: called(model), colour, kind: "line", unit: "K", digits: 2 })) });
    residual.set([curves.time_s, ...off]);
    residual.holder.before(el("p", { class: "small faint" }, residual.label));
    chart.holder.before(el("h3", { class: "sub" }, name));
  }
}

function sentence(d) {
  if (!d.effects.length) return has(`page-sentence-${d.verdict}`) ? text(`page-sentence-${d.verdict}`) : "";
  return capital(d.effects.map((effect) => eitherOf(effect.set?.length ? effect.set : [effect.name])).join(" + "));
}

// A name with a comma of its own, a relative clause say, ends before the next begins.
function eitherOf(effects) {
  const names = effects.map(effectCalled);
  return names.join(`${names.some((one) => one.includes(",")) ? "," : ""} ${text("page-or")} `);
}

function effectBlock(effect, words) {
  const parameters = Object.entries(effect.parameters ?? {}).map(([key, p]) => [key, shownParameter(key, p, words?.[`${effect.name}.${key}`])]);
  const worth = effect.worth ? inWords(effect.worth_said, effect.worth) : `${text("page-heldout-gain")} ${kelvins(effect.heldout_gain_K, 2)} K`;
  return el("div", {}, el("h2", { class: "sub" }, name(effect.name), " ", el("code", { class: "small faint" }, effect.name)),
    parameters.length ? table(name(effect.name), [{ text: text("page-parameter") }, { text: text("page-value"), class: "right" }, { text: text("page-interval"), class: "right" }],
      parameters.map(([key, p]) => [el("span", { title: key }, p.words), el("span", { class: "num" }, `${p.value} ${p.unit}`.trim()), el("span", { class: "num" }, p.interval)])) : null,
    el("p", {}, `${capital(worth)}.`),
    el("p", { class: "small faint" }, [effect.explained_share >= 0.005 && effect.name !== "sensor_fault" && text("page-explains", { percent: 100 * Math.min(effect.explained_share, 1) }),
      Number.isFinite(effect.p_value) && `${text("page-luck")}: ${chance(effect.p_value)}`].filter(Boolean).join(" · ")));
}

// A parameter's words, value and interval; without words its short name stands for itself.
function shownParameter(short, parameter, words) {
  const value = (v) => (typeof v === "number" ? plain(v * (words?.factor ?? 1)) : String(v ?? "–"));
  return {
    words: words ? inWords(words.words_said, words.words) : short.replaceAll("_", " "),
    value: Array.isArray(parameter.value) ? parameter.value.join(", ") : value(parameter.value),
    unit: words ? inWords(words.unit_said, words.unit) : "",
    interval: parameter.ci95 ? `${value(parameter.ci95[0])} … ${value(parameter.ci95[1])}` : "–",
  };
}

const chance = (p) => `p\u00a0${p < 1e-4 ? "<" : "="}\u00a0${number(Math.max(p, 1e-4), 4)}`;

// Kelvins without the sign of a zero.
const kelvins = (value, digits) => number(Math.abs(value) < 0.5 * 10 ** -digits ? 0 : value, digits);

const SHOWN_K = 0.005; // less is written as 0.00

function candidatesCard(d) {
  const items = (d.candidates ?? []).filter((c) => Math.abs(c.heldout_gain_K ?? 0) >= SHOWN_K).sort((a, b) => b.heldout_gain_K - a.heldout_gain_K).slice(0, 10);
  const best = Math.max(...items.map((c) => c.heldout_gain_K ?? 0), 1e-9);
  const above = [...d.effects, ...(d.suspected ?? [])].flatMap((effect) => [effect.name, ...(effect.set ?? [])]);
  const other = items.length && above.length && !above.includes(items[0].name);
  return el("section", { class: "card" }, el("h2", {}, text("page-evidence")), items.length ? el("div", { class: "bars" }, items.map((c) =>
    el("div", { class: `bar-row ${d.effects.some((e) => e.name === c.name) ? "first" : ""}` }, el("span", {}, name(c.name)), el("i", { style: `width:${Math.max(0, (100 * (c.heldout_gain_K ?? 0)) / best)}%` }),
      el("span", { class: "num right" }, `${kelvins(c.heldout_gain_K, 2)} K`)))) : el("p", { class: "faint" }, text("page-no-gain")),
    other ? el("p", { class: "small faint" }, text("page-evidence-other", { cause: effectCalled(items[0].name) })) : null);
}

const UNJUDGED = ["too_few_runs", "not_described"];

function whereCard(d) {
  const heads = [{ text: text("page-place") }, { text: text("page-off-by"), class: "right" }, { text: text("page-state") }, { text: text("page-since-it-began"), class: "right" }, { text: text("page-measured-there"), class: "right" }];
  const span = (from, to, unit) => `${number(from, 0)}${to === from ? "" : ` … ${number(to, 0)}`} ${unit}`;
  return el("section", { class: "card" }, el("h2", {}, text("page-where")), d.where?.length ? table(text("page-where"), heads,
    d.where.slice(0, 8).map((w) => [el("span", { title: w.signal }, placeName(w.signal)), el("span", { class: "num" }, `${w.residual_K > 0 ? "+" : ""}${number(w.residual_K, 2)} K`),
      w.phase ? inWords(w.phase_said, w.phase) : text(`page-state-${w.state}`), el("span", { class: "num" }, w.to_s === null ? `> ${number(w.from_s, 0)} s` : span(w.from_s, w.to_s, "s")),
      el("span", { class: "num" }, Number.isFinite(w.low_C) ? span(Math.round(w.low_C), Math.round(w.high_C), "°C") : "–")]), { cards: true }) : el("p", { class: "faint" }, text(UNJUDGED.includes(d.verdict) ? "page-nowhere-sought" : "page-nowhere")));
}

function historyCard(items, choose) {
  return el("section", { class: "card" }, el("h2", {}, text("page-earlier")), table(text("page-earlier"), [{ text: text("page-started") }, { text: text("page-verdict") }, { text: text("page-cause") }],
    items.map((item) => [el("button", { type: "button", class: "quiet", onclick: () => { choose(item); scrollTo({ top: 0 }); } }, clock(item.utc)), text(`diagnosis-verdict-${item.diagnosis.verdict}`), sentence(item.diagnosis)])));
}

function modelsCard(items) {
  const message = el("p", { class: "small", role: "status" });
  const promote = async (item, button) => {
    if (!confirm(text("page-promote-question", { version: item.version }))) return;
    button.disabled = true;
    try {
      await post(`/models/${encodeURIComponent(item.version)}/promote`);
      dispatchEvent(new HashChangeEvent("hashchange"));
    } catch (error) {
      message.textContent = error.message;
      button.disabled = false;
    }
  };
  const current = items.findIndex((item) => item.current);
  return el("section", { class: "card" }, el("h2", {}, text("page-models")), items.length ? table(text("page-models"),
    [{ text: text("page-version") }, { text: text("page-started"), class: "hide-narrow" }, { text: text("page-effects") }, { text: text("page-reason"), class: "hide-narrow" }, { text: text("page-promote"), unseen: true }],
    items.map((item, i) => {
      const button = el("button", { type: "button", class: "button" }, text(current >= 0 && i > current ? "page-roll-back" : "page-promote"));
      button.addEventListener("click", () => promote(item, button));
      const version = item.status === "rejected" ? el("div", {}, item.version, " ", el("span", { class: "pill warn" }, text("page-model-rejected"))) : item.version;
      return [version, clock(item.utc), item.effects.length ? item.effects.map(name).join(", ") : text("page-plain-model"), item.reason ? inWords(item.reason_said, item.reason) : "–",
        item.current ? el("span", { class: "pill good" }, text("page-in-use")) : button];
    })) : el("p", { class: "faint" }, text("page-no-models")), message);
}
