// The next panel, stated before it is pressed, and what became of the last one: large enough for a thumb in a glove.
import { announce } from "../announce.js";
import { get, put } from "../api.js";
import { clock, el, number, written } from "../dom.js";
import { inFieldWords, text } from "../words.js";
import { refuse } from "./alarms.js";

export const VERDICTS = ["good", "blister", "undercured", "scrap"];
const FIELDS = [["panel.material", "page-material", ""], ["panel.thickness_mm", "page-thickness", "mm"], ["panel.moisture_percent", "page-moisture", "%"],
  ["panel.initial_temperature_C", "page-start-temperature", "°C"], ["setting.core_target_C", "page-target", "°C"]];

export class PanelCards {
  constructor(place, press) {
    Object.assign(this, { press, run: null, begun: undefined, typed: false });
    this.next = el("section", { class: "card touch", "data-testid": "next-panel" });
    this.verdict = el("section", { class: "card touch", "data-testid": "verdict", hidden: true });
    place.append(this.verdict, this.next);
    this.load().catch((error) => this.next.replaceChildren(el("p", { class: "faint" }, error.message)));
  }

  // What somebody began to type while the answer was on its way stays.
  async load() {
    const stated = await get("/press/next", { press: this.press });
    if (!this.inUse()) this.draw(stated);
  }

  inUse() { return this.typed || this.next.contains(document.activeElement); }

  draw(stated) {
    this.typed = false;
    const fields = FIELDS.map(([key, label, unit]) => {
      const value = stated.header[key];
      const input = el("input", { type: "text", id: `next-${key}`, inputmode: key === "panel.material" ? "text" : "decimal", autocomplete: "off", value: value === undefined ? "" : typeof value === "number" ? written(value) : value });
      return { key, input, row: el("label", { for: `next-${key}` }, el("span", {}, text(label), unit ? el("span", { class: "faint" }, ` [${unit}]`) : ""), input) };
    });
    const names = Object.keys(stated.recipes);
    const choice = el("select", { id: "next-recipe", onchange: () => {
      for (const { key, input } of fields) {
        const value = stated.recipes[choice.value]?.[key];
        if (choice.value) input.value = value === undefined ? "" : typeof value === "number" ? written(value) : value;
      }
      name.value = choice.value;
    } }, el("option", { value: "" }, text("page-recipe-none")), names.map((one) => el("option", { value: one, selected: one === stated.recipe }, one)));
    const name = el("input", { type: "text", id: "next-name", value: stated.recipe, maxlength: 100, autocomplete: "off" });
    const message = el("p", { role: "status", class: "small" });
    this.faces = el("p", { class: "small faint faces-now" });
    const form = el("form", { class: "touch-form" },
      el("label", { for: "next-recipe" }, text("page-number-recipe"), choice), ...fields.map(({ row }) => row),
      el("label", { for: "next-name" }, text("page-recipe-name"), name),
      el("button", { class: "button primary" }, text("page-save")));
    form.addEventListener("input", () => { this.typed = true; });
    form.addEventListener("submit", async (event) => {
      event.preventDefault();
      const others = Object.entries(stated.header).filter(([key]) => !FIELDS.some(([known]) => known === key));
      const header = Object.fromEntries([...others, ...fields.filter(({ input }) => input.value.trim()).map(({ key, input }) => [key, meant(key, input.value.trim())])]);
      try {
        this.draw(await put(`/press/next?press=${encodeURIComponent(this.press)}`, { header, recipe: name.value.trim() }));
        announce(text("page-next-kept"));
      } catch (error) { refuse(message, error, inFieldWords(error.coded, error.message, labels())); }
    });
    this.next.replaceChildren(el("div", { class: "head" }, el("h2", {}, text("page-next-panel")),
      el("span", { class: "small faint" }, stated.who ? text("page-next-by", { who: stated.who, time: clock(stated.utc) }) : "")),
    form, ...stated.doubts_said.map((doubt) => el("p", { class: "warning", role: "status" }, `⚠ ${inFieldWords(doubt, doubt.code, labels())}`)),
    el("p", { class: "small faint" }, text("page-next-hint")), this.faces, message);
  }

  // What the faces read now, beside the start temperature that is typed in, and the last panel's verdict.
  show(now) {
    const degrees = (value) => (value === null ? text("page-state-unknown") : `${number(value, 1)} °C`);
    if (this.faces) this.faces.hidden = now.faces.top_C === null && now.faces.bottom_C === null;
    if (this.faces) this.faces.textContent = text("page-next-faces", { top: degrees(now.faces.top_C), bottom: degrees(now.faces.bottom_C) });
    this.follow(now.run);
    const done = now.run && (now.run_status !== "open" || now.estimate?.advice?.verdict === "opened") ? now.run : null;
    if (done === this.run) return;
    this.run = done;
    this.verdict.hidden = !done;
    if (done) this.ask(done).catch(() => { this.verdict.hidden = true; });
  }

  // A pressing that begins takes what was stated of its panel alone, and others may have stated something since.
  follow(run) {
    const before = this.begun;
    this.begun = run;
    if (before !== undefined && run !== before && !this.inUse()) this.load().catch(() => {});
  }

  async ask(run) {
    this.drawVerdict(run, await get(`/runs/${encodeURIComponent(run)}/verdict`));
  }

  drawVerdict(run, marked) {
    const message = el("p", { role: "status", class: "small" });
    const buttons = VERDICTS.map((one) => el("button", {
      type: "button", class: `button verdict-button ${one}`, "aria-pressed": String(marked.verdict === one),
      onclick: async () => {
        try {
          this.drawVerdict(run, await put(`/runs/${encodeURIComponent(run)}/verdict`, { verdict: marked.verdict === one ? null : one }));
        } catch (error) { refuse(message, error); }
      },
    }, text(`page-panel-${one}`)));
    this.verdict.replaceChildren(el("h2", {}, text("page-panel-verdict", { run })), el("div", { class: "verdicts" }, buttons), message,
      marked.who ? el("p", { class: "small faint" }, text("page-next-by", { who: marked.who, time: clock(marked.utc) })) : "",
      ["good", "blister"].includes(marked.verdict) ? el("p", { class: "small" }, el("a", { href: "#/runs/blisters" }, text("page-blisters", { press: this.press }))) : "");
  }
}

// What the operator sees the header's keys called.
const labels = () => Object.fromEntries(FIELDS.map(([key, label]) => [key, text(label)]));

const meant = (key, typed) => (key !== "panel.material" && /^[+-]?\d+([.,]\d+)?$/.test(typed) ? Number(typed.replace(",", ".")) : typed);
