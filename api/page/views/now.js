// Press now: the core temperature large, the running pressing as a chart, every channel with its quality.
import { healthNow, leaveToView } from "../alarmbar.js";
import { announce } from "../announce.js";
import { again, get } from "../api.js";
import { COLOURS, facesOf, groupName, roleOf, standing } from "../channels.js";
import { TimeChart, key } from "../charts.js";
import { BRIDGE_S } from "../keep.js";
import { asOf, clock, duration, el, number, reading } from "../dom.js";
import { causeOf, isAbout } from "../silence.js";
import { effectName, inWords, text } from "../words.js";
import { CoreChart, LastCore, WHOLE_SECONDS, believed, closingOf, coreKey, countedFrom, courseOf, cureOf, seconds, shifted, showAnswer, showCore, showPeak, stateOf, steamOf, take, targetOf, whySilent } from "./answer.js";
import { notesOf } from "./journal.js";
import { PanelCards } from "./panel.js";
import { sketch } from "./sketch.js";

const KEEP_ROWS = 20000;
const FACTS_MS = 400;

export async function show(place, context) {
  const live = new LivePress(place, context);
  context.on("scan", (data) => live.scan(data));
  context.on("estimate", (data) => live.estimate(data));
  context.on("press", (data) => live.press(data));
  context.on("run", (data) => live.run(data));
  context.on("link", (state) => { if (state === "live") live.load().catch(() => {}); }); // the next poll asks again
  // Readings age from when they are shown, also while what is asked for next never comes.
  const ageing = setInterval(() => live.now && !live.closed && live.showAge(), 1000);
  const stop = again(() => live.poll(), 2000);
  const leave = () => { stop(); clearInterval(ageing); live.left = true; document.documentElement.removeAttribute("data-stale"); };
  try {
    await live.load();
  } catch (error) {
    leave();
    throw error;
  }
  return leave;
}

class LivePress {
  constructor(place, context) {
    Object.assign(this, { place, context, left: false, now: null, chart: null, rows: null, loading: false, last: new LastCore() });
  }

  // Also where another view was asked for before this one had its first answer.
  get closed() {
    return this.left || !this.place.isConnected;
  }

  async load() {
    if (this.loading) return;
    this.loading = true;
    try {
      const { items } = await get("/press", { press: this.context.press });
      this.now = items.find((item) => item.press === this.context.press) ?? items[0] ?? null;
      if (this.closed) return;
      if (!this.now) {
        this.panel = null;
        this.place.replaceChildren(el("div", { class: "card empty" }, el("h1", {}, text("page-no-press")), el("p", {}, text("page-no-press-hint"))));
        return;
      }
      this.hear();
      if (this.panel?.press === this.now.press) this.refresh(); // what somebody has begun to type there stays
      else this.frame();
      await this.loadRun(this.now.run);
    } finally {
      this.loading = false;
    }
  }

  // Numbers that only the server can say (time to target, alarms), now and then.
  async poll() {
    if (document.hidden || this.loading) return;
    try {
      const { items } = await get("/press", { press: this.context.press });
      const fresh = items.find((item) => item.press === this.now?.press);
      if (!fresh) { if (items.length) await this.load(); return; }
      if (this.closed) return;
      this.now = fresh;
      this.hear();
      this.refresh();
      if (fresh.run !== this.shown) await this.loadRun(fresh.run);
    } catch { /* the link state says it */ }
  }

  frame() {
    this.drawn = null;
    this.state = el("span", { class: "pill", "data-testid": "state" });
    this.core = el("div", { class: "core", "data-testid": "core" });
    this.band = el("div", { class: "band", "data-testid": "band" });
    this.answer = el("div", { class: "answer", "data-testid": "answer", role: "status" });
    this.peak = el("div", { class: "band", "data-testid": "peak", hidden: true });
    this.meter = el("i", {});
    this.sketch = el("div", { "aria-hidden": "true" });
    this.list = el("dl", { class: "facts" });
    this.grid = el("div", { class: "channels", "data-testid": "channels" });
    this.title = el("h2", { id: "pressing-title" });
    [this.canvas, this.faces, this.keys, this.faceKeys] = [0, 1, 2, 3].map(() => el("div", {}));
    this.behind = el("p", { class: "small warn-text", role: "status", hidden: true, "data-testid": "behind" });
    this.lacking = el("p", { class: "small warn-text", role: "status", hidden: true, "data-testid": "lacking" });
    this.warning = el("div", { class: "warning", role: "status", hidden: true });
    this.old = el("p", { class: "banner", role: "status", hidden: true });
    this.place.replaceChildren(this.old,
      el("div", { class: "split" },
        this.hero = el("section", { class: "card hero", "aria-labelledby": "core-title" },
          el("div", { class: "row", style: "justify-content:space-between" }, el("h1", { id: "core-title" }, text("page-core-temperature")), this.state),
          el("div", {}, this.core, this.band),
          this.answer, this.peak,
          this.warning,
          this.bench = el("div", { class: "bench", "aria-hidden": "true" }, this.meter),
          el("div", { class: "beside" }, this.sketch, this.list),
          el("p", { class: "small" }, el("a", { href: "#/wall" }, text("page-wall")))),
        this.charts = el("section", { class: "card", "aria-labelledby": "pressing-title" },
          el("div", { class: "head" }, this.title), this.lacking,
          this.curves = el("div", { hidden: true }, this.canvas, this.keys, this.behind,
            el("h2", { class: "sub" }, text("page-faces-and-platens")), this.faces, this.faceKeys))),
      this.panels = el("div", { class: "pair" }),
      el("section", { class: "card" }, el("h2", {}, text("page-channels"), this.read = el("span", { class: "small faint as-of" })), this.grid));
    this.panel = new PanelCards(this.panels, this.now.press);
    this.refresh();
  }

  refresh() {
    this.facts();
    this.tiles();
  }

  facts() {
    const { now } = this;
    this.showAge();
    this.showCore();
    const target = now.target, deciding = targetOf(now);
    const rows = [
      [text("page-time-since-closing"), now.time_since_closing_s === null ? "–" : duration(now.time_since_closing_s)],
      [text("page-target"), target ? text(deciding === null ? "page-target-not-deciding" : "page-target-value", { target: target.temperature_C }) : "–"],
      ...(this.stale ? [] : ahead(now.state, believed(now.estimate))), // nothing is foreseen from old readings
      [text("page-run"), now.run ? el("a", { href: `#/runs/${encodeURIComponent(now.run)}` }, now.run) : "–"],
      [text("page-press"), now.press],
    ];
    this.showTitle();
    this.showWarning();
    this.panel.show(now);
    this.list.replaceChildren(...rows.flatMap(([name, value]) => [el("dt", {}, name), el("dd", {}, value)]));
    this.sketch.replaceChildren(sketch(now));
    const { core_C: core } = believed(now.estimate);
    this.bench.hidden = deciding === null; // a bar that never fills
    const share = deciding !== null && now.state !== "idle" && core ? (core - 20) / (deciding - 20) : 0;
    this.meter.style.width = `${Math.max(0, Math.min(1, share)) * 100}%`;
  }

  showState() {
    const state = stateOf(this.now, this.stale);
    this.state.className = `pill ${state}`;
    this.state.textContent = text(`page-state-${state}`);
    this.sketch.hidden = state === "unknown"; // it would be drawn where nobody knows it to stand
  }

  showCore() {
    const core = this.last.of(this.now, this.stale);
    showCore(this.core, this.band, core.state, core.estimate, core);
    this.showState();
    this.showAnswer();
  }

  showAnswer() {
    const silent = this.stale ? this.silentFor() : null;
    showAnswer(this.answer, this.now, silent, { banner: true });
    showPeak(this.peak, this.now, silent);
  }

  showWarning() {
    const estimate = this.now.state === "idle" ? null : this.now.estimate;
    const { warning, warning_said: warningSaid } = believed(estimate);
    const suspected = estimate?.suspected;
    const lines = [warning && `⚠ ${inWords(warningSaid, warning)}`, suspected && `${text("page-suspected")}: ${effectName(suspected)}`].filter(Boolean);
    if (this.warning.textContent !== lines.join("")) this.warning.replaceChildren(...lines.map((line) => el("p", {}, line)));
    this.warning.hidden = !lines.length;
  }

  hear(age = Math.min(...this.now.channels.map((c) => c.age_s ?? Infinity))) {
    Object.assign(this, { age, received: performance.now() });
  }

  silentFor() {
    return this.age + (performance.now() - this.received) / 1000;
  }

  // Old numbers must not look like new ones: one banner, nothing green, every number grey with its age.
  showAge() {
    const before = this.stale;
    this.stale = this.now.channels.length > 0 && this.silentFor() > this.now.silent_after_s;
    if (this.stale !== before) this.factsSoon();
    if (this.stale !== before && this.drawn) this.redraw();
    document.documentElement.toggleAttribute("data-stale", this.stale);
    this.showState();
    this.old.hidden = !this.stale;
    leaveToView(this.place, this.stale ? (said, health) => isAbout(said, health, this.now.press, this.context.live) : undefined);
    const { utc } = this.now.channels[0] ?? {};
    this.read.textContent = this.stale && utc ? asOf(utc) : "";
    if (this.stale) this.showSilence(utc);
  }

  // A screen reader hears it once; how long it has been is there to be looked at.
  showSilence(utc) {
    const silent = this.silentFor();
    const cause = causeOf(healthNow(), this.now.press, this.context.live);
    const [said, ago] = silent === Infinity ? [whySilent(silent), ""] : [text("page-stale-since", { time: clock(utc) }), ` (${text("page-ago", { time: duration(silent) })})`];
    const parts = [said, ago, cause && `. ${cause}`];
    if (!this.old.children.length) this.old.append(...parts.map((_, i) => el("span", { "aria-live": i === 1 ? "off" : null })));
    parts.forEach((part, i) => { if (this.old.children[i].textContent !== part) this.old.children[i].textContent = part; });
    this.showAnswer();
  }

  tiles() {
    const nodes = this.now.channels.map((channel) => {
      const { read, good, words } = standing(channel.quality, this.now.estimate?.left_out?.[channel.name]);
      return el("div", { class: good ? "channel" : "channel bad", style: `--dot: var(${COLOURS[channel.role]})` },
        el("div", { class: "name" }, el("span", {}, channel.name), good ? el("span", { class: "quality" }, words) : ""),
        el("b", {}, read ? reading(channel) : words),
        read && !good ? el("div", { class: "small bad-text" }, words) : "");
    });
    this.grid.replaceChildren(...nodes);
  }

  // The pressing whose curves are shown; one that has ended since is the last, not the running one, nor is one of which
  // nobody knows whether it still runs.
  showTitle() {
    const { run, run_status: status } = this.now;
    const shown = this.drawn ?? run; // its curves may be on their way yet
    const code = shown === run && status === "open" && !this.stale ? "page-running-pressing" : "page-last-pressing";
    this.title.textContent = shown ? `${text(code)} ${shown}` : text("page-waiting-for-pressing");
    this.curves.hidden = !this.drawn;
  }

  // A part somebody looks at stays until "follow" is pressed, also when the next pressing has begun.
  get held() {
    return Boolean(this.drawn) && [this.chart?.chart, this.faceChart].some((chart) => chart?.held);
  }

  async loadRun(run) {
    this.missed = this.held;
    if (this.missed) return;
    this.shown = run;
    if (!run) { this.lacking.hidden = true; return; }
    const [samples, estimates, detail] = await Promise.all([
      get(`/runs/${encodeURIComponent(run)}/samples`, { max_points: 4000 }),
      get(`/runs/${encodeURIComponent(run)}/estimates`, { max_points: 4000 }),
      get(`/runs/${encodeURIComponent(run)}`),
    ]).catch((error) => this.lacksCurves(error));
    if (!detail || this.closed || this.shown !== run) return;
    this.lacking.hidden = true;
    this.columns = Object.keys(samples.columns).filter((name) => name !== "closed");
    this.phases = detail.phases;
    this.notes = notesOf(detail);
    this.course = null;
    this.reached = estimates.time_s.at(-1) ?? samples.time_s[0];
    this.rows = merge(samples, estimates, this.columns);
    this.draw();
  }

  // The core and the channels stand without them; the next poll asks again.
  lacksCurves(error) {
    this.shown = undefined;
    this.lacking.hidden = false;
    this.lacking.textContent = text("page-curves-missing", { why: error.message });
    return [];
  }

  draw() {
    const role = (name) => this.now.channels.find((channel) => channel.name === name)?.role ?? roleOf(name);
    this.inner = this.columns.filter((name) => role(name) === "core");
    this.outer = this.columns.filter((name) => role(name) !== "core");
    for (const chart of [this.chart, this.faceChart]) chart?.close();
    this.canvas.replaceChildren();
    this.faces.replaceChildren();
    this.curves.hidden = false; // a chart is as wide as its place
    const height = Math.max(240, Math.min(380, innerHeight * 0.4));
    this.chart = new CoreChart(this.canvas, { height, measured: this.inner });
    this.faceChart = new TimeChart(this.faces, {
      series: this.outer.map((name) => ({ name, colour: COLOURS[role(name)], kind: "thin", group: groupName(role(name)) })),
      height: 200, label: text("page-faces-and-platens"), xLabel: text("page-time-from-closing"), xSteps: WHOLE_SECONDS, release: text("page-follow"),
    });
    for (const chart of [this.chart.chart, this.faceChart]) chart.onFollow = () => this.missed && this.loadRun(this.now.run);
    this.redraw();
    this.drawn = this.shown;
    this.showTitle();
    this.keys.replaceChildren(coreKey());
    this.faceKeys.replaceChildren(key([
      { name: text("page-sensors-top"), colour: "--top" }, { name: text("page-sensors-bottom"), colour: "--bottom" },
      { name: text("page-platens"), colour: "--platen" }]));
  }

  redraw() {
    const first = this.columns.length + 1;
    const column = (name) => this.rows[this.columns.indexOf(name) + 1];
    const zero = closingOf(this.phases);
    this.chart.show({
      times: this.rows[0], low: this.rows[first], high: this.rows[first + 1], core: this.rows[first + 2], measured: this.inner.map(column),
      phases: this.phases, target: targetOf(this.now), course: this.shown === this.now.run && this.now.state === "closed" ? this.course : null, advice: this.now.estimate?.advice, notes: this.notes, stale: this.stale,
    });
    this.faceChart.callX(countedFrom(this.phases));
    this.faceChart.set([this.rows[0].map((t) => t - zero), ...this.outer.map(column)], shifted(this.phases, zero));
    this.showBehind();
  }

  // Why the core's curve ends before those of the readings.
  showBehind() {
    const behind = this.rows[0].at(-1) - this.reached;
    this.behind.hidden = !(behind > BRIDGE_S);
    if (!this.behind.hidden) this.behind.textContent = text("page-core-behind", { time: seconds(behind) });
  }

  scan(data) {
    if (data.press !== this.now?.press) return;
    for (const channel of this.now.channels) {
      if (channel.name in data.temperatures_C) {
        channel.value = data.temperatures_C[channel.name];
        channel.quality = data.qualities[channel.name] ?? "good";
      }
    }
    for (const channel of this.now.channels) channel.utc = data.utc;
    this.now.faces = facesOf(this.now); // else sketch and next panel would stand two seconds behind the tiles
    this.hear(0);
    this.soon("tiles");
    this.factsSoon();
    if (data.run !== this.shown || !this.rows || data.time_s === null) return;
    const times = this.rows[0];
    if (times.length && data.time_s <= times.at(-1)) return;
    times.push(data.time_s);
    this.columns.forEach((name, i) => this.rows[i + 1].push(data.temperatures_C[name] ?? null));
    for (let i = this.columns.length + 1; i < this.rows.length; i += 1) this.rows[i].push(null);
    if (times.length > KEEP_ROWS) this.rows.forEach((values) => values.splice(0, values.length - KEEP_ROWS));
    this.redraw();
  }

  estimate(data) {
    if (data.press !== this.now?.press) return;
    if (take(this.now, data) && data.run === this.shown) this.course = courseOf(data, this.course);
    this.soon("showCore");
    this.factsSoon();
    if (data.run !== this.shown || !this.rows) return;
    this.reached = Math.max(this.reached, data.time_s ?? this.reached);
    const row = lastAt(this.rows[0], data.time_s);
    if (row < 0 || !data.valid) return;
    const first = this.columns.length + 1;
    this.rows[first][row] = data.core_low_C;
    this.rows[first + 1][row] = data.core_high_C;
    this.rows[first + 2][row] = data.core_C;
    this.redraw();
  }

  press(data) {
    if (data.press !== this.now?.press) return;
    announce(`${text("page-press")}: ${text(`page-state-${data.state}`)}`);
    this.poll();
    if (data.run && data.run === this.shown) {
      get(`/runs/${encodeURIComponent(data.run)}`).then((detail) => {
        this.phases = detail.phases;
        if (this.chart && !this.closed) this.redraw();
      }).catch(() => {});
    }
  }

  run(data) {
    if (data.press === this.now?.press) this.poll();
  }

  // What stands beside the core, now and then; the last change is never left out.
  factsSoon() {
    this.due ??= setTimeout(() => { this.due = null; if (!this.closed) this.facts(); }, FACTS_MS);
  }

  // At most one redraw of the numbers a frame.
  soon(name) {
    this.work ??= new Set();
    if (this.work.has(name)) return;
    this.work.add(name);
    requestAnimationFrame(() => { this.work.delete(name); if (!this.closed) this[name](); });
  }
}

// The two kinds of doubt that make up most of the band.
function bandFrom(shares) {
  const most = Object.entries(shares).filter(([, share]) => share >= 0.1).sort((a, b) => b[1] - a[1]).slice(0, 2);
  return most.map(([kind, share]) => `${text(`page-band-from-${kind}`)} ${number(100 * share, 0)}\u00a0%`).join(", ");
}

// What the live sensor foresees beside the advice, where it says so.
function ahead(state, estimate) {
  if (state === "idle") return [];
  const facts = [["limit_in_s", "page-limit-in", seconds], ["energy_kJ_m2", "page-energy", (v) => `${number(v, 0)} kJ/m²`], ["cure_low", "page-cure", (v) => cureOf(v, estimate.grade)], ["steam_high_kPa", "page-steam", steamOf], ["band_from", "page-band-from", bandFrom]];
  return facts.filter(([key]) => estimate[key] !== null && estimate[key] !== undefined).map(([key, name, shown]) => [text(name), shown(estimate[key])]);
}

function merge(samples, estimates, columns) {
  const rows = [[...samples.time_s], ...columns.map((name) => [...samples.columns[name]]), [], [], []];
  const first = columns.length + 1;
  for (let i = first; i < rows.length; i += 1) rows[i] = new Array(rows[0].length).fill(null);
  let j = 0;
  estimates.time_s.forEach((time, i) => {
    if (!estimates.valid[i]) return;
    while (j < rows[0].length - 1 && rows[0][j] < time - 1e-6) j += 1;
    rows[first][j] = estimates.core_low_C[i];
    rows[first + 1][j] = estimates.core_high_C[i];
    rows[first + 2][j] = estimates.core_C[i];
  });
  return rows;
}

function lastAt(times, time) {
  for (let i = times.length - 1; i >= 0 && i >= times.length - 400; i -= 1) {
    if (Math.abs(times[i] - time) < 1e-6) return i;
  }
  return -1;
}
