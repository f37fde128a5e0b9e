// Beyond the catalogue of causes: what is missing as a curve without a name, and the next pressings that would decide.
import { TimeChart, key } from "../charts.js";
import { el, number } from "../dom.js";
import { inWords, text } from "../words.js";

const said = (one) => inWords(one.sentence_said, one.sentence);

export function lawCard(d) {
  if (!d.law_sentences?.length) return null;
  return el("section", { class: "card", "data-testid": "law" }, el("h2", {}, text("law-heading")), d.law_sentences.map((one) => el("p", {}, said(one))));
}

// The curve with its band; drawn once its card stands in the page, for a chart is as wide as its place.
export function drawLaw(card, law) {
  const [x, value, low, high] = [0, 1, 2, 3].map((i) => law.curve.map((row) => row[i]));
  const unit = law.unit === "-" ? "" : law.unit.replace("m3", "m³");
  const name = text(`law-kind-${law.kind}`);
  const band = text("page-band95");
  card.append(key([{ name, colour: "--core" }, { name: band, class: "band" }]));
  const chart = new TimeChart(card, { height: 260, label: name, yLabel: unit, xLabel: text(`law-variable-${law.variable}`), xRange: [x[0], x.at(-1)], bridge: Infinity,
    series: [{ name: band, kind: "band-low" }, { name: band, kind: "band-high" }, { name, colour: "--core", kind: "line", unit, digits: 2 }] });
  chart.tipHead = (at) => number(at, x.at(-1) - x[0] > 10 ? 0 : 2);
  chart.set([x, low, high, value]);
}

export function planCard(d) {
  if (!d.plan) return null;
  const points = d.plan.open.map((point) => el("div", {}, el("h3", { class: "sub" }, said(point)), el("ul", {}, point.pressings.map((one) => el("li", {}, said(one))))));
  return el("section", { class: "card", "data-testid": "plan" }, el("h2", {}, text("plan-heading")), d.plan.sentences.map((one) => el("p", { class: "faint" }, said(one))), points);
}
