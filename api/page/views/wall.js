// The wall: core, the one answer, press state and one health light, to be read from four metres.
import { again, get } from "../api.js";
import { duration, el } from "../dom.js";
import { text } from "../words.js";
import { CoreChart, LastCore, courseOf, showAnswer, showCore, showLight, showPeak, stateOf, targetOf, take } from "./answer.js";

export async function show(place, context, [press]) {
  const wall = new Wall(place, context, press ?? context.press);
  context.on("estimate", (data) => wall.estimate(data));
  context.on("press", () => wall.ask());
  document.documentElement.toggleAttribute("data-wall", true);
  const leaveByKey = (event) => { if (event.key === "Escape" && !document.fullscreenElement) location.hash = "#/now"; };
  document.addEventListener("keydown", leaveByKey);
  const ageing = setInterval(() => wall.now && wall.showAge(), 1000);
  const leave = again(() => wall.ask(), 2000);
  await wall.ask();
  return () => {
    leave();
    clearInterval(ageing);
    document.removeEventListener("keydown", leaveByKey);
    for (const name of ["data-wall", "data-stale"]) document.documentElement.removeAttribute(name);
    wall.chart?.close();
    wall.left = true;
  };
}

class Wall {
  constructor(place, context, press) {
    Object.assign(this, { context, press, now: null, rows: null, shown: null, left: false, last: new LastCore() });
    this.core = el("div", { class: "core", "data-testid": "core" });
    this.band = el("div", { class: "band", "data-testid": "band" });
    this.answer = el("div", { class: "answer", "data-testid": "answer", role: "status" });
    this.peak = el("div", { class: "band", "data-testid": "peak", hidden: true });
    this.state = el("span", { class: "pill", "data-testid": "state" });
    this.light = el("span", { class: "light", "data-testid": "health", role: "status" });
    this.since = el("span", { class: "num" });
    this.chartPlace = el("div", { class: "wall-chart" });
    const whole = el("button", { type: "button", class: "quiet", onclick: () => document.documentElement.requestFullscreen?.() }, text("page-full-screen"));
    place.replaceChildren(el("section", { class: "wall", "aria-labelledby": "wall-title" },
      el("div", { class: "wall-head" }, el("h1", { id: "wall-title" }, press ?? "Kerntemp"), this.state, this.since, this.light, whole, el("a", { href: "#/now", class: "quiet" }, text("page-back"))),
      el("div", { class: "wall-core" }, this.core, this.band), el("div", { class: "wall-said" }, this.answer, this.peak), this.chartPlace));
  }

  async ask() {
    try {
      const [{ items }, health] = await Promise.all([get("/press", { press: this.press ?? "" }), get("/health")]);
      if (this.left || !items.length) return;
      this.now = items[0];
      this.health = health;
      this.age = Math.min(...this.now.channels.map((c) => c.age_s ?? Infinity));
      this.received = performance.now();
      if (this.now.run !== this.shown) await this.load();
      this.draw();
    } catch { /* showAge says how old what is shown is */ }
  }

  async load() {
    this.shown = this.now.run;
    this.course = null;
    this.rows = null; // what comes meanwhile is among what is asked for
    if (!this.shown) return;
    const estimates = await get(`/runs/${encodeURIComponent(this.shown)}/estimates`, { max_points: 2000 });
    this.rows = [[], [], [], []];
    estimates.time_s.forEach((time, i) => { if (estimates.valid[i]) this.keep(time, estimates.core_low_C[i], estimates.core_high_C[i], estimates.core_C[i]); });
    this.chart?.close();
    this.chartPlace.replaceChildren();
    const letters = Math.max(12, 0.024 * Math.min(innerWidth, innerHeight)); // grow with the screen, as all letters of the wall
    this.chart = new CoreChart(this.chartPlace, { height: Math.max(this.chartPlace.clientHeight - 6, 120), keep: false, letters });
  }

  keep(...row) {
    if (!this.rows || (this.rows[0].length && row[0] <= this.rows[0].at(-1))) return;
    row.forEach((value, i) => this.rows[i].push(value));
  }

  estimate(data) {
    if (data.press !== this.now?.press || this.left) return;
    const taken = take(this.now, data);
    if (taken && data.valid) Object.assign(this, { age: data.age_s, received: performance.now() });
    if (taken && data.run === this.shown) this.course = courseOf(data, this.course);
    if (data.run === this.shown && data.valid && data.time_s !== null) this.keep(data.time_s, data.core_low_C, data.core_high_C, data.core_C);
    if (this.work) return;
    this.work = requestAnimationFrame(() => { this.work = 0; if (!this.left) this.draw(); });
  }

  draw() {
    const { now } = this;
    const last = now.run && now.run_status !== "open"; // what is drawn is no running pressing
    this.since.textContent = last ? `${text("page-last-pressing")} ${now.run}` : now.state !== "closed" || now.time_since_closing_s === null ? "" : duration(now.time_since_closing_s);
    this.showAge();
    this.drawChart();
  }

  drawChart() {
    this.chartPlace.style.visibility = this.rows?.[0].length ? "" : "hidden"; // before the first core its axes would stand alone
    if (!this.chart || !this.rows) return;
    const { now } = this;
    this.chart.chart.fit(this.chartPlace.clientHeight - 6);
    const [times, low, high, core] = this.rows;
    this.chart.show({ times, low, high, core, phases: now.phases, target: targetOf(now), course: now.state === "closed" ? this.course : null, advice: now.estimate?.advice, stale: this.stale });
  }

  showAge() {
    const silent = this.age + (performance.now() - this.received) / 1000;
    const stale = silent > this.now.silent_after_s;
    const core = this.last.of(this.now, stale);
    showCore(this.core, this.band, core.state, core.estimate, core);
    document.documentElement.toggleAttribute("data-stale", stale);
    if (stale !== this.stale) {
      this.stale = stale;
      this.drawChart();
    }
    const state = stateOf(this.now, stale);
    this.state.className = `pill ${state}`;
    this.state.textContent = text(`page-state-${state}`);
    showAnswer(this.answer, this.now, stale ? silent : null);
    showPeak(this.peak, this.now, stale ? silent : null);
    showLight(this.light, { now: this.now, health: this.health, silent: stale ? silent : null, link: this.context.live });
  }
}
