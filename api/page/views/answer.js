// What now and wall view share: the core with its band, the one answer, and the chart of the core with what is foreseen.
import { TimeChart, key } from "../charts.js";
import { asOf, duration, el, number } from "../dom.js";
import { causeOf } from "../silence.js";
import { inWords, text } from "../words.js";

// What may be shown as a number: an estimate that is not valid foresees nothing either.
export const believed = (estimate) => (estimate?.valid ? estimate : {});

export const seconds = (value) => (value < 100 ? `${number(value, 0)}\u00a0s` : duration(value));

// What is sure of cure and steam: the least of the less cured face with its grade, and the most.
export const cureOf = (low, grade) => [`≥\u00a0${number(100 * low, 0)}\u00a0%`, grade && text(`page-grade-${grade}`)].filter(Boolean).join(", ");

export const steamOf = (high) => `≤\u00a0${number(high, 0)}\u00a0kPa`;

// Why there is no core is shown once: by the answer where that is not known, else here.
// A tile has no room for the name of the band. `old`: when it was, on one line, of one that rests on old readings.
export function showCore(core, band, state, estimate, { tile = false, old = null } = {}) {
  const valid = state !== "idle" && estimate && estimate.valid && estimate.core_C !== null;
  core.className = valid ? "core" : "core invalid";
  core.replaceChildren(valid ? number(estimate.core_C, 1) : "–", el("small", {}, "°C"));
  band.textContent = valid
    ? `${number(estimate.core_low_C, 1)} … ${number(estimate.core_high_C, 1)}\u00a0°C${tile ? "" : ` · ${text("page-band95")}`}${old ? ` · ${asOf(old).replaceAll(" ", "\u00a0")}` : ""}`
    : state === "idle" || !estimate || estimate.advice?.verdict === "not_known" ? "" : reasonOf(estimate);
}

// Why there is no core: a code in plain words, whose words the catalogue has with hyphens.
function reasonOf(estimate) {
  return estimate?.reason && inWords({ code: `reason-${estimate.reason.replaceAll(" ", "-")}`, arguments: estimate.reason_arguments }, estimate.reason);
}

// For how long nothing was read; a press whose loggers never gave a reading has been silent for ever.
export const whySilent = (silent) => (silent === Infinity ? text("page-no-reading-yet") : text("page-no-reading-for", { time: seconds(Math.round(silent)) }));

// One line in its own colour. What rests on no reading for `silent` seconds is not known, whatever was foreseen; why
// is left out where a banner says it.
export function showAnswer(place, { state, estimate }, silent, { banner = false } = {}) {
  const advice = estimate?.advice;
  const empty = state === "idle" && !advice;
  const verdict = silent !== null || !(advice || empty) ? "not_known" : empty ? "no_panel" : advice.verdict;
  const line = silent !== null
    ? banner ? text("page-answer-not-known") : text("advice-not-known", { why: whySilent(silent) })
    : advice ? inWords(advice.sentence_said, advice.sentence) : text(empty ? "advice-no-panel" : "page-no-estimate");
  const shown = line.replace(/\([^()]*\)/g, (band) => band.replaceAll(" ", "\u00a0")); // a band stands on one line
  place.className = `answer ${verdict}`;
  if (place.textContent !== shown) place.textContent = shown;
}

// What becomes of a core that is opened as the answer says: without it "open now" stands beside one far below its target.
export function showPeak(place, { estimate }, silent) {
  const { verdict, peak_C: peak } = (silent === null && estimate?.advice) || {};
  place.hidden = !["open_now", "open_in"].includes(verdict) || (peak ?? null) === null;
  if (!place.hidden) place.textContent = text("page-peak-then", { peak });
}

// Why nothing is known of now, whatever the panel: recorder or live sensor are silent, clocks disagree.
const SILENT = ["live sensor silent", "no scans", "clock ahead"];

// The core's target as far as it says when to open: not beside limits of a resin file.
export const targetOf = (now) => (now.estimate?.limited ? null : now.target?.temperature_C ?? null);

// The press's state as it may be shown: none that rests on old readings.
export const stateOf = (now, stale) => (stale ? "unknown" : now.state);

// What a live sensor that is not ready says of itself; the first time it takes about a minute.
export const startingOf = (health) => (health.processes.some(({ alive, state }) => alive && state === "starting") ? text("page-sensor-starting") : "");

// What is wrong for a press: an alarm that names it or, shorter in a tile, one that names none; not another press's.
function wrongOf({ alarms, alarms_said: said }, press, { tile = false } = {}) {
  const i = said.findIndex((one) => (one.arguments?.press ?? press) === press);
  return i < 0 ? "" : tile && !said[i].arguments?.press ? text("page-health-degraded") : inWords(said[i], alarms[i]);
}

// One light: green only where everything runs and what there is to say of the panel is known. That and for how long
// nothing was read the answer says, and in a tile, that the core is not known; the light, why nothing is.
export function showLight(light, { now, health = null, silent = null, tile = false, link = null }) {
  const { state, estimate, press } = now;
  if (silent !== null) {
    light.className = "light bad";
    lead(light, tile ? "" : causeOf(health, press, link));
    if (!tile && !light.children.length) light.replaceChildren(el("span", { class: "unseen" }, text("page-no-readings")));
    return;
  }
  const wrong = health ? wrongOf(health, press, { tile }) : "";
  const starting = health ? startingOf(health) : "";
  const known = !starting && (state === "idle" || (estimate?.advice && estimate.advice.verdict !== "not_known"));
  const fault = SILENT.includes(estimate?.reason) ? reasonOf(estimate) : wrong;
  light.className = `light ${fault ? "bad" : known ? "good" : "idle"}`;
  if (fault && !tile) lead(light, fault);
  else light.textContent = fault || starting || text(known ? "page-health-ok" : tile ? "page-health-runs" : "page-health-core-unknown");
}

// What is wrong leads to all alarms; where the words stay, what somebody is about to press does, too.
function lead(light, words) {
  if (light.textContent === words && light.querySelector("a")) return;
  light.replaceChildren(words && el("a", { href: "#/alarms" }, words));
}

// The core as it may be shown: of a press that is silent the last that was believed, with when it was. The server says
// it of a silence that it knows of; behind a lost link nobody but the page knows it.
export class LastCore {
  of({ state, estimate, last_core: last }, stale) {
    if (estimate?.reason === "no scans") this.last = last && { state: "unknown", estimate: { ...last, valid: true } };
    else if (!stale) this.last = state !== "idle" && estimate?.valid ? { state, estimate } : null;
    return stale && this.last ? { ...this.last, old: this.last.estimate.utc } : { state, estimate, old: null };
  }
}

// An estimate of the stream takes the place of the one before; what comes late is history, valid or not, but for the
// server's word that nothing is of now. A silence keeps the core that was believed as it began.
export function take(now, data) {
  if (data.age_s > now.silent_after_s && !SILENT.includes(data.reason)) return false;
  if (data.reason === "no scans" && now.estimate?.reason !== "no scans") now.last_core = now.state !== "idle" && now.estimate?.valid ? now.estimate : null;
  now.estimate = data;
  now.state = data.state;
  const closed = now.phases.findLast((phase) => phase.state === "closed");
  if (closed && data.state !== "idle" && data.run === now.run && data.time_s !== null) now.time_since_closing_s = Math.max(data.time_s - closed.from_s, 0);
  return true;
}

export const closingOf = (phases) => phases?.findLast((phase) => phase.state === "closed")?.from_s ?? 0;

// What the time axis counts from: before closing, from the run's first row.
export const countedFrom = (phases) => text(phases?.some((phase) => phase.state === "closed") ? "page-time-from-closing" : "page-time-axis");

export const shifted = (phases, zero) => (phases ?? []).map((phase) => ({ ...phase, from_s: phase.from_s - zero, to_s: phase.to_s === null ? null : phase.to_s - zero }));

// The look ahead on the run's clock, [[time, core, low, high], ...]: what an estimate brings, else what was there
// before; null where the core is not known.
export function courseOf({ valid, course, time_s: time, forecast_age_s: age }, before) {
  if (!valid) return null;
  return course && time !== null ? course.map(([t, ...core]) => [time - (age ?? 0) + t, ...core]) : before;
}

export const coreKey = () => key([
  { name: text("page-core-predicted"), colour: "--core" }, { name: text("page-band95"), class: "band" },
  { name: text("page-core-foreseen"), colour: "--core", class: "dashes" }]);

// Steps of a live time axis: nobody reads tenths of a second of a pressing that goes on.
export const WHOLE_SECONDS = [1, 10, 100, 1000].flatMap((ten) => [ten, 2 * ten, 5 * ten]);

// The core alone, on its own scale, from closing on: band, target, the opening advised, and what is foreseen.
export class CoreChart {
  constructor(place, { height, measured = [], keep = true, letters = 12 }) {
    this.chart = new TimeChart(place, {
      series: [{ name: "low", kind: "band-low" }, { name: "high", kind: "band-high" }, { name: text("page-core-predicted"), colour: "--core", kind: "core", spanGaps: true },
        { name: "low ahead", kind: "band-low", colour: "--core-ahead" }, { name: "high ahead", kind: "band-high", colour: "--core-ahead" },
        { name: text("page-core-foreseen"), colour: "--core", kind: "line", dash: [6, 5], spanGaps: true },
        ...measured.map((name) => ({ name, colour: "--measured", kind: "line" }))],
      height, keep, letters, label: text("page-chart-now-label"), xLabel: text("page-time-from-closing"), xSteps: WHOLE_SECONDS, release: text("page-follow"),
      yRange: (_, low, high) => this.range(low, high),
    });
  }

  // What rests on old readings foresees nothing, and is not green.
  show({ times, low, high, core, measured = [], phases, target, course, advice, notes = [], stale = false }) {
    const zero = closingOf(phases);
    this.chart.callX(countedFrom(phases));
    const now = times.at(-1) ?? 0;
    const to = stale ? [] : (course ?? []).filter(([time]) => time > now);
    const before = (values) => [...values, ...to.map(() => null)];
    const after = (k) => [...times.map((_, i) => (i === times.length - 1 && to.length ? [core, low, high][k - 1].findLast((v) => v !== null) ?? null : null)), ...to.map((row) => row[k])];
    this.target = target;
    const opens = advice?.open_in_s ?? null;
    this.chart.marks = [
      ...notes.map((note) => ({ ...note, x: note.x - zero })),
      ...(target === null ? [] : [{ y: target, name: `${text("page-target")} ${number(target, 0)} °C`, colour: stale ? "--faint" : "--good" }]),
      ...(opens === null || !to.length ? [] : [{ x: now + opens - zero, name: text("page-open-then"), colour: "--accent" }])];
    this.chart.set([[...times, ...to.map(([time]) => time)].map((t) => t - zero), before(low), before(high), before(core), after(2), after(3), after(1),
      ...measured.map(before)], shifted(phases, zero));
  }

  // Before the first core the target stands over 0 °C, not alone.
  range(low, high) {
    const all = [low, high, this.target].filter((value) => Number.isFinite(value));
    if (all.length === 1) all.push(0);
    const [least, most] = all.length ? [Math.min(...all), Math.max(...all)] : [0, 100];
    const room = (share) => Math.max(share * (most - least), 1);
    return [least - room(0.06), most + room(0.13)]; // above, the phases' names stand clear of the target
  }

  close() {
    this.chart.close();
  }
}
