// Nights: what the nightly job did for the chosen press or for all, newest first.
import { download, get, url } from "../api.js";
import { bytes, duration, el, number, table, when } from "../dom.js";
import { effectName, has, inWords, language, text } from "../words.js";

export async function show(place, context) {
  const rows = el("div", { "data-testid": "nights" });
  const more = el("button", { type: "button", class: "button", hidden: true, onclick: () => load() }, text("page-more"));
  let all = context.presses.length > 1 && context.query.get("presses") === "all";
  const choose = (event) => {
    all = event.target.value === "all";
    history.replaceState(null, "", all ? "#/nights?presses=all" : "#/nights");
    begin();
  };
  const options = [["", context.press], ["all", text("page-all")]].map(([value, words]) => el("option", { value, selected: (value === "all") === all }, words));
  const choice = context.presses.length > 1 ? el("label", { class: "row small" }, text("page-press"), el("select", { "data-testid": "nights-of", onchange: choose }, options)) : null;
  place.append(el("section", { class: "card" }, el("div", { class: "head" }, el("h1", {}, text("page-nav-nights")), choice), el("p", { class: "small faint" }, text("page-nights-hint")), rows, more));
  let nights, cursor, turn = 0;
  const begin = () => { [nights, cursor] = [[], null]; return load(); };
  const load = async () => {
    const mine = ++turn;
    const page = await get("/nights", { press: all ? null : context.press, cursor, limit: 30 });
    if (mine !== turn) return;
    nights.push(...page.items);
    cursor = page.next_cursor;
    more.hidden = !cursor;
    rows.replaceChildren(nights.length ? nightTable(nights, all) : el("p", { class: "faint" }, text("page-no-nights")));
  };
  await begin();
}

function nightTable(nights, all) {
  const heads = [{ text: text("page-night") }, ...(all ? [{ text: text("page-press") }] : []), { text: text("page-night-new"), class: "right" }, { text: text("page-night-fitted"), class: "right" }, { text: text("page-night-left-out") },
    { text: text("page-night-took"), class: "right" }, { text: text("page-night-memory"), class: "right" }, { text: text("page-night-named") }, { text: text("page-night-model"), class: "wide" }];
  return table(text("page-nav-nights"), heads, nights.map((one) => [
    el("div", {}, report(one), el("p", { class: "small faint" }, text("page-night-stored", { runs: one.runs })), archive(one)),
    ...(all ? [one.press] : []), count(one.new), fitted(one), leftOut(one), el("span", { class: "num" }, duration(one.seconds)), el("span", { class: "num" }, bytes(one.memory_bytes)), named(one), model(one)]), { cards: true });
}

const report = (one) => el("a", { href: url(`/nights/${one.id}/report`, { language: language() }), download: null, target: "_blank", title: text("page-night-report"), onclick: download }, when(one.ended_utc));

const archive = (one) => one.archived || one.pressings_only || one.archive_later
  ? el("p", { class: "small faint" }, text("page-night-archive", { archived: one.archived, freed: bytes(one.freed_bytes), removed: one.pressings_only, later: one.archive_later })) : "";

const count = (value) => el("span", { class: "num" }, number(value, 0));

// Fits made tonight, and those made since the night before that stand.
function fitted(one) {
  const standing = one.runs - one.fitted - one.not_fitted - one.blind - one.later;
  return el("div", {}, count(one.fitted), standing > 0 ? el("p", { class: "small faint" }, text("page-night-standing", { runs: standing })) : "");
}

// Runs without panel sensors and older ones are left out as it is meant; what could not be fitted is listed run by run.
function leftOut(one) {
  const parts = [["page-night-not-fitted", one.not_fitted], ["page-night-blind", one.blind], ["page-night-later", one.later]].filter(([, runs]) => runs);
  if (!parts.length && !one.left_out.length) return "–";
  return el("div", {}, parts.map(([code, runs]) => el("p", { class: code === "page-night-not-fitted" ? "small warn-text" : "small" }, text(code, { runs, nights: one.later_nights }))),
    one.left_out.length ? el("details", {}, el("summary", { class: "small" }, text("page-night-why", { runs: one.left_out.length })),
      el("ul", { class: "small" }, one.left_out.map((each) => el("li", {}, el("a", { href: `#/runs/${encodeURIComponent(each.run)}` }, each.run), ` ${inWords(each.why_said, each.why)}`)))) : "");
}

function named(one) {
  const verdict = has(`diagnosis-verdict-${one.verdict}`) ? text(`diagnosis-verdict-${one.verdict}`) : text("page-night-not-asked");
  return el("div", {}, one.named.map((name) => el("p", {}, effectName(name))), el("p", { class: "small faint" }, verdict));
}

function model(one) {
  const pill = one.promoted ? el("span", { class: "pill good" }, text("page-night-promoted", { version: one.promoted }))
    : one.refused ? el("span", { class: "pill warn" }, text("page-night-refused", { version: one.refused })) : one.version ? text("page-night-stays", { version: one.version }) : text("page-night-none");
  return el("div", {}, pill, el("p", { class: "small faint" }, inWords(one.reason_said, one.reason)));
}
