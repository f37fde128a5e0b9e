// Coefficients: their history with intervals, and how they depend on a setting.
import { get } from "../api.js";
import { TimeChart } from "../charts.js";
import { began, el, figure, number, table } from "../dom.js";
import { has, inWords, numberName, text } from "../words.js";

export async function show(place, context) {
  const press = context.presses.length > 1 ? context.press : "";
  const [{ items }, presses, drift, models] = await Promise.all([get("/coefficients", { press, limit: 500 }), get("/press"), get("/coefficients/drift", { press }), get("/models", { press: context.press })]);
  const origin = ofSisters(models.items.find((item) => item.current));
  if (!items.length) { place.append(el("div", { class: "card empty" }, el("h1", {}, text("page-nav-coefficients")), el("p", {}, text("page-no-fits")), ...origin)); return null; }
  const history = [...items].reverse();
  const names = [...new Set(history.flatMap((item) => Object.keys(item.coefficients)))];
  const axes = ["time", ...new Set(history.flatMap((item) => Object.keys(item.settings)))];
  const choice = el("select", { "aria-label": text("page-against") }, axes.map((name) => el("option", { value: name }, name === "time" ? text("page-order-of-runs") : numberName(name))));
  const charts = el("div", { class: "pair" });
  const used = presses.items.find((item) => item.press === context.press)?.coefficients ?? {};
  place.append(el("section", { class: "card" }, el("div", { class: "head" }, el("h1", {}, text("page-nav-coefficients")),
    el("label", { class: "row small" }, el("span", { class: "faint" }, text("page-against")), choice)),
  el("p", { class: "faint" }, `${text("page-coefficients-hint")} ${text("page-drift-hint")}`), ...origin), charts);
  const draw = () => {
    charts.replaceChildren(...names.map((name) => card(name, history, choice.value, used[name], drift.items.find((item) => item.coefficient === name))));
  };
  choice.addEventListener("change", draw);
  draw();
  place.append(latestCard(history.at(-1)));
  context.on("fit", () => { dispatchEvent(new HashChangeEvent("hashchange")); });
  return null;
}

// A model that presses of the same kind have taught says which.
function ofSisters(model) {
  return model?.reason_said?.code === "model-from-sisters" ? [el("p", {}, text("page-coefficients-sisters", { why: inWords(model.reason_said, model.reason) }))] : [];
}

function card(name, history, axis, used, drift) {
  const points = history.map((item, i) => ({ x: axis === "time" ? i + 1 : item.settings[axis], c: item.coefficients[name], item }))
    .filter((point) => point.c && point.x !== undefined).sort((a, b) => a.x - b.x);
  const holder = el("div", {});
  const known = (p) => p.c.identifiable !== false;
  const determined = points.filter(known);
  const last = history.findLast(({ coefficients }) => coefficients[name] && coefficients[name].identifiable !== false);
  const value = last && `${figure(last.coefficients[name].value)} W/m²K`;
  // The newest fit, in the table below, may not know it: then this says whose value it is.
  const beside = [last && last !== history.at(-1) && text("page-last-identifiable", { run: last.run }), used && `${text("page-in-use")} ${figure(used)} W/m²K`].filter(Boolean);
  const [low, high] = span(determined.length ? determined : points);
  requestAnimationFrame(() => {
    if (!holder.isConnected) return;
    const chart = new TimeChart(holder, {
      series: [{ name: text("page-ci-low"), kind: "band-low" }, { name: text("page-ci-high"), kind: "band-high" },
        { name, colour: "--accent", kind: axis === "time" ? "line" : "dots", points: true, size: 7, unit: "W/m²K", digits: 0 },
        { name: text("page-not-identifiable"), colour: "--faint", kind: "dots", edge: true, size: 8, unit: "W/m²K", digits: 0 }],
      height: 200, label: `${name} ${text("page-history")}`, yLabel: "W/m²K", xLabel: axis === "time" ? text("page-order-of-runs") : numberName(axis),
      whiskers: "--accent", xSteps: axis === "time" ? [1, 2, 5, 10, 20, 50, 100, 200] : null,
      yRange: [low, high], xRange: axis === "time" ? [0.5, Math.max(points.length, 2) + 0.5] : undefined,
    });
    chart.tipHead = (x) => (axis === "time" ? points.find((p) => p.x === x)?.item.run ?? "" : `${numberName(axis)} ${number(x, 0)}`);
    chart.set([points.map((p) => p.x), points.map((p) => (known(p) ? p.c.ci95?.[0] ?? null : null)), points.map((p) => (known(p) ? p.c.ci95?.[1] ?? null : null)),
      points.map((p) => (known(p) ? p.c.value : null)), points.map((p) => (known(p) ? null : p.c.value))]);
  });
  const described = bodies(name);
  return el("section", { class: "card" }, el("div", { class: "head" }, el("h2", { style: "margin:0" }, name, " ", el("span", { class: "faint small" }, described)),
    el("span", {}, el("span", { class: "num" }, value ?? (beside.length ? "" : "–")), beside.map((words, i) => [value || i ? " · " : "", el("span", { class: "faint small" }, words)]))),
  el("p", { class: "row small", style: "margin:-.4rem 0 .4rem" }, driftPill(drift)), holder);
}

// Which bodies a coefficient couples; empty for a press of one's own.
const bodies = (name) => (has(`page-c-${name}`) ? text(`page-c-${name}`) : "");

// That no change has shown itself is not that there is none: no green.
function driftPill(drift) {
  if (!drift) return el("span", { class: "pill" }, `${text("page-drift")}: ${text("page-drift-none")}`);
  const change = `${drift.factor >= 1 ? "+" : "−"}${number(Math.abs(100 * (drift.factor - 1)), 0)} %`;
  const sentence = text(`page-drift-${drift.chart}`, { change, run: drift.since_run });
  return el("a", { class: "pill warn", href: `#/runs/${encodeURIComponent(drift.since_run)}`, title: inWords(drift.sentence_said, drift.sentence) }, `${text("page-drift")}: ${sentence}`);
}

// The values and most of their intervals: one wide interval must not flatten the others.
function span(points) {
  const values = points.map((p) => p.c.value);
  let [low, high] = [Math.min(...values), Math.max(...values)];
  const halves = points.map((p) => Math.max(...(p.c.ci95 ?? [p.c.value]).map((end) => Math.abs((end ?? p.c.value) - p.c.value)))).sort((a, b) => a - b);
  const reach = Math.max(1.5 * (high - low), 1.1 * halves[Math.floor(halves.length / 2)]);
  const ends = points.flatMap((p) => p.c.ci95 ?? []).filter((v) => v !== null && v >= low - reach && v <= high + reach);
  [low, high] = [Math.min(low, ...ends), Math.max(high, ...ends)];
  const space = (high - low || Math.abs(high) || 1) * 0.15;
  return [Math.max(low - space, 0), high + space];
}

function latestCard(item) {
  return el("section", { class: "card" }, el("h2", {}, `${text("page-last-fit")}: `, el("a", { href: `#/runs/${encodeURIComponent(item.run)}` }, item.run), ` · ${began(item.utc)}`), coefficientTable(item.coefficients));
}

export function coefficientTable(coefficients) {
  return table(text("page-nav-coefficients"), [{ text: text("page-name") }, { text: "W/m²K", class: "right" }, { text: text("page-interval"), class: "right" }, { text: text("page-verdict") }],
    Object.entries(coefficients).map(([name, c]) => [el("span", {}, name, " ", el("span", { class: "faint small hide-narrow" }, bodies(name))), el("span", { class: "num" }, figure(c.value)),
      el("span", { class: "num" }, c.ci95 ? `${figure(c.ci95[0])} … ${figure(c.ci95[1])}` : "–"),
      c.identifiable === null || c.identifiable === undefined ? "–" : el("span", { class: `pill ${c.identifiable ? "good" : "warn"}`, title: inWords(c.reason_said, c.reason) }, text(c.identifiable ? "page-identifiable" : "page-not-identifiable"))]));
}
