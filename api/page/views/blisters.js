// The steam that panels bear, learned from those marked good or blistered: each panel, the chance, and what to write down.
import { get } from "../api.js";
import { TimeChart, key } from "../charts.js";
import { el, number, table } from "../dom.js";
import { inWords, text } from "../words.js";
import { steamOf } from "./answer.js";

export async function showBlisters(place, context) {
  const answer = await get("/blisters", { press: context.press ?? "" });
  const known = answer.panels.filter(({ steam_kPa: steam }) => steam !== null);
  const holder = el("div", {});
  place.append(el("section", { class: "card", "data-testid": "blisters" },
    el("div", { class: "head" }, el("h1", {}, text("page-blisters", { press: answer.press })), el("a", { class: "button", href: "#/runs" }, text("page-back"))),
    answer.sentences.map((sentence, i) => el("p", {}, inWords(answer.sentences_said[i], sentence))), holder,
    key([{ name: text("page-blisters-chance"), colour: "--core" }, { name: text("page-panel-good"), colour: "--good", class: "dots" }, { name: text("page-panel-blister"), colour: "--bad", class: "dots" }])),
  el("section", { class: "card" }, el("h2", {}, text("page-blisters-marked")), answer.panels.length ? marked(answer.panels) : el("p", { class: "faint" }, text("page-blisters-none"))));
  requestAnimationFrame(() => draw(holder, answer, known));
  return null;
}

// Panels lie at 0 or 100 %, over the chance that each of so much steam had.
function draw(holder, answer, known) {
  const points = [...answer.curve_kPa.map((x, i) => [x, 100 * answer.chance[i], null, null]),
    ...known.map(({ steam_kPa: x, verdict }) => [x, null, verdict === "good" ? 0 : null, verdict === "blister" ? 100 : null])].sort((a, b) => a[0] - b[0]);
  const most = Math.max(1.3 * answer.ci95_kPa[1], ...known.map(({ steam_kPa: x }) => 1.1 * x));
  const chart = new TimeChart(holder, {
    series: [{ name: text("page-blisters-chance"), colour: "--core", kind: "core", unit: "%", digits: 0, spanGaps: true },
      ...[["page-panel-good", "--good"], ["page-panel-blister", "--bad"]].map(([name, colour]) => ({ name: text(name), colour, kind: "dots", size: 9, unit: "%", digits: 0 }))],
    height: 300, label: text("page-blisters-chance"), yLabel: "%", xLabel: `${text("page-steam")} [kPa]`, xRange: [0, most], yRange: [-6, 106], bridge: Infinity,
  });
  chart.tipHead = (x) => [`${number(x, 0)} kPa`, ...known.filter(({ steam_kPa: steam }) => steam === x).map(({ run }) => run)].join(" · ");
  chart.marks = [...answer.ci95_kPa.map((x) => ({ x, name: "", colour: "--faint" })), { x: answer.steam_most_kPa, name: `${number(answer.steam_most_kPa, 0)} kPa`, colour: "--accent" }];
  chart.set([0, 1, 2, 3].map((k) => points.map((row) => row[k])));
}

const marked = (panels) => table(text("page-blisters-marked"), [{ text: text("page-run") }, { text: text("page-number-panel-verdict") }, { text: text("page-steam"), class: "right" }],
  panels.map(({ run, verdict, steam_kPa: steam, steam_high_kPa: high }) => [el("a", { href: `#/runs/${encodeURIComponent(run)}` }, run), el("span", { class: `pill ${verdict === "good" ? "good" : "bad"}` }, text(`page-panel-${verdict}`)),
    el("span", { class: "num" }, steam === null ? "–" : `${number(steam, 0)} kPa (${steamOf(high)})`)]));
