// Small helpers to build the page: elements, numbers, times in the chosen language.
import { inUnits, inWords, locale, text } from "./words.js";

export function el(tag, attributes = {}, ...children) {
  const node = document.createElement(tag);
  for (const [key, value] of Object.entries(attributes)) {
    if (value === undefined || value === null || value === false) continue;
    if (key === "class") node.className = value;
    else if (key === "style") node.style.cssText = value;
    else if (key.startsWith("on")) node.addEventListener(key.slice(2), value);
    else node.setAttribute(key, value === true ? "" : value);
  }
  node.append(...children.flat(3).filter((child) => child !== null && child !== undefined && child !== false));
  return node;
}

const formats = new Map();
export function number(value, digits = 1) {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  const key = `${locale()}:${digits}`;
  if (!formats.has(key)) {
    formats.set(key, new Intl.NumberFormat(locale(), { minimumFractionDigits: digits, maximumFractionDigits: digits }));
  }
  return signed(formats.get(key).format(value));
}

// A number below zero has a minus, which a hyphen is not.
const signed = (written) => written.replace("-", "−");

// Three significant digits, for values whose size is not known before.
export function figure(value) {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  const size = Math.abs(value);
  return number(value, size >= 100 ? 0 : size >= 10 ? 1 : size >= 0.1 ? 2 : 4);
}

// Three significant digits and no thousands separator, for parameters from 0.00001 to 100000.
export const plain = (value) => signed(new Intl.NumberFormat(locale(), { maximumSignificantDigits: 3, useGrouping: false }).format(value));

// A number as it was written down, with the language's decimal sign.
export const written = (value) => new Intl.NumberFormat(locale(), { maximumFractionDigits: 12, useGrouping: false }).format(value);

// A channel's last value with its unit; a limit switch is 0 or 1.
export const reading = (channel) => `${number(channel.value, channel.unit ? 1 : 0)} ${channel.unit}`.trim();

// Words as people wrote them: marks of the direction of text in them end with them.
export const byHand = (words) => el("bdi", {}, words);

// Date and time, that part only between each other.
export function when(utc) {
  return el("span", { class: "when" }, clock(utc).split(/(?<=,) /).map((part, i) => [i ? " " : "", el("span", { class: "num" }, part)]));
}

export function clock(utc, withDate = true) {
  if (!utc) return "–";
  const options = withDate ? { dateStyle: "short", timeStyle: "medium" } : { timeStyle: "medium" };
  return new Intl.DateTimeFormat(locale(), options).format(new Date(utc));
}

// With the date where that is not today's.
export const clockToday = (utc) => clock(utc, new Date(utc).toDateString() !== new Date().toDateString());

// When what is shown was true.
export const asOf = (utc) => text("page-chart-as-of", { time: clockToday(utc) });

// When a run was; a file need not say it.
export const began = (utc) => (utc ? clock(utc) : text("page-date-unknown"));

// The beginning of a day as the reader's clock has it, `later` days on; empty for no day.
export function midnight(day, later) {
  const [year, month, date] = day.split("-").map(Number);
  const begin = new Date(year, month - 1, date + later);
  return Number.isNaN(begin.getTime()) ? "" : begin.toISOString();
}

export function duration(seconds) {
  if (seconds === null || seconds === undefined) return "–";
  return seconds < 100 ? `${number(seconds, 1)}\u00a0s` : inUnits(seconds).replace(/(\d) /g, "$1\u00a0");
}

export function bytes(value) {
  if (value === null || value === undefined) return "–";
  const units = ["B", "kB", "MB", "GB", "TB"];
  let i = 0;
  while (value >= 1000 && i < units.length - 1) { value /= 1000; i += 1; }
  return `${number(value, i ? 1 : 0)} ${units[i]}`;
}

// With `cards`, a narrow screen or a place too narrow shows each row as a card, without what is nil.
export function table(caption, heads, rows, options = {}) {
  const holder = el("div", { class: "scroll" }, el("table", { class: "list" },
    el("caption", { class: "unseen" }, caption),
    el("thead", { "data-label": options.sort }, el("tr", {}, heads.map((head) =>
      el("th", { scope: "col", class: head.class }, head.unseen ? el("span", { class: "unseen" }, head.text) : head.text)))),
    el("tbody", {}, rows.map((row, i) => {
      const node = el("tr", {}, row.map((cell, j) => el("td", { class: [heads[j].class, options.cards && ["0", "–"].includes(cell?.textContent ?? cell) && "nil"].filter(Boolean).join(" ") || null, "data-label": options.cards && (heads[j].text.textContent ?? heads[j].text) }, cell ?? "–")));
      if (options.pick) {
        node.className = "pick";
        node.addEventListener("click", (event) => { if (!event.target.closest("a,input,button")) options.pick(i); });
      }
      return node;
    }))));
  new ResizeObserver(() => {
    if (options.cards) stack(holder);
    const scrolls = holder.scrollWidth > holder.clientWidth || holder.scrollHeight > holder.clientHeight; // then keys must reach it
    for (const [key, value] of Object.entries({ tabindex: "0", role: "region", "aria-label": caption })) if (scrolls) holder.setAttribute(key, value); else holder.removeAttribute(key);
  }).observe(holder);
  return holder;
}

const narrow = matchMedia("(max-width: 720px)");

function stack(holder) {
  const { classList } = holder.firstChild;
  classList.remove("stacked");
  classList.toggle("stacked", narrow.matches || holder.scrollWidth > holder.clientWidth);
}

// What is to be known of a fit or a diagnosis; null where there is nothing.
export const warningsOf = (one) => (one.warnings?.length ? el("ul", { class: "small" }, one.warnings.map((warning, i) => el("li", {}, inWords(one.warnings_said?.[i], warning)))) : null);
