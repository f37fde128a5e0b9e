// All presses at once: one tile each with state, core, the one answer and what is wrong; thirty on one screen.
import { leaveToView } from "../alarmbar.js";
import { again, get } from "../api.js";
import { el } from "../dom.js";
import { isLimit } from "../silence.js";
import { text } from "../words.js";
import { showAnswer, showCore, showLight, stateOf } from "./answer.js";

export async function show(place) {
  const grid = el("div", { class: "presses", "data-testid": "presses" });
  const tiles = new Map();
  const load = async () => {
    const [{ items }, health] = await Promise.all([get("/press"), get("/health")]);
    const received = performance.now();
    for (const now of items) {
      if (!tiles.has(now.press)) tiles.set(now.press, tile(now.press));
      Object.assign(tiles.get(now.press), { now, received, health });
    }
    if (!grid.parentNode) place.append(el("h1", { class: "unseen" }, text("page-nav-presses")), grid);
    if (grid.children.length !== tiles.size) grid.replaceChildren(...[...tiles.values()].map(({ node }) => node));
    drawAll();
    fit(grid);
  };
  // Whose tile says that its press is silent needs no line above it.
  const drawAll = () => {
    tiles.forEach(draw);
    leaveToView(place, (said) => tiles.get(said.arguments.press)?.node.classList.contains("stale") && isLimit(said, said.arguments.press));
  };
  await load();
  const ageing = setInterval(drawAll, 1000);
  const leave = again(load, 2000);
  return () => { leave(); clearInterval(ageing); };
}

// Tiles that together are higher than the screen are drawn closer.
function fit(grid) {
  grid.classList.remove("dense");
  grid.classList.toggle("dense", grid.getBoundingClientRect().bottom + scrollY > innerHeight);
}

function tile(press) {
  const parts = { state: el("span", { class: "pill" }), core: el("div", { class: "core" }), band: el("div", { class: "band", title: text("page-band95") }), answer: el("div", { class: "answer" }), light: el("span", { class: "light" }) };
  const node = el("a", { class: "card press-tile", href: `#/now?press=${encodeURIComponent(press)}` },
    el("div", { class: "row", style: "justify-content:space-between" }, el("b", {}, press), parts.state), parts.core, parts.band, parts.answer, parts.light);
  return { node, ...parts };
}

// Old numbers are grey here, too, and press by press.
function draw({ node, state, core, band, answer, light, now, received, health }) {
  const filesOnly = !now.channels.length; // runs came as files, nothing records here: nothing is wrong and nothing is late
  if (filesOnly) {
    node.classList.add("stale");
    for (const part of [state, core, band, answer]) part.hidden = true;
    light.className = "light idle";
    light.textContent = text("page-files-only");
    return;
  }
  for (const part of [state, core, band, answer]) part.hidden = false;
  const silent = Math.min(...now.channels.map((channel) => channel.age_s ?? Infinity)) + (performance.now() - received) / 1000;
  const stale = silent > now.silent_after_s;
  node.classList.toggle("stale", stale);
  state.className = `pill ${stateOf(now, stale)}`;
  state.textContent = text(`page-state-${stateOf(now, stale)}`);
  showCore(core, band, now.state, now.estimate, { tile: true });
  showAnswer(answer, now, stale ? silent : null);
  showLight(light, { now, health, silent: stale ? silent : null, tile: true });
}
