// Any number of runs over any other, by which a process is understood: of those compared, or of all that a search finds.
import { get } from "../api.js";
import { TimeChart } from "../charts.js";
import { el, midnight, number } from "../dom.js";
import { language, numberName, text } from "../words.js";

const MOST = 2000;
const AXES = ["x", "y"];

// What the runs are looked for by, from the address of list and scatter.
export const asked = (filter, context) => ({
  press: context.presses.length > 1 ? context.press : "", q: filter.q, language: language(), where: filter.where.replace(/\s*([<>=]+)\s*/g, "$1").split(/\s+/).filter(Boolean), verdict: filter.verdict, status: filter.status,
  from: midnight(filter.from, 0), to: midnight(filter.to, 1),
});

export async function showScatter(place, context, filters) {
  const filter = Object.fromEntries(filters.map((name) => [name, context.query.get(name) ?? ""]));
  const runs = [];
  let cursor = "";
  do {
    const page = await get("/search", { ...asked(filter, context), limit: 500, cursor });
    runs.push(...page.items.map((run) => ({ id: run.run, numbers: run.numbers })));
    cursor = page.next_cursor;
  } while (cursor && runs.length < MOST);
  const axes = Object.fromEntries(AXES.map((axis) => [axis, context.query.get(axis)]));
  const query = (more) => new URLSearchParams(Object.entries({ ...filter, ...more }).filter(([, value]) => value)).toString();
  const card = scatter(runs, axes, () => history.replaceState(null, "", `#/runs/scatter?${query(axes)}`), "h1");
  card.querySelector(".head > .row").append(el("a", { class: "button", href: `#/runs?${query()}` }, text("page-back")));
  if (cursor) card.append(el("p", { class: "small faint" }, text("page-scatter-newest", { count: runs.length })));
  place.append(card);
  return null;
}

export function scatter(runs, axes = {}, keep = () => {}, heading = "h2") {
  const names = [...new Set(runs.flatMap(({ numbers }) => Object.keys(numbers).filter((name) => numbers[name] !== null)))].sort();
  const usual = { x: ["press_time_s", names[0]], y: ["core_at_opening_C", names.at(-1)] };
  for (const axis of AXES) axes[axis] = [axes[axis], ...usual[axis]].find((name) => names.includes(name));
  const holder = el("div", {}), counted = el("p", { class: "small faint", role: "status" });
  const choose = (axis, label) => el("label", { class: "row small" }, el("span", { class: "faint" }, label),
    el("select", { onchange: (event) => { axes[axis] = event.target.value; keep(); draw(); } }, names.map((name) => el("option", { value: name, selected: name === axes[axis] }, numberName(name)))));
  const card = el("section", { class: "card", "data-testid": "scatter" }, el("div", { class: "head" }, el(heading, { style: "margin:0" }, text("page-scatter")),
    el("div", { class: "row" }, choose("y", text("page-scatter-up")), choose("x", text("page-scatter-right")))), holder, ...(names.length ? [counted] : []));
  let chart = null;
  function draw() {
    const points = runs.map(({ id, numbers }) => ({ id, x: numbers[axes.x] ?? null, y: numbers[axes.y] ?? null })).filter(({ x, y }) => x !== null && y !== null).sort((a, b) => a.x - b.x);
    counted.textContent = text("page-scatter-of", { shown: points.length, count: runs.length, lacking: runs.length - points.length });
    chart?.close();
    holder.replaceChildren();
    const span = points.length ? points.at(-1).x - points[0].x || Math.abs(points[0].x) || 1 : 1;
    chart = new TimeChart(holder, {
      series: [{ name: numberName(axes.y), colour: "--core", kind: "dots", size: 9, unit: "", digits: 2 }], height: 380, label: text("page-scatter"), yLabel: numberName(axes.y), xLabel: numberName(axes.x),
      xRange: points.length ? [points[0].x - 0.08 * span, points.at(-1).x + 0.08 * span] : [0, 1],
    });
    chart.tipHead = (x) => `${points.filter((point) => point.x === x).map(({ id }) => id).join(", ")} · ${number(x, 1)}`;
    chart.set([points.map(({ x }) => x), points.map(({ y }) => y)]);
  }
  if (names.length) requestAnimationFrame(draw);
  else holder.append(el("p", { class: "faint" }, text("page-no-runs")));
  return card;
}
