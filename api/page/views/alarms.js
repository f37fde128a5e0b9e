// Alarms: what stands, who has taken it on, the limits of the press, and how this browser announces new ones.
import { announce } from "../announce.js";
import { again, get, post, put } from "../api.js";
import { wanted, want } from "../bell.js";
import { clock, el, table, when, written } from "../dom.js";
import { onTaken, taken } from "../tabs.js";
import { inFieldWords, inWords, text } from "../words.js";

const LIMITS = [["core_above_C", "page-alarm-core", "°C"], ["platen_above_C", "page-alarm-platen-above", "°C"], ["platen_below_C", "page-alarm-platen-below", "°C"],
  ["silence_s", "page-alarm-silence", "s"], ["drift_percent", "page-alarm-drift", "%"]];

// What the limits are called where the server names them.
const fieldNames = () => Object.fromEntries(LIMITS.map(([key, label]) => [`body.${key}`, text(label)]));

export async function show(place, context) {
  const list = el("section", { class: "card", "data-testid": "alarms" });
  const limits = el("section", { class: "card", "data-testid": "alarm-limits" });
  let asked = 0, answered = 0, drawn = "", owed = Infinity;
  const load = async (now = false) => {
    const mine = ++asked;
    if (now) owed = mine;
    const { items } = await get("/alarms", { limit: 100 });
    const content = JSON.stringify(items);
    if (mine < answered) return; // overtaken by a later answer
    answered = mine;
    const inHand = list.contains(document.activeElement) || list.matches(":active"); // a button drawn anew while it is pressed is not clicked
    const due = mine >= owed;
    if (due) owed = Infinity;
    if (content === drawn || (inHand && !due)) return;
    drawn = content;
    drawList(list, items);
  };
  const [stop, deaf] = [again(load, 3000), onTaken(() => load(true).catch(() => { /* the next look shows it */ }))];
  const leave = () => { stop(); deaf(); };
  try {
    await load(); // first: a list that came later would push away what is below it, from under a finger
    place.append(list, bellCard(), limits);
    if (context.press) drawLimits(limits, (await get("/alarms/thresholds", { press: context.press })).items[0]);
    else limits.remove();
  } catch (error) {
    leave();
    throw error;
  }
  return leave;
}

function drawList(place, items) {
  const message = el("p", { role: "status", class: "small" });
  const heads = [{ text: text("page-when") }, { text: text("page-status"), class: "wide" }, { text: text("page-what"), class: "wide" }, { text: text("page-alarm-taken") }];
  const rows = items.map((one) => [when(one.raised_utc),
    el("span", { class: `pill ${one.stands ? "bad" : one.acknowledged_utc ? "" : "warn"}` }, one.stands ? text("page-alarm-stands") : text("page-alarm-over", { time: clock(one.ended_utc) })),
    inWords(one.message_said, one.message),
    one.acknowledged_utc ? text("page-next-by", { who: one.acknowledged_by, time: clock(one.acknowledged_utc) }) : el("button", {
      type: "button", class: "button", "aria-label": text("page-alarm-take-this", { what: inWords(one.message_said, one.message) }),
      onclick: async () => {
        try {
          await post(`/alarms/${one.id}/acknowledge`);
          announce(text("page-alarm-taken"));
          taken(one.id);
        } catch (error) { refuse(message, error); }
      } }, text("page-alarm-take"))]);
  place.replaceChildren(el("h1", {}, text("page-nav-alarms")), items.length ? table(text("page-nav-alarms"), heads, rows, { cards: true }) : el("p", { class: "faint" }, text("page-no-alarms")), message);
}

function bellCard() {
  const message = el("p", { role: "status", class: "small" });
  const choice = (what) => {
    const box = el("input", { type: "checkbox", id: `alarm-${what}`, checked: wanted(what), onchange: async () => {
      const done = await want(what, box.checked);
      if (!done) box.checked = false;
      message.textContent = done ? "" : text("page-alarm-no-leave");
    } });
    return el("label", { class: "row", for: `alarm-${what}` }, box, text(`page-alarm-${what}`));
  };
  return el("section", { class: "card" }, el("h2", {}, text("page-alarm-here")), choice("sound"), choice("notification"), message);
}

function drawLimits(place, kept) {
  const message = el("p", { role: "status", class: "small" });
  const fields = LIMITS.map(([key, label, unit]) => {
    const value = kept.thresholds[key];
    const input = el("input", { type: "text", id: `limit-${key}`, inputmode: "decimal", autocomplete: "off", value: value === null ? "" : written(value) });
    return { key, input, row: el("label", { for: `limit-${key}` }, el("span", {}, text(label), el("span", { class: "faint" }, ` [${unit}]`)), input) };
  });
  const unknown = el("input", { type: "checkbox", id: "limit-verdict", checked: kept.thresholds.verdict_unknown });
  const form = el("form", { class: "touch-form" }, fields.map(({ row }) => row), el("button", { class: "button primary" }, text("page-save")));
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    const typed = fields.filter(({ input }) => input.value.trim()).map(({ key, input }) => [key, Number(input.value.trim().replace(",", "."))]);
    const wrong = typed.find(([, value]) => Number.isNaN(value));
    if (wrong) return refuse(message, { message: text("page-alarm-no-number", { name: text(LIMITS.find(([key]) => key === wrong[0])[1]) }) });
    try {
      drawLimits(place, await put(`/alarms/thresholds/${encodeURIComponent(kept.press)}`, { ...Object.fromEntries(typed), verdict_unknown: unknown.checked }));
      announce(text("page-alarm-limits-kept"));
    } catch (error) { refuse(message, error, inFieldWords(error.coded, error.message, fieldNames())); }
    return null;
  });
  place.replaceChildren(el("div", { class: "head" }, el("h2", {}, text("page-alarm-limits", { press: kept.press })),
    el("span", { class: "small faint" }, kept.who ? text("page-next-by", { who: kept.who, time: clock(kept.utc) }) : "")),
  el("label", { class: "row", for: "limit-verdict" }, unknown, text("page-alarm-verdict")), form, el("p", { class: "small faint" }, text("page-alarm-drift-hint")),
  el("p", { class: "small faint" }, text("page-alarm-limits-hint")), message);
}

export function refuse(message, error, words = error.message) {
  message.className = "small bad-text";
  message.replaceChildren(words, error.status === 401 ? el("a", { href: "#/access" }, ` ${text("page-need-token")}`) : "");
}
