// A chart as SVG: what its canvas shows now, as lines and letters that scale, and its legend below.
import { legendOf, nameAt, signOf } from "./legend.js";

export const style = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim() || name;
const safe = (text) => String(text).replace(/[&<>"]/g, (sign) => ({ "&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;" })[sign]);
const round = (value) => Math.round(10 * value) / 10;
const WIDTHS = { line: 2, thin: 1, core: 2.6 };

// `gap`: seconds over which a line is not drawn through.
export function svgOf(chart, gap) {
  const { plot } = chart;
  const [left, top] = [plot.bbox.left, plot.bbox.top].map((v) => v / devicePixelRatio);
  const [width, height] = [plot.over.clientWidth, plot.over.clientHeight];
  const x = (value) => round(left + plot.valToPos(value, "x"));
  const y = (value) => round(top + plot.valToPos(value, "y"));
  const letter = chart.letter / devicePixelRatio;
  const inner = [...chart.phases.map((phase) => shade(phase, x, { left, top, width, height })), ...chart.series.map((s, i) => curve(chart, s, i, { x, y, gap, top, height })),
    ...chart.namedPhases(plot).map((phase) => nameOf(phase, letter, top)), ...chart.placedMarks(plot).map((one) => mark(one, letter))].join("");
  const legend = legendOf(chart, plot.width);
  const all = Math.ceil(plot.height + legend.height);
  return `<svg xmlns="http://www.w3.org/2000/svg" width="${plot.width}" height="${all}" viewBox="0 0 ${plot.width} ${all}" font-family="system-ui, sans-serif" font-size="12">`
    + `<title>${safe(chart.label)}</title><rect width="100%" height="100%" fill="${style("--card")}"/>`
    + `<clipPath id="plot"><rect x="${left}" y="${top}" width="${width}" height="${height}"/></clipPath>`
    + `${axes(plot, x, y, { left, top, width, height })}<g clip-path="url(#plot)" fill="none">${inner}</g>`
    + `<g transform="translate(0 ${plot.height})">${legend.placed.map(explain).join("")}</g></svg>`;
}

function explain(one) {
  const { path, filled } = signOf(one);
  const colour = style(one.colour);
  const [x, y] = nameAt(one);
  const drawn = filled ? `fill="${colour}"` : `fill="none" stroke="${colour}" stroke-width="2"${one.dash ? ` stroke-dasharray="${one.dash.join(" ")}"` : ""}`;
  return `<path d="${path}" ${drawn}/><text x="${round(x)}" y="${y}" fill="${style("--faint")}">${safe(one.name)}</text>`;
}

function axes(plot, x, y, { left, top, width, height }) {
  const [across, up] = plot.axes;
  const letters = `fill="${style("--faint")}"`;
  const grid = `stroke="${style("--line")}"`;
  const bottom = top + height;
  const ticks = (axis, drawn) => (axis._splits ?? []).map((value, i) => drawn(value, axis._values?.[i] ?? "")).join("");
  return ticks(across, (v, label) => `<path d="M${x(v)} ${top}V${bottom}" ${grid}/><text x="${x(v)}" y="${bottom + 18}" text-anchor="middle" ${letters}>${safe(label)}</text>`)
    + ticks(up, (v, label) => `<path d="M${left} ${y(v)}H${left + width}" ${grid}/><text x="${left - 8}" y="${y(v) + 4}" text-anchor="end" ${letters}>${safe(label)}</text>`)
    + `<text x="${left + width / 2}" y="${plot.height - 4}" text-anchor="middle" ${letters}>${safe(across.label)}</text>`
    + `<text transform="translate(14 ${top + height / 2}) rotate(-90)" text-anchor="middle" ${letters}>${safe(up.label)}</text>`;
}

function shade(phase, x, { left, top, width, height }) {
  if (phase.state === "idle") return "";
  const from = x(phase.from_s);
  const to = phase.to_s === null ? left + width : x(phase.to_s);
  return `<rect x="${from}" y="${top}" width="${Math.max(to - from, 0)}" height="${height}" fill="${style(phase.state === "closed" ? "--phase-closed" : "--phase-open")}"/>`;
}

function nameOf({ label, ...pixels }, size, top) {
  const [from, width] = [pixels.from, pixels.width].map((v) => v / devicePixelRatio);
  return `<rect x="${round(from + 3)}" y="${top + 2}" width="${round(width + 6)}" height="${round(size + 4)}" fill="${style("--card")}"/>`
    + `<text x="${round(from + 6)}" y="${round(top + 3 + size)}" font-size="${round(size)}" fill="${style("--faint")}">${safe(label)}</text>`;
}

function curve(chart, s, i, { x, y, gap, top, height }) {
  const [times, values] = [chart.data[0], chart.data[i + 1]];
  const there = times.map((_, k) => k).filter((k) => (values[k] ?? null) !== null);
  if (s.kind === "band-high" || !there.length) return "";
  if (s.kind === "band-low") return band(chart, s, i, there, { x, y });
  const colour = style(s.colour);
  const out = (k) => chart.beyond(chart.plot, values[k]);
  const triangle = (k) => `<path d="M${x(times[k])} ${out(k) > 0 ? top : top + height}l-5 ${10 * out(k)}h10z" fill="${colour}"/>`;
  if (s.kind === "dots") return there.map((k) => (s.edge && out(k) ? triangle(k) : `<circle cx="${x(times[k])}" cy="${y(values[k])}" r="1.8" fill="${colour}"/>`)).join("");
  const pen = there.map((k, n) => `${n && (s.spanGaps || times[k] - times[there[n - 1]] <= gap) ? "L" : "M"}${x(times[k])} ${y(values[k])}`).join("");
  return `<path d="${pen}" stroke="${colour}" stroke-width="${WIDTHS[s.kind] ?? 1.5}"${s.dash ? ` stroke-dasharray="${s.dash.join(" ")}"` : ""}/>`;
}

function band(chart, s, i, there, { x, y }) {
  const [times, low, high] = [chart.data[0], chart.data[i + 1], chart.data[i + 2]];
  const both = there.filter((k) => (high[k] ?? null) !== null);
  if (chart.whiskers) return both.map((k) => `<path d="M${x(times[k])} ${y(low[k])}V${y(high[k])}" stroke="${style(chart.whiskers)}" stroke-width="1.5"/>`).join("");
  const edge = [...both.map((k) => `${x(times[k])} ${y(low[k])}`), ...both.reverse().map((k) => `${x(times[k])} ${y(high[k])}`)];
  return edge.length ? `<path d="M${edge.join("L")}Z" fill="${style(s.colour ?? "--core-band")}"/>` : "";
}

function mark({ name, colour: called, line, at, align }, size) {
  const colour = style(called);
  const [from, to, [x, y]] = [...line, at].map((place) => place.map((v) => round(v / devicePixelRatio)));
  return `<path d="M${from}L${to}" stroke="${colour}" stroke-width="1.5" stroke-dasharray="6 4"/>`
    + `<text x="${x}" y="${round(y - 0.2 * size)}" text-anchor="${align === "right" ? "end" : "start"}" font-size="${round(size)}" fill="${colour}" font-weight="600">${safe(name)}</text>`;
}
