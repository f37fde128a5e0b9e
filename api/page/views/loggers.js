// Loggers: each channel's last good time and faults, the processes, the store and how long its disk lasts.
import { again, get } from "../api.js";
import { standing } from "../channels.js";
import { bytes, clock, clockToday, duration, el, number, reading, table } from "../dom.js";
import { has, inWords, text } from "../words.js";

export async function show(place) {
  const holder = el("div", { class: "stack" });
  const load = async () => {
    const [channels, health, events, presses] = await Promise.all([get("/channels"), get("/health"), get("/events", { limit: 200 }), get("/press")]);
    const silentAfter = Object.fromEntries(presses.items.map((one) => [one.press, one.silent_after_s]));
    const cards = [el("div", { class: "pair" }, storeCard(health), clockCard(health, channels.items, events.items)), channelCard(channels.items, (c) => c.age_s === null || c.age_s > silentAfter[c.press]), processCard(health)];
    const scrolled = holder.querySelector("[data-testid=loggers] .scroll")?.scrollLeft ?? 0;
    holder.replaceChildren(...cards);
    holder.querySelector("[data-testid=loggers] .scroll")?.scrollTo({ left: scrolled });
  };
  await load();
  place.append(holder);
  return again(load, 3000);
}

function storeCard({ store, status }) {
  return el("section", { class: "card" }, el("div", { class: "head" }, el("h2", { style: "margin:0" }, text("page-store")), el("span", { class: `pill ${{ ok: "good", degraded: "warn", down: "bad" }[status]}` }, text(`page-health-${status}`))),
    el("dl", { class: "facts" }, [[text("page-kind"), store.kind], [text("page-size"), bytes(store.size_bytes)], [text("page-free"), bytes(store.free_bytes)],
      ...(store.archive ? [[text("page-archive"), text("page-archive-holds", { runs: store.archive.runs, size: bytes(store.archive.bytes), unsound: store.archive.unsound })]] : []),
      [text("page-hours-left"), store.hours_left === null ? "–" : duration(store.hours_left * 3600)]].flatMap(([name, value]) => [el("dt", {}, name), el("dd", {}, value)])));
}

const named = (state) => (has(`page-process-${state}`) ? text(`page-process-${state}`) : state);

function processCard({ processes }) {
  return el("section", { class: "card" }, el("h2", {}, text("page-processes")), table(text("page-processes"), [{ text: text("page-name") }, { text: text("page-status") }, { text: text("page-last-sign"), class: "right" }],
    processes.map((p) => [el("div", {}, p.name, p.message ? el("p", { class: "small faint" }, p.message_said.map((one) => inWords(one)).join("; ") || p.message) : ""), el("span", { class: `pill ${p.alive || p.state === "done" ? "good" : "bad"}` }, p.alive || p.state === "done" ? named(p.state) : text("page-silent")),
      el("span", { class: "num" }, p.age_s === null ? "–" : text("page-ago", { time: duration(p.age_s) }))])));
}

function clockCard(health, channels, events) {
  const here = Math.round((Date.parse(health.utc) - Date.now()) / 100) / 10;
  const set = events.find((event) => event.message_said.code === "clock-set");
  const ages = channels.map((channel) => channel.age_s).filter((age) => age !== null);
  return el("section", { class: "card" }, el("h2", {}, text("page-clock")),
    el("dl", { class: "facts" }, [[text("page-newest-scan"), ages.length ? text("page-ago", { time: duration(Math.max(Math.min(...ages), 0)) }) : "–"],
      [text("page-clock-here"), `${here > 0 ? "+" : here < 0 ? "−" : ""}${number(Math.abs(here), 1)} s`],
      [text("page-clock-set"), set ? `${clock(set.utc)} ${set.message_said.arguments.sign}${number(set.message_said.arguments.seconds, 1)} s` : text("page-clock-never")]].flatMap(([name, value]) => [el("dt", {}, name), el("dd", {}, value)])));
}

// Drivers count many causes; the ones with a name of their own here are those a technician asks for.
const COUNTED = { "page-readings": ["good"], "page-timeouts": ["silent"], "page-reconnects": ["port lost", "closed"], "page-crc-errors": ["crc"] };

// What was read last is neither good nor bad once nothing is read.
function quality(channel, old) {
  const { good, words } = standing(channel.quality, channel.left_out_K);
  return el("span", { class: `pill wraps ${old ? "idle" : good ? "good" : "bad"}` }, words);
}

function channelCard(items, old) {
  const of = (c, causes) => causes.reduce((sum, cause) => sum + (c.counters[cause] ?? 0), 0);
  const named = Object.values(COUNTED).flat();
  const several = new Set(items.map((c) => c.press)).size > 1; // whose channels may have the same names
  const others = (c) => Object.entries(c.counters).filter(([cause]) => !named.includes(cause));
  return el("section", { class: "card", "data-testid": "loggers" }, el("h1", {}, text("page-nav-loggers")), items.length ? table(text("page-channels"),
    [{ text: text("page-channel") }, { text: text("page-logger") }, { text: text("page-value"), class: "right" }, { text: text("page-quality") }, { text: text("page-last-good"), class: "right" }, { text: text("page-gaps"), class: "right" },
      ...Object.keys(COUNTED).map((name) => ({ text: text(name), class: "right" })), { text: text("page-other-faults"), class: "right" }],
    items.map((c) => [several ? el("div", {}, c.name, el("p", { class: "small faint" }, c.press)) : c.name, c.logger || "–", el("span", { class: old(c) ? "num faint" : "num" }, c.value === null ? "–" : reading(c)),
      quality(c, old(c)),
      el("span", { class: "num" }, clockToday(c.last_good_utc)), count(c.gaps_last_hour),
      ...Object.entries(COUNTED).map(([name, causes]) => count(of(c, causes), name === "page-readings")),
      el("span", { title: others(c).map(([cause, n]) => `${text(`cause-${cause.replaceAll(" ", "-")}`)}: ${n}`).join(", ") }, count(others(c).reduce((sum, [, n]) => sum + n, 0)))]), { cards: true }) : el("p", { class: "faint" }, text("page-no-channels")));
}

const count = (value, usual = false) => el("span", { class: value && !usual ? "num warn-text" : "num" }, number(value, 0));
