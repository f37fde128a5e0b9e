// Loggers: each channel's last good time and faults, the processes, the store and how long its disk lasts.
import { get } from "../api.js";
import { bytes, clock, duration, el, number, table } from "../dom.js";
import { text } from "../text.js";

export async function show(place) {
  const holder = el("div", { class: "stack" });
  place.append(holder);
  const load = async () => {
    const [channels, health, events] = await Promise.all([get("/channels"), get("/health"), get("/events", { limit: 30 })]);
    holder.replaceChildren(el("div", { class: "pair" }, storeCard(health), processCard(health)), channelCard(channels.items), eventCard(events.items));
  };
  await load();
  const timer = setInterval(() => { if (!document.hidden) load().catch(() => {}); }, 3000);
  return () => clearInterval(timer);
}

function storeCard({ store, status }) {
  return el("section", { class: "card" }, el("div", { class: "head" }, el("h2", { style: "margin:0" }, text("store")), el("span", { class: `pill ${{ ok: "good", degraded: "warn", down: "bad" }[status]}` }, text(`health_${status}`))),
    el("dl", { class: "facts" }, [[text("kind"), store.kind], [text("size"), bytes(store.size_bytes)], [text("free"), bytes(store.free_bytes)],
      [text("hours_left"), store.hours_left === null ? "–" : duration(store.hours_left * 3600)]].flatMap(([name, value]) => [el("dt", {}, name), el("dd", {}, value)])));
}

function processCard({ processes }) {
  return el("section", { class: "card" }, el("h2", {}, text("processes")), table(text("processes"), [{ text: text("name") }, { text: text("status") }, { text: text("last_sign"), class: "right" }],
    processes.map((p) => [el("div", {}, p.name, p.message ? el("p", { class: "small faint" }, p.message) : ""), el("span", { class: `pill ${p.alive ? "good" : "bad"}` }, p.alive ? p.state : text("silent")),
      el("span", { class: "num" }, p.age_s === null ? "–" : text("ago").replace("{time}", duration(p.age_s)))])));
}

function channelCard(items) {
  const counters = [...new Set(items.flatMap((item) => Object.keys(item.counters)))];
  return el("section", { class: "card" }, el("h1", {}, text("nav_loggers")), items.length ? table(text("channels"),
    [{ text: text("channel") }, { text: text("logger"), class: "hide-narrow" }, { text: text("temperature"), class: "right" }, { text: text("quality") }, { text: text("last_good"), class: "right" },
      ...counters.map((name) => ({ text: text(`counter_${name}`) === `counter_${name}` ? name.replaceAll("_", " ") : text(`counter_${name}`), class: "right hide-narrow" }))],
    items.map((c) => [c.name, c.logger || "–", el("span", { class: "num" }, c.temperature_C === null ? "–" : `${number(c.temperature_C, 1)} °C`),
      el("span", { class: `pill ${["good", "simulated"].includes(c.quality) ? "good" : "bad"}` }, text(`quality_${c.quality}`)),
      el("span", { class: "num" }, clock(c.last_good_utc, false)), ...counters.map((name) => el("span", { class: "num" }, c.counters[name] === undefined ? "–" : number(c.counters[name], 0)))])) : el("p", { class: "faint" }, text("no_channels")));
}

function eventCard(items) {
  return el("section", { class: "card" }, el("h2", {}, text("events")), items.length ? table(text("events"), [{ text: text("when") }, { text: text("process"), class: "hide-narrow" }, { text: text("what") }],
    items.map((e) => [el("span", { class: "num" }, clock(e.utc)), e.process, el("span", {}, e.level === "info" ? "" : el("span", { class: `pill ${e.level === "alarm" ? "bad" : "warn"}` }, text(`level_${e.level}`)), " ", e.message)])) : el("p", { class: "faint" }, "–"));
}
