// The page's frame: which view, which language, light or dark, and the one live connection all views share.
import { leaveToView, lookAt, showAlarms } from "./alarmbar.js";
import { again, follow, get } from "./api.js";
import { keepReady, listen } from "./bell.js";
import { closeAll, redrawAll } from "./charts.js";
import { el } from "./dom.js";
import * as access from "./views/access.js";
import * as alarms from "./views/alarms.js";
import * as coefficients from "./views/coefficients.js";
import * as diagnosis from "./views/diagnosis.js";
import * as journal from "./views/journal.js";
import * as loggers from "./views/loggers.js";
import * as nights from "./views/nights.js";
import * as now from "./views/now.js";
import * as presses from "./views/presses.js";
import * as runs from "./views/runs.js";
import * as wall from "./views/wall.js";
import { chooseLanguage, language, languages, loadWords, nameOf, text } from "./words.js";

const VIEWS = { presses, now, runs, coefficients, diagnosis, nights, alarms, journal, loggers, access, wall };
const main = document.getElementById("view");
let leave = null;
let turn = 0;
let unanswered = false; // the view is not there because nobody answered: it is asked for again, not left to a reload

// What a view gets: the chosen press, and `on(event, handler)` for live events until the view is left.
const context = { press: null, presses: [], on: (name, handler) => listeners[name].add(handler), live: "waiting" };
const listeners = { scan: new Set(), estimate: new Set(), press: new Set(), run: new Set(), fit: new Set(), link: new Set() };

async function show() {
  const [path, query] = (location.hash.replace(/^#\//, "") || start()).split("?");
  const [name, ...rest] = path.split("/").map(decodeURIComponent);
  context.query = new URLSearchParams(query);
  if (context.presses.includes(context.query.get("press"))) choosePress(context.query.get("press"));
  const view = VIEWS[name] ?? now;
  const mine = ++turn;
  if (leave) leave();
  leave = null;
  unanswered = false;
  closeAll();
  for (const handlers of Object.values(listeners)) handlers.clear();
  for (const link of document.querySelectorAll(".tabs a")) {
    if (link.dataset.view === name) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  }
  document.querySelector(".tabs a[aria-current]")?.scrollIntoView({ block: "nearest", inline: "center" });
  document.title = `${text(`page-nav-${VIEWS[name] ? name : "now"}`)} · Kerntemp`;
  const place = el("div", { class: "stack", "data-loading": text("page-loading") });
  main.replaceChildren(place);
  leaveToView(place);
  lookAt(view === presses ? null : context.press);
  try {
    const done = await view.show(place, context, rest);
    if (mine === turn) leave = done ?? null;
    else if (done) done();
  } catch (error) {
    if (mine !== turn) return;
    unanswered = error.status === 0 || error.status >= 500;
    const help = error.status === 401 ? el("p", {}, el("a", { href: "#/access" }, text("page-need-token"))) : "";
    place.replaceChildren(el("div", { class: "card empty" }, el("p", {}, text("page-could-not-load")), el("p", { class: "small" }, error.message), help));
  }
}

function translate() {
  document.documentElement.lang = language();
  for (const node of document.querySelectorAll("[data-text]")) node.textContent = text(node.dataset.text);
  for (const node of document.querySelectorAll("[data-label]")) node.setAttribute("aria-label", text(node.dataset.label));
  const options = languages().map((one) => el("option", { value: one, lang: one, selected: one === language() }, nameOf(one)));
  document.getElementById("language").replaceChildren(...options);
  showLink();
}

function showLink() {
  const link = document.getElementById("link");
  link.className = `link ${context.live}`;
  link.textContent = text(`page-link-${context.live}`);
}

function setTheme(theme) {
  document.documentElement.dataset.theme = theme;
  document.getElementById("theme").textContent = theme === "dark" ? "☀" : "☾";
  redrawAll();
}

const preferred = matchMedia("(prefers-color-scheme: dark)");
const chosenTheme = () => localStorage.getItem("kerntemp-theme") || (preferred.matches ? "dark" : "light");

document.getElementById("theme").addEventListener("click", () => {
  localStorage.setItem("kerntemp-theme", chosenTheme() === "dark" ? "light" : "dark");
  setTheme(chosenTheme());
});
preferred.addEventListener("change", () => setTheme(chosenTheme()));
document.getElementById("language").addEventListener("change", async (event) => {
  await chooseLanguage(event.target.value);
  translate();
  refreshHealth();
  show();
});
document.getElementById("press").addEventListener("change", (event) => {
  context.press = event.target.value;
  if (location.hash.includes("?")) history.replaceState(null, "", location.hash.split("?")[0]); // it may name another press
  show();
});
addEventListener("hashchange", () => {
  if (location.hash && !location.hash.startsWith("#/")) return; // a place in this view, not another view
  show();
  main.focus({ preventScroll: true });
});
document.querySelector(".skip").addEventListener("click", (event) => { event.preventDefault(); main.focus(); });

const start = () => (context.presses.length > 1 ? "presses" : "now");

function choosePress(name) {
  context.press = name;
  document.getElementById("press").value = name;
}

async function refreshPresses() {
  try {
    const { items } = await get("/press");
    context.presses = items.map((item) => item.press);
    if (!context.presses.includes(context.press)) context.press = context.presses[0] ?? null;
    const select = document.getElementById("press");
    select.hidden = context.presses.length < 2;
    document.querySelector("[data-view=presses]").hidden = select.hidden;
    select.replaceChildren(...context.presses.map((name) => el("option", { value: name, selected: name === context.press }, name)));
  } catch { context.presses = []; }
}

// What the server owed when it went away, once it answers again.
async function askAgain() {
  if (!unanswered && context.presses.length) return;
  const without = !context.presses.length;
  await refreshPresses();
  if (unanswered || (without && context.presses.length)) await show();
}

async function refreshHealth() {
  if (document.hidden) return;
  try {
    const health = await get("/health");
    document.getElementById("version").textContent = `Kerntemp ${health.version}`;
    showAlarms(health);
    await askAgain();
  } catch { /* the link state says it */ }
}

function connect() {
  const handlers = {};
  for (const name of ["scan", "estimate", "press", "run", "fit"]) {
    handlers[name] = (data) => { for (const handler of listeners[name]) handler(data); };
  }
  follow(handlers, async (state) => {
    const back = state === "live" && context.live !== "live";
    context.live = state;
    showLink();
    if (back) await askAgain();
    for (const handler of listeners.link) handler(state);
  });
}

setTheme(chosenTheme());
while (!(await loadWords())) {
  document.getElementById("unanswered").hidden = false;
  await new Promise((resolve) => setTimeout(resolve, 2000));
}
translate();
main.replaceChildren(el("div", { class: "stack", "data-loading": text("page-loading") }));
await refreshPresses();
show();
connect();
refreshHealth();
again(refreshHealth, 5000);
keepReady(document.getElementById("muted"));
listen().catch(() => { /* the link state says it */ });
again(listen, 5000, { hiddenToo: true });
