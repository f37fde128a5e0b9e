// What if: the run with other settings, against the run as it was; asked of the server when it is unfolded.
import { get } from "../api.js";
import { TimeChart, key, straight } from "../charts.js";
import { el, number, table, written } from "../dom.js";
import { inFieldWords, text } from "../words.js";

export function whatIfCard(path) {
  const body = el("div", {}, el("p", { class: "faint" }, text("page-simulating")));
  const card = el("details", { class: "card", "data-testid": "what-if" }, el("summary", {}, el("h2", { style: "display:inline" }, text("page-what-if"))), body);
  card.addEventListener("toggle", async () => {
    if (!card.open || card.asked) return;
    card.asked = true;
    try {
      body.replaceChildren(...form(path, await get(`${path}/what-if`)));
    } catch (error) {
      card.asked = false; // may be asked again
      body.replaceChildren(el("p", { class: "small bad-text", role: "alert" }, error.message));
    }
  });
  return card;
}

function form(path, was) {
  const inputs = Object.entries(was.settings).map(([name, { was: value }]) => [name, el("input", { type: "text", inputmode: "decimal", autocomplete: "off", value: written(Number(value.toPrecision(4))), id: `what-if-${name}` })]);
  const untouched = Object.fromEntries(inputs.map(([name, input]) => [name, input.value]));
  const names = Object.fromEntries(inputs.map(([name]) => [`query.${name}`, text(`page-what-if-${name}`)]));
  const shown = el("div", { role: "status" });
  const node = el("form", { class: "touch-form" }, inputs.map(([name, input]) => el("label", { for: input.id }, text(`page-what-if-${name}`), input)), el("button", { class: "button primary" }, text("page-what-if-ask")));
  node.addEventListener("submit", async (event) => {
    event.preventDefault();
    const changed = inputs.filter(([name, input]) => input.value.trim() && input.value !== untouched[name]);
    try {
      show(shown, was, await get(`${path}/what-if`, Object.fromEntries(changed.map(([name, input]) => [name, input.value.trim().replace(",", ".")]))));
    } catch (error) { shown.replaceChildren(el("p", { class: "small bad-text", role: "alert" }, inFieldWords(error.coded, error.message, names))); }
  });
  return [el("p", { class: "small faint" }, text("page-what-if-hint")), node, shown];
}

// [lower bound, expected, upper bound] as it is read; of cure and steam, what is sure.
const QUANTITIES = [
  ["core_C", "page-core-at-opening", ([low, middle, high]) => `${number(middle, 1)} °C (${number(low, 1)} … ${number(high, 1)})`],
  ["cure", "page-cure", ([low, middle], { grade }) => [`${number(100 * middle, 0)} % (≥\u00a0${number(100 * low, 0)})`, grade && text(`page-grade-${grade}`)].filter(Boolean).join(", ")],
  ["steam_kPa", "page-steam", ([, middle, high]) => `${number(middle, 0)} kPa (≤\u00a0${number(high, 0)})`],
];

function show(place, was, asked) {
  const both = [was, asked];
  const rows = QUANTITIES.filter(([name]) => both.every(({ at_opening: at }) => at && at[name][1] !== null))
    .map(([name, label, say]) => [text(label), ...both.map(({ at_opening: at }) => el("span", { class: "num" }, say(at[name], at)))]);
  const charts = [chart("core", "page-core-temperature", "°C", 1), ...(asked.cure.some((v) => v !== null) ? [chart("cure", "page-cure", "%", 100)] : []), ...(asked.steam_kPa.some((v) => v !== null) ? [chart("steam", "page-steam", "kPa", 1)] : [])];
  place.replaceChildren(
    table(text("page-what-if"), [{ text: text("page-at-opening") }, { text: text("page-what-if-as-it-was"), class: "right" }, { text: text("page-what-if-asked"), class: "right" }], rows),
    ...charts.map(({ holder }) => holder),
    key([{ name: text("page-what-if-as-it-was"), colour: "--faint", class: "dashes" }, { name: text("page-what-if-asked"), colour: "--core" }, { name: text("page-band95"), class: "band" }]));
  for (const one of charts) one.draw(was, asked);
}

// The run as it was lies under the one asked for, both from closing on.
const COLUMNS = {
  core: { middle: "core_C", low: "core_low_C", high: "core_high_C" },
  cure: { middle: "cure", low: "cure_low", high: "cure" },
  steam: { middle: "steam_kPa", low: "steam_kPa", high: "steam_high_kPa" },
};

function chart(name, label, unit, factor) {
  const holder = el("div", {}, el("h3", {}, text(label)));
  const draw = (was, asked) => {
    const { middle, low, high } = COLUMNS[name];
    const times = asked.time_s.map((t) => t - asked.closed_s);
    const scaled = (values) => values.map((v) => (v === null ? null : v * factor));
    const before = straight(was.time_s.map((t) => t - was.closed_s), scaled(was[middle]), times);
    new TimeChart(holder, {
      series: [{ name: text("page-what-if-as-it-was"), colour: "--faint", kind: "line", dash: [6, 5], unit, digits: factor > 1 ? 0 : 1 }, { name: "low", kind: "band-low", unit }, { name: "high", kind: "band-high", unit }, { name: text("page-what-if-asked"), colour: "--core", kind: "core", unit, digits: factor > 1 ? 0 : 1 }],
      height: name === "core" ? 300 : 170, label: text(label), yLabel: unit, xLabel: text("page-time-from-closing"),
      phases: asked.opened_s === null ? [] : [{ state: "closed", from_s: 0, to_s: asked.opened_s - asked.closed_s }],
    }).set([times, before, scaled(asked[low]), scaled(asked[high]), scaled(asked[middle])]);
  };
  return { holder, draw };
}
