// What the simulation gets wrong: the last diagnosis with cause, evidence and gain; model versions to promote or roll back.
import { get, post } from "../api.js";
import { clock, el, figure, number, table } from "../dom.js";
import { effectName as name, sentence as said } from "../sentences.js";
import { placeName, text } from "../text.js";

export async function show(place, context) {
  const press = context.presses.length > 1 ? context.press : "";
  const [diagnoses, models] = await Promise.all([get("/diagnoses", { press, limit: 20 }), get("/models", { press })]);
  place.append(el("div", { class: "row" }, el("h1", {}, text("nav_diagnosis"))));
  if (!diagnoses.items.length) {
    place.append(el("div", { class: "card empty" }, el("p", {}, text("no_diagnosis")), el("p", { class: "small" }, text("no_diagnosis_hint"))));
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
  const tone = { no_effect: "good", named: "note", ambiguous: "warn", unknown_effect: "warn", too_few_runs: "idle" }[d.verdict] ?? "idle";
  const gain = d.base?.heldout_rmse_K && d.extended?.heldout_rmse_K ? 1 - d.extended.heldout_rmse_K / d.base.heldout_rmse_K : null;
  const pair = (label, base, extended) => (base === null || base === undefined ? null
    : el("div", {}, el("b", {}, `${number(base, 2)} → ${number(extended, 2)} K`), el("span", {}, label)));
  const cards = [el("section", { class: "card", "data-testid": "diagnosis" },
    el("div", { class: "row" }, el("span", { class: `pill ${tone}` }, text(`verdict_${d.verdict}`)), el("span", { class: "faint small" }, clock(record.utc))),
    el("p", { class: "verdict" }, sentence(d)),
    ...d.effects.map((effect) => effectBlock(effect)),
    el("div", { class: "gain" },
      pair(text("heldout"), d.base?.heldout_rmse_K, d.extended?.heldout_rmse_K), pair(text("all_sensors"), d.base?.rmse_K, d.extended?.rmse_K), pair(text("core"), d.base?.core_rmse_K, d.extended?.core_rmse_K),
      gain !== null && d.effects.length ? el("div", {}, el("b", {}, `${number(100 * gain, 0)} %`), el("span", {}, text("gain"))) : null,
      d.noise_floor_K ? el("div", {}, el("b", {}, `${number(d.noise_floor_K, 2)} K`), el("span", {}, text("noise_floor"))) : null),
    d.next_measurement ? el("p", { class: "next" }, el("b", {}, `${text("next_measurement")}: `), said(d.next_measurement)) : null)];
  cards.push(el("div", { class: "pair" }, candidatesCard(d), whereCard(d)));
  holder.replaceChildren(...cards);
}

function sentence(d) {
  if (!d.effects.length) return text(`sentence_${d.verdict}`);
  const names = d.effects.map((effect) => effect.set && effect.set.length > 1 ? effect.set.map(name).join(` ${text("or")} `) : name(effect.name));
  return names.join(` + `);
}

function effectBlock(effect) {
  return el("div", {}, el("h2", { class: "sub" }, name(effect.name), " ", el("code", { class: "small faint" }, effect.name)),
    table(name(effect.name), [{ text: text("parameter") }, { text: text("value"), class: "right" }, { text: text("interval"), class: "right" }],
      Object.entries(effect.parameters ?? {}).map(([parameter, p]) => [el("code", {}, parameter), el("span", { class: "num" }, Array.isArray(p.value) ? p.value.join(", ") : typeof p.value === "number" ? figure(p.value) : String(p.value ?? "–")),
        el("span", { class: "num" }, p.ci95 ? `${figure(p.ci95[0])} … ${figure(p.ci95[1])}` : "–")])),
    el("p", { class: "small faint" }, [effect.p_value !== null && effect.p_value !== undefined && `p = ${effect.p_value < 1e-4 ? effect.p_value.toExponential(1) : number(effect.p_value, 4)}`,
      effect.heldout_gain_K !== null && effect.heldout_gain_K !== undefined && `${text("heldout_gain")} ${number(effect.heldout_gain_K, 3)} K`,
      effect.explained_share !== null && effect.explained_share !== undefined && `${text("explains")} ${number(100 * effect.explained_share, 0)} %`].filter(Boolean).join(" · ")));
}

const SHOWN_K = 0.0005; // less is written as 0.000

function candidatesCard(d) {
  const items = (d.candidates ?? []).filter((c) => Math.abs(c.heldout_gain_K ?? 0) >= SHOWN_K).sort((a, b) => b.heldout_gain_K - a.heldout_gain_K).slice(0, 10);
  const best = Math.max(...items.map((c) => c.heldout_gain_K ?? 0), 1e-9);
  return el("section", { class: "card" }, el("h2", {}, text("evidence")), items.length ? el("div", { class: "bars" }, items.map((c) =>
    el("div", { class: `bar-row ${d.effects.some((e) => e.name === c.name) ? "first" : ""}` }, el("span", {}, name(c.name)), el("i", { style: `width:${Math.max(0, (100 * (c.heldout_gain_K ?? 0)) / best)}%` }),
      el("span", { class: "num right" }, `${number(c.heldout_gain_K, 3)} K`)))) : el("p", { class: "faint" }, "–"));
}

function whereCard(d) {
  return el("section", { class: "card" }, el("h2", {}, text("where")), d.where?.length ? table(text("where"),
    [{ text: text("signal") }, { text: text("state") }, { text: text("when"), class: "right" }, { text: text("residual_short"), class: "right" }],
    d.where.slice(0, 8).map((w) => [placeName(w.signal), text(`state_${w.state}`), el("span", { class: "num" }, w.to_s === null ? `> ${number(w.from_s, 0)} s` : `${number(w.from_s, 0)} … ${number(w.to_s, 0)} s`), el("span", { class: "num" }, `${number(w.residual_K, 2)} K`)])) : el("p", { class: "faint" }, text("nowhere")));
}

function historyCard(items, choose) {
  return el("section", { class: "card" }, el("h2", {}, text("earlier")), table(text("earlier"), [{ text: text("started") }, { text: text("verdict") }, { text: text("cause") }],
    items.map((item) => [el("button", { type: "button", class: "quiet", onclick: () => { choose(item); scrollTo({ top: 0 }); } }, clock(item.utc)), text(`verdict_${item.diagnosis.verdict}`), sentence(item.diagnosis)])));
}

function modelsCard(items) {
  const message = el("p", { class: "small", role: "status" });
  const promote = async (item, button) => {
    if (!confirm(text("promote_question").replace("{version}", item.version))) return;
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
  return el("section", { class: "card" }, el("h2", {}, text("models")), items.length ? table(text("models"),
    [{ text: text("version") }, { text: text("started"), class: "hide-narrow" }, { text: text("effects") }, { text: text("reason"), class: "hide-narrow" }, { text: text("promote"), unseen: true }],
    items.map((item, i) => {
      const button = el("button", { type: "button", class: "button" }, text(current >= 0 && i > current ? "roll_back" : "promote"));
      button.addEventListener("click", () => promote(item, button));
      const version = item.status === "rejected" ? el("div", {}, item.version, " ", el("span", { class: "pill warn" }, text("model_rejected"))) : item.version;
      return [version, clock(item.utc), item.effects.length ? item.effects.map(name).join(", ") : text("plain_model"), item.reason ? said(item.reason) : "–",
        item.current ? el("span", { class: "pill good" }, text("in_use")) : button];
    })) : el("p", { class: "faint" }, text("no_models")), message);
}
