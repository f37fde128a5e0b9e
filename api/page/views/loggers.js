// Loggers: each channel's last good time and faults, the processes, the store and how long its disk lasts.
import { get } from "../api.js";
import { bytes, clock, duration, el, number, reading, table, when } from "../dom.js";
import { sentence } from "../sentences.js";
import { text } from "../text.js";

export async function show(place) {
  const holder = el("div", { class: "stack" });
  place.append(holder);
  const load = async () => {
    const [channels, health, events] = await Promise.all([get("/channels"), get("/health"), get("/events", { limit: 200 })]);
    const cards = [el("div", { class: "pair" }, storeCard(health), clockCard(health, channels.items, events.items)), channelCard(channels.items), processCard(health), eventCard(events.items.slice(0, 30))];
    const scrolled = holder.querySelector("[data-testid=loggers] .scroll")?.scrollLeft ?? 0;
    holder.replaceChildren(...cards);
    holder.querySelector("[data-testid=loggers] .scroll")?.scrollTo({ left: scrolled });
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

const named = (state) => (text(`process_${state}`) === `process_${state}` ? state : text(`process_${state}`));

function processCard({ processes }) {
  return el("section", { class: "card" }, el("h2", {}, text("processes")), table(text("processes"), [{ text: text("name") }, { text: text("status") }, { text: text("last_sign"), class: "right" }],
    processes.map((p) => [el("div", {}, p.name, p.message ? el("p", { class: "small faint" }, sentence(p.message)) : ""), el("span", { class: `pill ${p.alive || p.state === "done" ? "good" : "bad"}` }, p.alive || p.state === "done" ? named(p.state) : text("silent")),
      el("span", { class: "num" }, p.age_s === null ? "–" : text("ago").replace("{time}", duration(p.age_s)))])));
}

function clockCard(health, channels, events) {
  const here = Math.round((Date.parse(health.utc) - Date.now()) / 100) / 10;
  const set = events.find((event) => event.message.startsWith("the clock of this machine was set"));
  const ages = channels.map((channel) => channel.age_s).filter((age) => age !== null);
  return el("section", { class: "card" }, el("h2", {}, text("clock")),
    el("dl", { class: "facts" }, [[text("newest_scan"), ages.length ? text("ago").replace("{time}", duration(Math.max(Math.min(...ages), 0))) : "–"],
      [text("clock_here"), `${here > 0 ? "+" : here < 0 ? "−" : ""}${number(Math.abs(here), 1)} s`],
      [text("clock_set"), set ? `${clock(set.utc)} ${/by ([+-][\d.]+ s)/.exec(set.message)?.[1] ?? ""}` : text("clock_never")]].flatMap(([name, value]) => [el("dt", {}, name), el("dd", {}, value)])));
}

// Drivers count many causes; the ones with a name of their own here are those a technician asks for.
const COUNTED = { readings: ["good"], timeouts: ["silent"], reconnects: ["port lost", "closed"], crc_errors: ["crc"] };

function channelCard(items) {
  const of = (c, causes) => causes.reduce((sum, cause) => sum + (c.counters[cause] ?? 0), 0);
  const named = Object.values(COUNTED).flat();
  const others = (c) => Object.entries(c.counters).filter(([cause]) => !named.includes(cause));
  return el("section", { class: "card", "data-testid": "loggers" }, el("h1", {}, text("nav_loggers")), items.length ? table(text("channels"),
    [{ text: text("channel") }, { text: text("logger") }, { text: text("value"), class: "right" }, { text: text("quality") }, { text: text("last_good"), class: "right" }, { text: text("gaps"), class: "right" },
      ...Object.keys(COUNTED).map((name) => ({ text: text(name), class: "right" })), { text: text("other_faults"), class: "right" }],
    items.map((c) => [c.name, c.logger || "–", el("span", { class: "num" }, c.value === null ? "–" : reading(c)),
      el("span", { class: `pill ${["good", "simulated"].includes(c.quality) ? "good" : "bad"}` }, text(`quality_${c.quality}`)),
      el("span", { class: "num" }, clock(c.last_good_utc, false)), count(c.gaps_last_hour),
      ...Object.entries(COUNTED).map(([name, causes]) => count(of(c, causes), name === "readings")),
      el("span", { title: others(c).map(([cause, n]) => `${text(`cause_${cause.replaceAll(" ", "_")}`)}: ${n}`).join(", ") }, count(others(c).reduce((sum, [, n]) => sum + n, 0)))]), { cards: true }) : el("p", { class: "faint" }, text("no_channels")));
}

const count = (value, usual = false) => el("span", { class: value && !usual ? "num warn-text" : "num" }, number(value, 0));

function eventCard(items) {
  return el("section", { class: "card" }, el("h2", {}, text("events")), items.length ? table(text("events"), [{ text: text("when") }, { text: text("process"), class: "hide-narrow" }, { text: text("what") }],
    items.map((e) => [when(e.utc), e.process, el("span", {}, e.level === "info" ? "" : el("span", { class: `pill ${e.level === "alarm" ? "bad" : "warn"}` }, text(`level_${e.level}`)), " ", sentence(e.message))])) : el("p", { class: "faint" }, "–"));
}
