// Press now: the core temperature large, the running pressing as a chart, every channel with its quality.
import { announce } from "../announce.js";
import { get } from "../api.js";
import { roleOf } from "../channels.js";
import { TimeChart, key } from "../charts.js";
import { clock, duration, el, number, reading } from "../dom.js";
import { effectName, said, text } from "../words.js";
import { sketch } from "./sketch.js";

const KEEP_ROWS = 20000;
const STALE_S = 5;
const FACTS_MS = 400;
const COLOURS = { platen: "--platen", top: "--top", bottom: "--bottom", core: "--measured", other: "--faint" };

export async function show(place, context) {
  const live = new LivePress(place, context);
  context.on("scan", (data) => live.scan(data));
  context.on("estimate", (data) => live.estimate(data));
  context.on("press", (data) => live.press(data));
  context.on("run", (data) => live.run(data));
  context.on("link", (state) => { if (state === "live") live.load().catch(() => {}); }); // the next poll asks again
  // Readings age from when they are shown, also while what is asked for next never comes.
  const timers = [setInterval(() => live.poll(), 2000), setInterval(() => live.now && live.showAge(), 1000)];
  const leave = () => { timers.forEach(clearInterval); live.closed = true; };
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
    Object.assign(this, { place, context, closed: false, now: null, chart: null, rows: null, loading: false });
  }

  async load() {
    if (this.loading) return;
    this.loading = true;
    try {
      const { items } = await get("/press");
      this.now = items.find((item) => item.press === this.context.press) ?? items[0] ?? null;
      if (this.closed) return;
      if (!this.now) {
        this.place.replaceChildren(el("div", { class: "card empty" }, el("h1", {}, text("page-no-press")), el("p", {}, text("page-no-press-hint"))));
        return;
      }
      this.hear();
      this.frame();
      await this.loadRun(this.now.run);
    } finally {
      this.loading = false;
    }
  }

  // Numbers that only the server can say (time to target, alarms), now and then.
  async poll() {
    if (document.hidden || this.loading) return;
    try {
      const { items } = await get("/press");
      const fresh = items.find((item) => item.press === this.now?.press);
      if (!fresh) { if (items.length) await this.load(); return; }
      if (this.closed) return;
      this.now = fresh;
      this.hear();
      this.facts();
      this.tiles();
      if (fresh.run !== this.shown) await this.loadRun(fresh.run);
    } catch { /* the link state says it */ }
  }

  frame() {
    this.state = el("span", { class: "pill", "data-testid": "state" });
    this.core = el("div", { class: "core", "data-testid": "core" });
    this.band = el("div", { class: "band", "data-testid": "band" });
    this.meter = el("i", {});
    this.sketch = el("div", { "aria-hidden": "true" });
    this.list = el("dl", { class: "facts" });
    this.grid = el("div", { class: "channels", "data-testid": "channels" });
    this.title = el("h2", {});
    this.canvas = el("div", {});
    this.warning = el("div", { class: "warning", role: "status", hidden: true });
    this.old = el("p", { class: "pill warn", role: "status", hidden: true });
    this.keys = el("div", {});
    this.place.replaceChildren(
      el("div", { class: "split" },
        this.hero = el("section", { class: "card hero", "aria-labelledby": "core-title" },
          el("div", { class: "row", style: "justify-content:space-between" }, el("h1", { id: "core-title" }, text("page-core-temperature")), this.state),
          this.old,
          this.warning,
          el("div", {}, this.core, this.band),
          el("div", { class: "bench", "aria-hidden": "true" }, this.meter),
          el("div", { class: "beside" }, this.sketch, this.list)),
        el("section", { class: "card", "aria-label": text("page-running-pressing") },
          el("div", { class: "head" }, this.title), this.canvas, this.keys)),
      el("section", { class: "card" }, el("h2", {}, text("page-channels")), this.grid));
    this.facts();
    this.tiles();
  }

  facts() {
    const { now } = this;
    this.state.className = `pill ${now.state}`;
    this.state.textContent = text(`page-state-${now.state}`);
    this.showCore(now.estimate);
    const target = now.target;
    const rows = [
      [text("page-time-since-closing"), now.time_since_closing_s === null ? "–" : duration(now.time_since_closing_s)],
      [text("page-target"), target ? `${number(target.temperature_C, 0)} °C` : "–"],
      [text("page-time-to-target"), !target ? "–" : target.reached ? text("page-reached") : timeToTarget(believed(now.estimate))],
      ...ahead(now.state, believed(now.estimate)),
      [text("page-run"), now.run ? el("a", { href: `#/runs/${encodeURIComponent(now.run)}` }, now.run) : "–"],
      [text("page-press"), now.press],
    ];
    this.showAge();
    this.showWarning();
    this.list.replaceChildren(...rows.flatMap(([name, value]) => [el("dt", {}, name), el("dd", {}, value)]));
    this.sketch.replaceChildren(sketch(now));
    const { core_C: core } = believed(now.estimate);
    const share = target && now.state !== "idle" && core ? (core - 20) / (target.temperature_C - 20) : 0;
    this.meter.style.width = `${Math.max(0, Math.min(1, share)) * 100}%`;
  }

  showCore(estimate = this.now.estimate) {
    const valid = this.now.state !== "idle" && estimate && estimate.valid && estimate.core_C !== null;
    this.core.className = valid ? "core" : "core invalid";
    this.core.replaceChildren(valid ? number(estimate.core_C, 1) : "–", el("small", {}, "°C"));
    this.band.textContent = valid
      ? `${number(estimate.core_low_C, 1)} … ${number(estimate.core_high_C, 1)} °C · ${text("page-band95")}`
      : this.now.state === "idle" ? text("page-no-panel") : reasonOf(estimate) || text("page-no-estimate");
  }

  showWarning() {
    const estimate = this.now.state === "idle" ? null : this.now.estimate;
    const { warning, warning_said: warningSaid } = believed(estimate);
    const suspected = estimate?.suspected;
    const lines = [warning && `⚠ ${said(warningSaid, warning)}`, suspected && `${text("page-suspected")}: ${effectName(suspected)}`].filter(Boolean);
    if (this.warning.textContent !== lines.join("")) this.warning.replaceChildren(...lines.map((line) => el("p", {}, line)));
    this.warning.hidden = !lines.length;
  }

  hear(age = Math.min(...this.now.channels.map((c) => c.age_s ?? Infinity))) {
    Object.assign(this, { age, heard: performance.now() });
  }

  // Old numbers must not look like new ones.
  showAge() {
    const stale = this.now.channels.length > 0 && this.age + (performance.now() - this.heard) / 1000 > STALE_S;
    this.hero.classList.toggle("stale", stale);
    this.grid.classList.toggle("stale", stale);
    this.old.hidden = !stale;
    if (stale) this.old.textContent = text("page-stale-since", { time: clock(this.now.channels[0].utc) });
  }

  tiles() {
    const nodes = this.now.channels.map((channel) => {
      const good = ["good", "simulated"].includes(channel.quality);
      return el("div", { class: good ? "channel" : "channel bad", style: `--dot: var(${COLOURS[channel.role]})` },
        el("div", { class: "name" }, el("span", {}, channel.name), good ? el("span", { class: "quality" }, text(`page-quality-${channel.quality}`)) : ""),
        el("b", {}, good ? reading(channel) : text(`page-quality-${channel.quality}`)));
    });
    this.grid.replaceChildren(...nodes);
  }

  async loadRun(run) {
    this.shown = run;
    if (!run) { this.title.textContent = text("page-waiting-for-pressing"); return; }
    const [samples, estimates, detail] = await Promise.all([
      get(`/runs/${encodeURIComponent(run)}/samples`, { max_points: 4000 }),
      get(`/runs/${encodeURIComponent(run)}/estimates`, { max_points: 4000 }),
      get(`/runs/${encodeURIComponent(run)}`),
    ]).catch((error) => { this.shown = undefined; throw error; }); // so that the next poll asks again
    if (this.closed || this.shown !== run) return;
    this.columns = Object.keys(samples.columns).filter((name) => name !== "closed");
    this.phases = detail.phases;
    this.rows = merge(samples, estimates, this.columns);
    this.draw();
  }

  draw() {
    const roles = Object.fromEntries(this.now.channels.map((channel) => [channel.name, channel.role]));
    const series = this.columns.map((name) => ({ name, colour: COLOURS[roles[name] ?? roleOf(name)], kind: roles[name] === "core" ? "line" : "thin" }));
    series.push({ name: "low", kind: "band-low" }, { name: "high", kind: "band-high" },
      { name: text("page-core-predicted"), colour: "--core", kind: "core", spanGaps: true });
    if (this.chart) this.chart.close();
    this.canvas.replaceChildren();
    this.chart = new TimeChart(this.canvas, { series, height: Math.max(300, Math.min(460, innerHeight * 0.5)), label: text("page-chart-now-label"), phases: this.phases });
    this.chart.set(this.rows, this.phases);
    const running = this.now.run_status === "open";
    this.title.textContent = `${text(running ? "page-running-pressing" : "page-last-pressing")} ${this.shown}`;
    this.keys.replaceChildren(key([
      { name: text("page-core-predicted"), colour: "--core" }, { name: text("page-band95"), class: "band" },
      { name: text("page-sensors-top"), colour: "--top" }, { name: text("page-sensors-bottom"), colour: "--bottom" },
      { name: text("page-platens"), colour: "--platen" }]));
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
    this.hear(0);
    this.soon("tiles");
    if (data.run !== this.shown || !this.rows || data.time_s === null) return;
    const times = this.rows[0];
    if (times.length && data.time_s <= times.at(-1)) return;
    times.push(data.time_s);
    this.columns.forEach((name, i) => this.rows[i + 1].push(data.temperatures_C[name] ?? null));
    for (let i = this.columns.length + 1; i < this.rows.length; i += 1) this.rows[i].push(null);
    if (times.length > KEEP_ROWS) this.rows.forEach((values) => values.splice(0, values.length - KEEP_ROWS));
    this.chart.set(this.rows, this.phases);
  }

  estimate(data) {
    if (data.press !== this.now?.press) return;
    this.now.estimate = data;
    const closed = this.phases?.findLast((phase) => phase.state === "closed");
    if (closed && data.run === this.shown && data.time_s !== null) this.now.time_since_closing_s = Math.max(data.time_s - closed.from_s, 0);
    this.soon("showCore");
    if (performance.now() - (this.told ?? 0) > FACTS_MS) { this.told = performance.now(); this.soon("facts"); }
    if (data.run !== this.shown || !this.rows) return;
    const row = lastAt(this.rows[0], data.time_s);
    if (row < 0 || !data.valid) return;
    const first = this.columns.length + 1;
    this.rows[first][row] = data.core_low_C;
    this.rows[first + 1][row] = data.core_high_C;
    this.rows[first + 2][row] = data.core_C;
    this.chart.set(this.rows, this.phases);
  }

  press(data) {
    if (data.press !== this.now?.press) return;
    announce(`${text("page-press")}: ${text(`page-state-${data.state}`)}`);
    this.poll();
    if (data.run && data.run === this.shown) {
      get(`/runs/${encodeURIComponent(data.run)}`).then((detail) => {
        this.phases = detail.phases;
        if (this.chart && !this.closed) this.chart.set(this.rows, this.phases);
      }).catch(() => {});
    }
  }

  run(data) {
    if (data.press === this.now?.press) this.poll();
  }

  // At most one redraw of the numbers a frame.
  soon(name) {
    this.work ??= new Set();
    if (this.work.has(name)) return;
    this.work.add(name);
    requestAnimationFrame(() => { this.work.delete(name); if (!this.closed) this[name](); });
  }
}

// Why there is no core: a code in plain words, whose words the catalogue has with hyphens.
function reasonOf(estimate) {
  return estimate?.reason && said({ code: `reason-${estimate.reason.replaceAll(" ", "-")}`, arguments: estimate.reason_arguments }, estimate.reason);
}

// What may be shown as a number: an estimate that is not valid foresees nothing either.
const believed = (estimate) => (estimate?.valid ? estimate : {});

const seconds = (value) => (value < 100 ? `${number(value, 0)} s` : duration(value));

function timeToTarget({ target_in_s: middle, target_earliest_s: earliest, target_latest_s: latest }) {
  if (middle === null || middle === undefined) return "–";
  const known = [earliest, latest].every((value) => value !== null && value !== undefined);
  return [seconds(middle), known ? el("span", { class: "faint range" }, ` ${number(earliest, 0)} … ${number(latest, 0)} s`) : ""];
}

// What the live sensor foresees beyond the target, where it says so.
function ahead(state, estimate) {
  if (state === "idle") return [];
  const facts = [["open_in_s", "page-open-in", (v) => (v > 0 ? text("page-in-time", { time: seconds(v) }) : text("page-at-once"))], ["peak_C", state === "closed" ? "page-peak-if" : "page-peak", (v) => `${number(v, 1)} °C`],
    ["limit_in_s", "page-limit-in", seconds], ["energy_kJ_m2", "page-energy", (v) => `${number(v, 0)} kJ/m²`]];
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
