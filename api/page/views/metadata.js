// What people know about a run: remark and header, changed with a token that may write, and the history of the changes.
import { patch } from "../api.js";
import { byHand, clock, el, table, written } from "../dom.js";
import { numberName, text } from "../words.js";
import { VERDICTS } from "./panel.js";

export function metadataCard(run, path) {
  const card = el("section", { class: "card", "data-testid": "metadata" });
  const read = () => {
    const change = el("button", { type: "button", class: "button", onclick: edit }, text("page-change"));
    card.replaceChildren(el("div", { class: "head" }, el("h2", {}, text("page-metadata")), change),
      table(text("page-metadata"), [{ text: text("page-name") }, { text: text("page-value"), class: "right" }],
        Object.entries(run.header).filter(([name]) => name !== "run").map(([name, value]) => [called(name), el("span", { class: "num" }, inPlainWords(name, value))])),
      ...(run.changes.length ? [historyOf(run.changes)] : []));
    return change;
  };
  const edit = () => card.replaceChildren(editor(run, path, () => read().focus(), () => dispatchEvent(new HashChangeEvent("hashchange"))));
  read();
  return card;
}

// A header key in words where it has some, with the key that files and searches know it by.
const called = (key) => {
  const words = numberName(key);
  return words === key ? key : el("div", {}, words, el("div", { class: "faint small" }, key));
};

const shown = (value) => (value === null || value === undefined || value === "" ? "–" : typeof value === "number" ? written(value) : typeof value === "object" ? JSON.stringify(value) : String(value));

// What a panel became is marked by a button, and read as that button's words.
export const inPlainWords = (key, value) => (key === "panel.verdict" && VERDICTS.includes(value) ? text(`page-panel-${value}`) : shown(value));

function historyOf(changes) {
  return el("details", {}, el("summary", { class: "small" }, `${text("page-changes")} (${changes.length})`),
    el("ul", { class: "small changes" }, [...changes].reverse().map((c) =>
      el("li", {}, el("span", { class: "faint num" }, `${clock(c.utc)} · `, byHand(c.who)), el("br"), c.field === "remark" ? text("page-remark") : byHand(c.field), ": ",
        byHand(inPlainWords(c.field, c.before)), " → ", byHand(inPlainWords(c.field, c.after))))));
}

function editor(run, path, cancel, done) {
  const remark = el("textarea", { rows: 3, maxlength: 4000, id: "remark", dir: "auto" });
  remark.value = run.remark;
  const simple = Object.entries(run.header).filter(([name, value]) => name !== "run" && typeof value !== "object");
  const fields = simple.map(([name, value]) => ({ name, value, input: el("input", { type: "text", id: `header-${name}`, dir: "auto", value: value === "" ? "" : shown(value) }) }));
  const added = [];
  const grid = el("div", { class: "fields" }, fields.map((f) => [el("label", { for: `header-${f.name}`, class: "small" }, called(f.name)), f.input]).flat());
  const another = () => { // an empty line waits below the last one
    const name = el("input", { type: "text", placeholder: "setting.pressure_N_cm2", "aria-label": text("page-new-key") });
    const value = el("input", { type: "text", dir: "auto", "aria-label": text("page-value") });
    name.addEventListener("input", another, { once: true });
    added.push({ name, value });
    grid.append(name, value);
  };
  another();
  const message = el("p", { class: "small bad-text", role: "alert" });
  const form = el("form", { class: "stack edit" }, el("h2", {}, text("page-metadata")),
    el("label", { for: "remark" }, text("page-remark")), remark,
    grid,
    el("p", { class: "small faint" }, text("page-empty-removes")), message,
    el("div", { class: "row" }, el("button", { class: "button primary" }, text("page-save")), el("button", { type: "button", class: "button", onclick: cancel }, text("page-cancel"))));
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    const header = {};
    for (const { name, value, input } of fields) {
      if (input.value !== (value === "" ? "" : shown(value))) header[name] = meant(input.value);
    }
    for (const { name, value } of added) if (name.value.trim()) header[name.value.trim()] = meant(value.value);
    try {
      await patch(path, remark.value === run.remark ? { header } : { remark: remark.value, header });
      done();
    } catch (error) {
      message.replaceChildren(error.message, error.status === 401 ? el("a", { href: "#/access" }, ` ${text("page-need-token")}`) : "");
    }
  });
  return form;
}

// What somebody typed, as a run file would hold it.
function meant(typed) {
  const value = typed.trim();
  if (value === "") return null;
  if (value === "true" || value === "false") return value === "true";
  return /^[+-]?\d+([.,]\d+)?([eE][+-]?\d+)?$/.test(value) ? Number(value.replace(",", ".")) : value;
}
